"""Child processes as one unit: started in order of readiness, ended together.

A child is ready when it prints a line that begins with READY. Its output goes to a log file and,
with its name in front, to the terminal. Children get a termination signal if the supervisor dies.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from shared.errors import LinkError

_PR_SET_PDEATHSIG = 1
_STOP_SECONDS = 10.0


@dataclass(frozen=True)
class Service:
    """A process to run. `vital`: its end is the end of the run."""

    name: str
    command: tuple[str, ...]
    ready_seconds: float = 30.0
    vital: bool = True


@dataclass
class _Child:
    service: Service
    process: asyncio.subprocess.Process
    reader: asyncio.Task[None]
    ready: asyncio.Event
    last_line: str = ""


@dataclass
class Supervisor:
    """Runs services; `say(name, line)` shows their output. Logs go to `folder`/NAME.log."""

    folder: Path
    say: Callable[[str, str], None]
    _children: list[_Child] = field(default_factory=list)

    async def start(self, service: Service) -> None:
        """Start a service and wait until it is ready; `LinkError` with its last line if not."""
        process = await asyncio.create_subprocess_exec(
            *service.command,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=_die_with_parent if sys.platform == "linux" else None,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        ready = asyncio.Event()
        child = _Child(service, process, asyncio.create_task(asyncio.sleep(0)), ready)
        child.reader = asyncio.create_task(self._read(child))
        self._children.append(child)
        done, _ = await asyncio.wait(
            [asyncio.create_task(ready.wait()), child.reader],
            timeout=service.ready_seconds,
            return_when=asyncio.FIRST_COMPLETED,
        )
        if ready.is_set():
            return
        if done:
            code = await process.wait()
            reason = child.last_line.removeprefix("error: ")
            raise LinkError(f"{service.name} did not start (exit {code}): {reason}")
        raise LinkError(
            f"{service.name} was not ready within {service.ready_seconds:g} s; its log is "
            f"{self.folder / service.name}.log"
        )

    async def wait(self) -> tuple[Service, int]:
        """Wait for the first vital service to end; which one, and its exit code."""
        waiting = {
            asyncio.create_task(child.process.wait()): child.service
            for child in self._children
            if child.service.vital
        }
        done, pending = await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
        for task in pending:
            task.cancel()
        # The robot ends by itself: if several ended at once, the last started is the one meant.
        first = next(reversed([task for task in waiting if task in done]))
        return waiting[first], first.result()

    def running(self, name: str) -> bool:
        """Whether a service has been started and has not ended."""
        return any(
            child.service.name == name and child.process.returncode is None
            for child in self._children
        )

    async def stop(self) -> None:
        """End all services, last started first; kill what has not ended after ten seconds."""
        for child in reversed(self._children):
            _signal_group(child.process, signal.SIGTERM)
        for child in self._children:
            try:
                await asyncio.wait_for(child.process.wait(), _STOP_SECONDS)
            except asyncio.TimeoutError:
                self.say(child.service.name, f"did not stop within {_STOP_SECONDS:g} s: killed")
            # What a service left behind in its process group goes with it.
            _signal_group(child.process, signal.SIGKILL, even_if_ended=True)
            await child.process.wait()
            await child.reader
        self._children.clear()

    async def _read(self, child: _Child) -> None:
        assert child.process.stdout is not None
        name = child.service.name
        with (self.folder / f"{name}.log").open("w", encoding="utf-8") as log:
            async for raw in child.process.stdout:
                line = raw.decode(errors="replace").rstrip()
                log.write(line + "\n")
                log.flush()
                if line.startswith("READY"):
                    child.ready.set()
                if line:
                    child.last_line = line
                    self.say(name, line)


def _signal_group(
    process: asyncio.subprocess.Process, number: int, *, even_if_ended: bool = False
) -> None:
    if process.returncode is None or even_if_ended:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, number)


def _die_with_parent() -> None:
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
