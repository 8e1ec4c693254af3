"""Run the services of a plan: start them in order, watch them, end them together, write the
summary.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import os
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

import tomli_w

from deploy.background.control_server import ControlServer, Requests
from deploy.background.detach import tell_ready
from deploy.background.registry import Registry, in_terminal
from deploy.background.state import (
    ENDED,
    READY,
    STARTING,
    STOPPING,
    LineFile,
    ServiceState,
    StackFolder,
    StackState,
    exit_in_words,
)
from deploy.console.keys import commands_of, each_key, has_keys, keys_in_words, typed_keys
from deploy.console.terminal import Terminal
from deploy.console.watch import open_hub, private_socket, status_of, tell
from deploy.neighbours import Neighbours
from deploy.outcome import record, summarise
from deploy.plan import Plan, PlannedService
from deploy.process_stat import process_started
from deploy.scene import Sender
from deploy.services import EDGE, HELD, IGNORED, NETEM, OUTCOME, ROBOT, VIEWER
from deploy.supervisor import Launch, Supervisor
from shared.bus.base import Delivery
from shared.bus.operator import CommandClient
from shared.commands import wbc
from shared.config.config_file import differing, settings_table
from shared.config.settings import RunConfig
from shared.errors import LinkError, UserError, writing
from shared.output.summary import summary_in_words
from shared.process.cli import EXIT_FELL, EXIT_STANDING
from shared.process.entry import EXIT_ERROR, EXIT_INTERRUPTED, python
from shared.process.realtime import usable_cores
from shared.wire.operator.commands import Command
from shared.wire.operator.events import SCRIPT_FILE, CommandEvent, write_events
from shared.wire.operator.messages import VIEW_KEY
from shared.wire.operator.texts import parse_command

_STATUS_SECONDS = 0.1
# An unopened view does not hold the task for longer.
_SEEN_SECONDS = 60.0
_MAX_TYPED = 4
# Where cores are few, the edge has this share of a core at real-time priority: enough for 150 to
# 200 answers a second. Robot and shim have to be on time. The edge drops states instead.
_EDGE_SHARE = 0.2
# Looks for other stacks take milliseconds.
_LOOK_SECONDS = 1.0


@dataclass(frozen=True)
class Run:
    """The settings and the plan of a run, and the folder `out` for its files.

    `name` is the robot's name on the link, None for the name of its kind. `ready_fd` is set in the
    background: the descriptor on which the run reports that it is ready. A run that `stays` goes on
    until a signal. The services carry out the
    commands of `scene` at their times. The task waits for a `seen`
    view.
    """

    config: RunConfig
    plan: Plan
    out: Path
    name: str | None
    ready_fd: int | None = None
    stays: bool = False
    scene: tuple[CommandEvent, ...] = ()
    seen: bool = False


def in_words(run: Run) -> list[str]:
    """Return lines that say what a run would start: services, differing settings, commands."""
    table = differing(settings_table(run.config), settings_table(RunConfig()))
    settings = tomli_w.dumps(table).strip().splitlines() or ["all at their defaults"]
    goes = "until Ctrl-C" if run.stays else f"for {run.config.duration:g} s of the task"
    lines = [f"would run {goes}, as {run.name or run.config.robot.label}", "services, in order:"]
    lines += [f"  {step.name:<7} python -m {' '.join(step.arguments)}" for step in run.plan.steps]
    lines += ["settings:", *(f"  {line}" for line in settings)]
    if run.scene:
        lines += ["commands:", *(f"  {event}" for event in run.scene)]
    return [*lines, *run.plan.notes, "nothing was started"]


class StackRun:
    """The processes of one run."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._out = run.out
        self._folder = StackFolder(run.out)
        self._status = status_of(run.config, stays=run.stays)
        self._terminal = Terminal()
        self._supervisor = Supervisor(run.out, self._say, changed=self._publish)
        self._watched = run.plan.has(VIEWER)
        self._neighbours = Neighbours()
        # The service that has ended the run by its failure, and how.
        self._failure: str | None = None
        self._look_at = 0.0
        # In the background: whether the terminal of the parent process is released.
        self._let_go = False
        self._stop = asyncio.Event()
        # Without a robot here the run never ends by itself, so a signal is its normal end.
        ends = run.plan.has(ROBOT) and not run.stays
        self._stopped_code = EXIT_INTERRUPTED if ends else EXIT_STANDING
        self._client: CommandClient
        self._sender: Sender
        self._seen = asyncio.Event()
        # Gives the terminal its keys back.
        self._own_keys = contextlib.ExitStack()
        # Commands from keys that have not been sent yet.
        self._typed: asyncio.Queue[Command] = asyncio.Queue(maxsize=_MAX_TYPED)
        self._state = StackState(
            pid=os.getpid(),
            robot=run.name or run.config.robot.label,
            named=run.plan.names,
            state=STARTING,
            since=time.time(),
            started=process_started(os.getpid()),
        )

    async def run(self) -> int:
        """Run until the robot finishes, a service ends or a signal arrives; return the code."""
        loop = asyncio.get_running_loop()
        ending = [signal.SIGINT, signal.SIGTERM]
        # Under nohup the run outlives its terminal.
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
            ending.append(signal.SIGHUP)
        for number in ending:
            loop.add_signal_handler(number, self._request_stop)
        with self._claimed(), private_socket(self._folder.folder) as telemetry:
            for line in (f"run folder: {self._out}", *self._run.plan.notes):
                self._terminal.tell(line)
            self._telemetry = telemetry
            robot = self._run.config.robot.label
            hub = open_hub(telemetry, self._status, robot, out=self._out)
            self._put(STARTING)
            hub.subscribe(VIEW_KEY, partial(self._note_view, loop))
            self._client = CommandClient(hub)
            self._sender = Sender(self._client, partial(self._say, "up"))
            if self._run.scene:
                with writing(self._out, what="out"):
                    write_events(self._out / SCRIPT_FILE, self._run.scene)
            failure: LinkError | None = None
            code = EXIT_ERROR
            try:
                async with ControlServer(self._folder, self._requests()):
                    with self._keys():
                        code = await self._play()
            except LinkError as error:
                failure = error
            finally:
                self._terminal.clear()
                self._put(STOPPING)
                self._end_at_interrupt()
                await self._supervisor.stop()
            if self._run.stays and self._fell():
                code = EXIT_FELL
            # Events of the last rows, which have come since the robot ended.
            for event in self._status.take_events():
                self._terminal.say(event.name, event.text)
            outcome = self._sum_up()
            hub.close()
            if failure is not None:
                raise failure
            if not outcome:
                removed = f"no files: {self._out} was removed during the run"
                self._terminal.tell(f"files: {self._out}" if self._out.exists() else removed)
                outcome = self._last_words(code)
            self._put(STOPPING, outcome=outcome, exit_code=code)
            return code

    def _requests(self) -> Requests:
        """Return the requests of other processes that this one carries out."""

        async def restart(service: str) -> dict[str, Any]:
            await self._supervisor.restart(service)
            return {}

        async def command(text: str) -> dict[str, Any]:
            accepted = await asyncio.to_thread(self._client.send, parse_command(text))
            return dataclasses.asdict(accepted)

        return {"restart": restart, "command": command}

    def _fell(self) -> bool:
        """Return whether the robot has ended and had fallen."""
        ends = {each.name: each.exit_code for each in self._supervisor.states()}
        return ends.get(ROBOT) == EXIT_FELL

    def _request_stop(self) -> None:
        self._stop.set()
        self._end_at_interrupt()

    def _end_at_interrupt(self) -> None:
        """Let the next Ctrl-C end all processes at once, even while this process waits for one."""

        def end(number: int, frame: FrameType | None) -> NoReturn:
            self._supervisor.kill()
            self._own_keys.close()
            # The signal may have come while this very terminal or file was written.
            with contextlib.suppress(Exception):
                self._put(ENDED, outcome="ended at once by Ctrl-C", exit_code=EXIT_INTERRUPTED)
                hint = wbc(f"viewer open {self._out}")
                self._terminal.tell(f"ended at once; {hint} reads what the services have written")
            os._exit(EXIT_INTERRUPTED)

        if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
            asyncio.get_running_loop().remove_signal_handler(signal.SIGINT)
            signal.signal(signal.SIGINT, end)

    def _last_words(self, code: int) -> str:
        """Return the outcome of a run without a summary: the robot's last line."""
        if self._run.plan.has(ROBOT) and code in (EXIT_STANDING, EXIT_FELL):
            return self._supervisor.last_line(ROBOT)
        return "stopped"

    @contextlib.contextmanager
    def _claimed(self) -> Iterator[None]:
        """Hold the stack's folder, and record there how the run ends.

        In the background, also add the folder to the registry.
        """
        background = self._run.ready_fd is not None
        found = contextlib.nullcontext() if background else in_terminal(self._out)
        with self._folder.claim(), LineFile(self._folder.log) as log, found:
            self._terminal = Terminal(copy=log)
            self._put(STARTING)
            ended = {"outcome": "an unexpected error ended it", "exit_code": EXIT_ERROR}
            try:
                if background:
                    Registry().add(self._out, robot=self._state.robot, services=self._state.named)
                yield
                ended = {}
            except UserError as error:
                # Once the terminal is released, standard error is the log itself.
                if not self._let_go:
                    self._terminal.note(f"error: {error}")
                ended = {"outcome": str(error), "exit_code": EXIT_ERROR}
                raise
            finally:
                self._put(ENDED, **ended)

    async def _play(self) -> int:
        for step in self._run.plan.steps:
            if HELD in step.service.takes:
                await self._supervisor.load(self._launch(step))
        for step in self._run.plan.steps:
            if step.name == ROBOT:
                await self._until_seen()
            starting = asyncio.create_task(self._supervisor.start(self._launch(step)))
            stopping = asyncio.create_task(self._stop.wait())
            await asyncio.wait({starting, stopping}, return_when=asyncio.FIRST_COMPLETED)
            stopping.cancel()
            if self._stop.is_set():
                starting.cancel()
                return self._stopped_code
            try:
                await starting
            except LinkError as error:
                if step.service.end != IGNORED:
                    raise
                self._say(step.name, f"the run goes on without {step.name}: {error}")
                self._watched = False
            self._look(again=True)
        self._put(READY)
        self._tell_ready()
        sending = asyncio.create_task(self._send_typed())
        try:
            return await self._watch()
        finally:
            sending.cancel()

    def _note_view(self, loop: asyncio.AbstractEventLoop, delivery: Delivery) -> None:
        """Note that a viewer shows the run; called on the bus's thread."""
        loop.call_soon_threadsafe(self._seen.set)

    async def _until_seen(self) -> None:
        """Wait until a viewer shows the run, until Enter is pressed, or for `_SEEN_SECONDS`."""
        if not (self._run.seen and self._watched) or self._stop.is_set():
            return
        self._say(
            "up",
            f"the task begins once the view is open, or with Enter; at most {_SEEN_SECONDS:g} s",
        )
        waits = {asyncio.create_task(each.wait()) for each in (self._seen, self._stop)}
        await asyncio.wait(waits, timeout=_SEEN_SECONDS, return_when=asyncio.FIRST_COMPLETED)
        for wait in waits:
            wait.cancel()

    def _take_keys(self) -> None:
        """Take in the keys that were typed. While too many wait, further ones are dropped."""
        typed = typed_keys()
        if not typed:
            asyncio.get_running_loop().remove_reader(sys.stdin.fileno())
        commands, enter = commands_of(typed)
        if enter:
            self._seen.set()
        for command in commands:
            with contextlib.suppress(asyncio.QueueFull):
                self._typed.put_nowait(command)

    async def _send_typed(self) -> None:
        while True:
            await self._sender.send(await self._typed.get())

    @contextlib.contextmanager
    def _keys(self) -> Iterator[None]:
        """Take keys from the terminal while the context lasts, if this is its foreground."""
        plan = self._run.plan
        if self._run.ready_fd is not None or not plan.has(ROBOT) or not has_keys():
            yield
            return
        self._terminal.tell(keys_in_words(link=plan.has(NETEM)))
        loop, file = asyncio.get_running_loop(), sys.stdin.fileno()
        with self._own_keys as context:
            context.enter_context(each_key())
            loop.add_reader(file, self._take_keys)
            context.callback(loop.remove_reader, file)
            yield

    def _tell_ready(self) -> None:
        """Report that the stack is ready; in the background, release the parent process."""
        if self._run.ready_fd is None:
            if not self._run.plan.has(ROBOT):
                self._terminal.say("up", "started; Ctrl-C ends it")
            elif self._run.stays:
                examples = "link cut, link restore, controller lc, pause, reset"
                self._terminal.say("up", f"goes on until Ctrl-C; try {wbc('push 100N +y')}")
                self._terminal.say("up", f"or {examples}; see docs/hands-on.md")
            return
        self._terminal.say("up", f"ready; next: {wbc('ps')}, logs, restart or down")
        self._terminal.leave()
        with self._folder.log.open("ab") as errors:
            tell_ready(self._run.ready_fd, errors.fileno())
        self._let_go = True

    async def _watch(self) -> int:
        ending = asyncio.create_task(self._supervisor.wait())
        while not ending.done():
            self._look()
            if self._stop.is_set():
                self._terminal.say("up", "stopping")
                ending.cancel()
                return self._stopped_code
            if self._run.plan.has(ROBOT):
                tell(self._status, self._terminal, degraded=self._state.degraded)
            await asyncio.wait({ending}, timeout=_STATUS_SECONDS)
        # A busy machine may have left this process no time before.
        self._look(again=True)
        service, code = ending.result()
        if service.end == OUTCOME and code in (EXIT_STANDING, EXIT_FELL, EXIT_INTERRUPTED):
            await self._linger()
            return code
        self._failure = f"{service.name} ended ({exit_in_words(code)})"
        text = f"{self._failure}: all services were stopped; "
        text += f"its log is {self._out / service.name}.log"
        if code > 0:
            # A service that ends by an error prints it in its last line.
            reason = self._supervisor.last_line(service.name).removeprefix("error: ")
            text += f"; its last line: {reason}"
        raise LinkError(text)

    def _look(self, *, again: bool = False) -> None:
        """Look at the other processes of this machine, once in `_LOOK_SECONDS`, or `again` now."""
        now = time.monotonic()
        if again or now >= self._look_at:
            self._look_at = now + _LOOK_SECONDS
            own = [os.getpid(), *[each.pid for each in self._supervisor.states()]]
            self._neighbours.look(own, now)

    async def _linger(self) -> None:
        """Leave the view open until Ctrl-C, or until the user closes it."""
        if not self._watched or not sys.stdin.isatty():
            return
        self._terminal.clear()
        self._terminal.say("up", "the run is over; the view stays open, Ctrl-C ends it")
        while self._supervisor.running(VIEWER) and not self._stop.is_set():
            await asyncio.sleep(_STATUS_SECONDS)

    def _launch(self, step: PlannedService) -> Launch:
        run, secure = self._run, self._run.plan.secure
        values = {
            "config": self._out / "config.toml",
            "telemetry": self._telemetry,
            "out": self._out,
            "name": run.name,
            "secure": secure,
            "events": self._out / SCRIPT_FILE if run.scene else None,
        }
        command = python("-m", *step.arguments)
        if step.name == ROBOT and run.stays:
            command += ["--stay"]
        if step.name == EDGE and _fills_all_cores(run.plan):
            command += ["--realtime-share", f"{_EDGE_SHARE:g}"]
        for flag in step.service.takes:
            if flag == HELD:
                command += [f"--{flag}"]
            elif values[flag] is not None:
                command += [f"--{flag}", str(values[flag])]
        ready = step.service.ready_seconds + run.config.loop.connect_timeout
        return Launch(step.service, tuple(command), ready_seconds=ready)

    def _say(self, name: str, line: str) -> None:
        self._terminal.say(name, line)

    def _publish(self) -> None:
        self._put(self._state.state)

    def _put(self, state: str, **changes: Any) -> None:
        since = self._state.since if state == self._state.state else time.time()
        self._state = dataclasses.replace(
            self._state,
            **{"state": state, "since": since, **changes},
            services=tuple(self._supervisor.states()),
        )
        self._folder.write(self._state)

    def _sum_up(self) -> str:
        """Print the summary of the run, and return its first line; empty if there is none."""
        again = [service for service in self._supervisor.states() if service.restarts]
        result = summarise(
            self._out,
            self._run.config,
            self._terminal.tell,
            services={
                service.name: {
                    "restarts": service.restarts,
                    "degraded_seconds": service.degraded_seconds,
                }
                for service in again
            },
            neighbours=self._neighbours,
            failure=self._failure,
        )
        if result is None:
            return ""
        # A viewer that was started again has recorded only its last life. In the background the
        # recording is left out: a user waits for the end of the run, not for a recording.
        whole = (self._out / "recording.rrd").exists() and VIEWER not in [
            each.name for each in again
        ]
        if not whole and self._run.ready_fd is None:
            record(self._out, lambda line: self._say(VIEWER, line))
        text = summary_in_words(result)
        self._terminal.tell("\n".join([text, *self._happened(again), f"  files: {self._out}"]))
        return text.splitlines()[0]

    def _happened(self, again: list[ServiceState]) -> list[str]:
        """Return a line with pushes and restarts, which the services' files do not have."""
        restarts = [
            f"{service.name} started again {service.restarts} ×"
            + (f", degraded for {service.degraded_seconds:g} s" * (service.degraded_seconds > 0))
            for service in again
        ]
        pushes = self._status.events.pushes
        text = "; ".join([*[f"pushed with {', '.join(pushes)}"] * bool(pushes), *restarts])
        return [f"  {text}"] if text else []


def _fills_all_cores(plan: Plan) -> bool:
    """Return whether robot, shim and edge of a plan leave no core to ordinary processes.

    Each takes up to a core at real-time priority.
    """
    return sum(plan.has(name) for name in (EDGE, NETEM, ROBOT)) >= usable_cores()
