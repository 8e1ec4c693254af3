"""Start child processes in order, start them again, and end them together.

A child is ready when it prints the line that its service names. Its output goes to a log file and,
after its name, to the terminal. Children get a termination signal if the supervisor dies.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from deploy.background.state import (
    ENDED,
    READY,
    STARTING,
    STOPPING,
    WAITING,
    LineFile,
    ServiceState,
    exit_in_words,
)
from deploy.process import kill_group, start_process, terminate
from deploy.services import HELD, IGNORED, OUTCOME, Service
from shared.commands import wbc
from shared.errors import ConfigError, LinkError, one_of

_CANCEL_SECONDS = 0.1
# A stop that takes longer prints the services that it waits for.
_TELL_SECONDS = 3.0


@dataclass(frozen=True)
class Launch:
    """A service, its command line, and the time within which it has to be ready [s]."""

    service: Service
    command: tuple[str, ...]
    ready_seconds: float


@dataclass
class _Child:
    launch: Launch
    process: asyncio.subprocess.Process = field(init=False)
    reader: asyncio.Task[None] = field(init=False)
    watch: asyncio.Task[None] | None = None
    ready: asyncio.Event = field(default_factory=asyncio.Event)
    state: str = STARTING
    since: float = 0.0
    restarts: int = 0
    # Failures that count together, as `Service.degraded` takes them.
    failures: int = 0
    degraded_seconds: float = 0.0
    last_line: str = ""
    # The process has ended, with its group. Its number may belong to another process by now.
    over: bool = False

    @property
    def name(self) -> str:
        return self.launch.service.name


class Supervisor:
    """Runs services; `say(name, line)` shows their output. Logs go to `folder`/NAME.log.

    `changed()` is called after every change of a state.
    """

    def __init__(
        self,
        folder: Path,
        say: Callable[[str, str], None],
        *,
        changed: Callable[[], None],
    ) -> None:
        self._folder = folder
        self._say = say
        self._changed = changed
        self._children: dict[str, _Child] = {}
        self._ended: asyncio.Queue[tuple[Service, int]] = asyncio.Queue()

    async def load(self, launch: Launch) -> None:
        """Begin the process of a held service, which loads and then waits for `start`."""
        await self._begin(_Child(launch))

    async def start(self, launch: Launch) -> None:
        """Start a service and wait until it is ready.

        Raise `LinkError`, with its last line, if it does not become ready.
        """
        child = self._children.get(launch.service.name)
        if child is None:
            child = _Child(launch)
            await self._begin(child)
        await self._become_ready(child)
        child.watch = asyncio.create_task(self._watch(child))

    async def restart(self, name: str) -> None:
        """End a service, start it again and wait until it is ready.

        A service that waits before its next start is started at once. A service that has ended can
        be started again if the run goes on without it. Raise
        `ConfigError` if the service is not running, or if its end is the end of the run. Raise
        `LinkError` if it does not become ready again; the service has then ended.
        """
        child = self._children.get(name)
        if child is None:
            raise ConfigError(f"restart: {one_of(self._children, name)}")
        service = child.launch.service
        if service.end == OUTCOME:
            raise ConfigError(f"restart: the run ends with {name}; try {wbc('down')}, then up")
        if child.state not in (READY, WAITING) and (child.state, service.end) != (ENDED, IGNORED):
            raise ConfigError(f"restart: {name} is {child.state} already; {wbc('ps')} shows it")
        # Set at once, so that a second request is refused.
        self._put(child, STOPPING)
        if child.watch is not None:
            child.watch.cancel()
        back: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        child.watch = asyncio.create_task(self._restart(child, back))
        await back

    async def wait(self) -> tuple[Service, int]:
        """Wait for the first end of a service that ends the run. Return it and its exit code.

        The code is negative for a process that a signal has killed.
        """
        ends = [await self._ended.get()]
        while not self._ended.empty():
            ends.append(self._ended.get_nowait())
        # If several services have ended, the end that is the run's outcome counts.
        return next((end for end in ends if end[0].end == OUTCOME), ends[0])

    def running(self, name: str) -> bool:
        """Return whether a service has been started and has not ended."""
        child = self._children.get(name)
        return child is not None and child.process.returncode is None

    def last_line(self, name: str) -> str:
        """Return the last line that a service has printed."""
        return self._children[name].last_line

    def states(self) -> list[ServiceState]:
        """Return the state of every service that has been started."""
        return [
            ServiceState(
                name=child.name,
                pid=child.process.pid,
                state=child.state,
                since=child.since,
                restarts=child.restarts,
                exit_code=child.process.returncode,
                degraded=child.launch.service.degraded(child.failures),
                degraded_seconds=round(child.degraded_seconds, 1),
            )
            for child in self._children.values()
        ]

    async def stop(self) -> None:
        """End all services, last started first; kill a service that takes too long."""
        children = list(reversed(self._children.values()))
        # A restart that is cancelled may still have begun a process.
        watches = {child.watch for child in children if child.watch is not None}
        while watches:
            for watch in watches:
                watch.cancel()
            # Repeated until it takes effect, because a wait that ends at this moment may lose the
            # request.
            _, watches = await asyncio.wait(watches, timeout=_CANCEL_SECONDS)
        # The number of a process that has ended may belong to another process by now.
        children = [child for child in children if child.state != ENDED]
        for child in children:
            terminate(child.process)
        telling = asyncio.create_task(self._tell_waiting(children))
        for child in children:
            await self._end(child)
            self._put(child, ENDED)
        telling.cancel()

    def kill(self) -> None:
        """Kill all services at once, without waiting for their ends."""
        for child in self._children.values():
            if not child.over and child.process.returncode is None:
                kill_group(child.process)

    async def _tell_waiting(self, children: Sequence[_Child]) -> None:
        """Print after a while which services have not ended yet."""
        await asyncio.sleep(_TELL_SECONDS)
        left = [each for each in children if each.process.returncode is None]
        if left:
            names = ", ".join(f"{each.name} (pid {each.process.pid})" for each in left)
            longest = max(each.launch.service.stop_seconds for each in left)
            self._say(
                "up", f"waits for {names} to end, at most {longest:g} s; Ctrl-C ends all at once"
            )

    async def _begin(self, child: _Child) -> None:
        child.ready.clear()
        held = HELD in child.launch.service.takes
        try:
            child.process = await start_process(child.launch.command, held=held)
        except OSError as error:
            raise LinkError(f"{child.name} cannot be started: {error.strerror or error}") from None
        child.over = False
        child.reader = asyncio.create_task(self._read(child))
        self._children[child.name] = child
        self._put(child, STARTING)

    async def _become_ready(self, child: _Child) -> None:
        if child.process.stdin is not None:
            child.process.stdin.close()
        ready = asyncio.create_task(child.ready.wait())
        done, _ = await asyncio.wait(
            {ready, child.reader},
            timeout=child.launch.ready_seconds,
            return_when=asyncio.FIRST_COMPLETED,
        )
        ready.cancel()
        if child.ready.is_set():
            self._put(child, READY)
            return
        if not done:
            terminate(child.process)
        await self._end(child)
        self._put(child, ENDED)
        if done:
            assert child.process.returncode is not None
            how = exit_in_words(child.process.returncode)
            reason = child.last_line.removeprefix("error: ")
            raise LinkError(f"{child.name} did not start ({how}): {reason}")
        raise LinkError(
            f"{child.name} was not ready within {child.launch.ready_seconds:g} s; its log is "
            f"{self._folder / child.name}.log"
        )

    async def _watch(self, child: _Child) -> None:
        """Wait until the service ends for good; start it again as its `restart` says."""
        service = child.launch.service
        while True:
            code = await self._life(child)
            if code == 0 or not service.restarts:
                break
            await self._start_again(child, f"ended ({exit_in_words(code)})")
        await self._finish(child)

    async def _life(self, child: _Child) -> int:
        """Wait for the end of a process, and return its code. After a long life earlier failures no
        longer count.
        """
        service = child.launch.service
        if child.failures:
            seconds, began = service.window_seconds, time.monotonic()
            degraded = service.degraded(child.failures)
            # Not `wait_for`, which may lose a request to end if the process ends at that moment.
            waiting = asyncio.ensure_future(child.process.wait())
            try:
                if waiting not in (await asyncio.wait({waiting}, timeout=seconds))[0]:
                    child.failures = 0
                    self._say(
                        child.name, f"has run for {seconds:g} s: earlier failures no longer count"
                    )
                    self._changed()
            finally:
                if degraded:
                    child.degraded_seconds += time.monotonic() - began
        return await child.process.wait()

    async def _start_again(self, child: _Child, how: str) -> None:
        """Start a service until it becomes ready. Beyond its number of failures, wait before."""
        service = child.launch.service
        while True:
            child.failures += 1
            pause = service.pause_seconds(child.failures)
            when = f"starts again in {pause:g} s (degraded)" if pause else "starts again"
            self._say(child.name, f"{how}: {when}, failure {child.failures}")
            await self._end(child)
            began = time.monotonic()
            try:
                if pause:
                    self._put(child, WAITING)
                    await asyncio.sleep(pause)
                await self._again(child)
            except LinkError as error:
                how = str(error)
            else:
                return
            finally:
                if pause:
                    child.degraded_seconds += time.monotonic() - began

    async def _restart(self, child: _Child, back: asyncio.Future[None]) -> None:
        try:
            terminate(child.process)
            await self._again(child)
        except LinkError as error:
            if not back.done():
                back.set_exception(error)
            if not child.launch.service.restarts:
                await self._finish(child)
                return
            await self._start_again(child, str(error))
        except asyncio.CancelledError:
            back.cancel()
            raise
        # The client that asked may have left.
        if not back.done():
            back.set_result(None)
        await self._watch(child)

    async def _again(self, child: _Child) -> None:
        await self._end(child)
        child.restarts += 1
        await self._begin(child)
        await self._become_ready(child)
        self._say(child.name, f"ready again (pid {child.process.pid})")

    async def _finish(self, child: _Child) -> None:
        await self._end(child)
        self._put(child, ENDED)
        service = child.launch.service
        if service.end != IGNORED:
            assert child.process.returncode is not None
            self._ended.put_nowait((service, child.process.returncode))

    async def _end(self, child: _Child) -> None:
        """Wait until a process ends that has a signal to end; then end the rest of its group."""
        if child.over:
            return
        seconds = child.launch.service.stop_seconds
        try:
            await asyncio.wait_for(child.process.wait(), seconds)
        except asyncio.TimeoutError:
            self._say(child.name, f"did not stop within {seconds:g} s: killed")
        # A service may have left other processes in its group.
        kill_group(child.process)
        await child.process.wait()
        child.over = True
        # Not awaited directly: if this task is cancelled, the reader goes on.
        await asyncio.wait({child.reader})

    def _put(self, child: _Child, state: str) -> None:
        child.state, child.since = state, time.time()
        self._changed()

    async def _read(self, child: _Child) -> None:
        assert child.process.stdout is not None
        name, ready = child.name, child.launch.service.ready
        with LineFile(self._folder / f"{name}.log") as log:
            while True:
                try:
                    raw = await child.process.stdout.readline()
                except ValueError:
                    # The line is longer than the reader's buffer, which is empty now.
                    continue
                if not raw:
                    break
                line = raw.decode(errors="replace").rstrip()
                log.add(line)
                if line.startswith(ready):
                    child.ready.set()
                if line:
                    child.last_line = line
                    self._say(name, line)
