"""One run of the services in a plan: started in order, watched, ended together, summed up."""

from __future__ import annotations

import asyncio
import json
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deploy.plan import ROBOT, ROUTER, VIEWER, Plan, Step
from deploy.status import Status, Terminal
from deploy.supervisor import Service, Supervisor
from shared.bus.zenoh_bus import ZenohBus
from shared.cli import EXIT_STANDING
from shared.config import RunConfig
from shared.errors import LinkError
from shared.report import discrepancy_report, summary, summary_in_words
from shared.telemetry import read_parquet
from shared.wire.channels import LINK_KEY, TICKS_KEY

_STATUS_SECONDS = 0.1
_INTERRUPTED = 130
_READY_SECONDS = 60.0
_PARTS = {"robot": "telemetry.json", "edge": "edge.json", "link": "link.json"}


@dataclass(frozen=True)
class Run:
    """What is to run, and the folder `out` for its files. `name` of the robot on the link, if it
    is not that of its kind.
    """

    config: RunConfig
    plan: Plan
    out: Path
    telemetry: str
    name: str | None


class Stack:
    """The processes of one run."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._out = run.out
        self._terminal = Terminal()
        self._supervisor = Supervisor(run.out, self._terminal.say)
        self._status = Status(duration=run.config.duration)
        self._watched = run.plan.has(VIEWER)
        self._stop = asyncio.Event()
        # Without a robot here nothing comes to an end by itself: to be stopped is no failure.
        self._stopped_code = _INTERRUPTED if run.plan.has(ROBOT) else EXIT_STANDING

    async def run(self) -> int:
        """Until the robot has finished, a service has ended, or a signal; the exit code."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, self._stop.set)
        hub = ZenohBus(listen=[self._run.telemetry], mode="router")
        kind = self._run.config.robot.name
        hub.subscribe(TICKS_KEY.format(robot=kind), self._status.take_ticks)
        hub.subscribe(LINK_KEY, self._status.take_link)
        print(f"run folder: {self._out}", *self._run.plan.notes, sep="\n", flush=True)
        try:
            code = await self._play()
        finally:
            self._terminal.clear()
            await self._supervisor.stop()
            hub.close()
        return self._finish(code)

    async def _play(self) -> int:
        for step in self._run.plan.steps:
            starting = asyncio.create_task(self._supervisor.start(self._service(step)))
            stopping = asyncio.create_task(self._stop.wait())
            await asyncio.wait({starting, stopping}, return_when=asyncio.FIRST_COMPLETED)
            stopping.cancel()
            if self._stop.is_set():
                starting.cancel()
                return self._stopped_code
            try:
                await starting
            except LinkError as error:
                if step.vital:
                    raise
                self._terminal.say(step.name, f"going on without a live view: {error}")
                self._watched = False
        return await self._watch()

    async def _watch(self) -> int:
        ending = asyncio.create_task(self._supervisor.wait())
        if not self._run.plan.has(ROBOT):
            self._terminal.say("up", "started; Ctrl-C ends it")
        while not ending.done():
            if self._stop.is_set():
                self._terminal.say("up", "stopping")
                ending.cancel()
                return self._stopped_code
            if self._run.plan.has(ROBOT):
                self._terminal.show(self._status.line())
            await asyncio.wait({ending}, timeout=_STATUS_SECONDS)
        service, code = ending.result()
        if service.name != ROBOT:
            self._terminal.clear()
            before = " before the robot" if self._run.plan.has(ROBOT) else ""
            raise LinkError(
                f"{service.name} ended (exit {code}){before}: everything was stopped; its "
                f"log is {self._out / service.name}.log"
            )
        await self._linger()
        return code

    async def _linger(self) -> None:
        """Leave a view open for the person in front of it until Ctrl-C or until it is closed."""
        if not self._watched or not sys.stdin.isatty():
            return
        self._terminal.clear()
        self._terminal.say("up", "the run is over; the view stays open, Ctrl-C ends it")
        while self._supervisor.running(VIEWER) and not self._stop.is_set():
            await asyncio.sleep(_STATUS_SECONDS)

    def _service(self, step: Step) -> Service:
        command = [sys.executable, "-m", *step.arguments]
        if step.name != ROUTER:
            command += ["--config", str(self._out / "config.toml")]
            command += ["--telemetry", self._run.telemetry, "--out", str(self._out)]
            if step.name != VIEWER and self._run.name is not None:
                command += ["--name", self._run.name]
        if step.name != VIEWER and self._run.plan.secure is not None:
            command += ["--secure", str(self._run.plan.secure)]
        ready = _READY_SECONDS + self._run.config.loop.connect_timeout
        return Service(step.name, tuple(command), ready_seconds=ready, vital=step.vital)

    def _finish(self, code: int) -> int:
        parts = {name: self._part(file) for name, file in _PARTS.items()}
        robot = parts["robot"]
        if robot is None:
            print(f"files: {self._out}", flush=True)
            return code
        result = summary(
            self._run.config,
            robot=robot,
            edge=parts["edge"],
            link=parts["link"],
            discrepancy=self._discrepancy(),
        )
        text = json.dumps(result, indent=2)
        (self._out / "summary.json").write_text(text + "\n", encoding="utf-8")
        for file in _PARTS.values():
            (self._out / file).unlink(missing_ok=True)
        if not (self._out / "recording.rrd").exists():
            self._record()
        print(summary_in_words(result))
        print(f"  files: {self._out}", flush=True)
        return code

    def _part(self, file: str) -> dict[str, Any] | None:
        try:
            part: dict[str, Any] = json.loads((self._out / file).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return part

    def _discrepancy(self) -> dict[str, Any] | None:
        """The report of the active set; of the ticks whose state the edge has solved."""
        files = [self._out / "telemetry.parquet", self._out / "edge.parquet"]
        if not all(file.exists() for file in files):
            return None
        (schema, rows), (_, solve_rows) = (read_parquet(file) for file in files)
        return discrepancy_report(schema, rows, solve_rows)

    def _record(self) -> None:
        """The recording of a run nobody watched, made from its files."""
        command = [sys.executable, "-m", "viewer", "record", str(self._out)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        for line in (done.stdout + done.stderr).splitlines():
            self._terminal.say("viewer", line)
