"""The whole stack on this machine: edge, netem, robot and viewer, started together.

Exit code 0: the robot finished standing. 3: it fell. Anything else: an error that says what to do.
"""

from __future__ import annotations

# isort: off
import shared.single_thread  # noqa: F401

# isort: on
import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from deploy.status import Status, Terminal
from deploy.supervisor import Service, Supervisor
from netem.profile import load_profile
from shared.bus.zenoh_bus import ZenohBus
from shared.cli import (
    Parser,
    add_run_arguments,
    add_view_argument,
    config_from,
    run,
)
from shared.config import RunConfig
from shared.config_file import dump_config
from shared.errors import ConfigError, LinkError
from shared.metrics import task_discrepancy
from shared.motion.plan import make_motion
from shared.report import summary, summary_in_words, versions
from shared.robots import load_robot
from shared.telemetry import read_parquet
from shared.wire.channels import LINK_KEY, TICKS_KEY

_STATUS_SECONDS = 0.1
_INTERRUPTED = 130
_PARTS = {"robot": "telemetry.json", "edge": "edge.json", "link": "link.json"}


def main() -> int:
    parser = Parser(prog="deploy/up", description=__doc__)
    add_run_arguments(parser)
    add_view_argument(parser)
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of this run (default runs/<time>-…)"
    )
    arguments = parser.parse_args()
    config = config_from(arguments)
    # Whatever cannot be done is said before anything starts.
    make_motion(load_robot(config.robot.name), config)
    if config.link.network != "direct":
        load_profile(config.link.network)
    out = _run_folder(arguments.out, config)
    text = dump_config(config, versions=versions())
    (out / "config.toml").write_text(text, encoding="utf-8")
    return asyncio.run(_Stack(config, out).run())


class _Stack:
    """One run of the services in a folder."""

    def __init__(self, config: RunConfig, out: Path) -> None:
        self._config = config
        self._out = out
        self._terminal = Terminal()
        self._supervisor = Supervisor(out, self._terminal.say)
        self._status = Status(duration=config.duration)
        self._view = _resolve_view(config.view)
        self._stop = asyncio.Event()

    async def run(self) -> int:
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, self._stop.set)
        edge, near, telemetry = (f"tcp/127.0.0.1:{port}" for port in _free_ports(3))
        hub = ZenohBus(listen=[telemetry], mode="router")
        hub.subscribe(TICKS_KEY.format(robot=self._config.robot.name), self._status.take_ticks)
        hub.subscribe(LINK_KEY, self._status.take_link)
        print(f"run folder: {self._out}", flush=True)
        try:
            code = await self._play(edge=edge, near=near, telemetry=telemetry)
        finally:
            self._terminal.clear()
            await self._supervisor.stop()
            hub.close()
        return self._finish(code)

    async def _play(self, *, edge: str, near: str, telemetry: str) -> int:
        start = self._supervisor.start
        direct = self._config.link.network == "direct"
        steps = [self._service("edge", "edge_node", telemetry, "--listen", edge)]
        if not direct:
            steps.append(
                self._service("netem", "netem", telemetry, "--listen", near, "--connect", edge)
            )
        if self._view != "off":
            steps.append(
                self._service("viewer", "viewer", telemetry, "--view", self._view, vital=False)
            )
        target = edge if direct else near
        steps.append(self._service("robot", "robot_node", telemetry, "--connect", target))
        for service in steps:
            starting = asyncio.create_task(start(service))
            stopping = asyncio.create_task(self._stop.wait())
            await asyncio.wait({starting, stopping}, return_when=asyncio.FIRST_COMPLETED)
            stopping.cancel()
            if self._stop.is_set():
                starting.cancel()
                return _INTERRUPTED
            try:
                await starting
            except LinkError as error:
                if service.vital:
                    raise
                self._terminal.say("viewer", f"going on without a live view: {error}")
                self._view = "off"
        return await self._watch()

    async def _watch(self) -> int:
        ending = asyncio.create_task(self._supervisor.wait())
        while not ending.done():
            if self._stop.is_set():
                self._terminal.say("up", "stopping")
                ending.cancel()
                return _INTERRUPTED
            self._terminal.show(self._status.line())
            await asyncio.wait({ending}, timeout=_STATUS_SECONDS)
        service, code = ending.result()
        if service.name != "robot":
            self._terminal.clear()
            raise LinkError(
                f"{service.name} ended (exit {code}) before the robot: everything was stopped; its "
                f"log is {self._out / service.name}.log"
            )
        await self._linger()
        return code

    async def _linger(self) -> None:
        """Leave a view open for the person in front of it until Ctrl-C or until it is closed."""
        if self._view == "off" or not sys.stdin.isatty():
            return
        self._terminal.clear()
        self._terminal.say("up", "the run is over; the view stays open, Ctrl-C ends it")
        while self._supervisor.running("viewer") and not self._stop.is_set():
            await asyncio.sleep(_STATUS_SECONDS)

    def _service(
        self, name: str, module: str, telemetry: str, *arguments: str, vital: bool = True
    ) -> Service:
        subcommand = ("live",) if module == "viewer" else ()
        command = (
            sys.executable,
            "-m",
            module,
            *subcommand,
            *("--config", str(self._out / "config.toml")),
            *("--telemetry", telemetry),
            *("--out", str(self._out)),
            *arguments,
        )
        return Service(name, command, ready_seconds=60.0, vital=vital)

    def _finish(self, code: int) -> int:
        parts = {name: self._part(file) for name, file in _PARTS.items()}
        robot = parts["robot"]
        if robot is None:
            return code
        result = summary(
            self._config,
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

    def _discrepancy(self) -> np.ndarray:
        """Rows by which each tick's active set differs from the one the edge found for it."""
        files = [self._out / "telemetry.parquet", self._out / "edge.parquet"]
        if not all(file.exists() for file in files):
            return np.empty(0)
        (schema, rows), (_, solve_rows) = (read_parquet(file) for file in files)
        return task_discrepancy(schema, rows, solve_rows)

    def _record(self) -> None:
        """The recording of a run nobody watched, made from its files."""
        command = [sys.executable, "-m", "viewer", "record", str(self._out)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        for line in (done.stdout + done.stderr).splitlines():
            self._terminal.say("viewer", line)


def _run_folder(out: Path | None, config: RunConfig) -> Path:
    if out is None:
        network = config.link.network.replace("/", "-").replace(":", "-").strip(".-")
        stamp = time.strftime("%Y%m%d-%H%M%S")
        out = Path("runs") / f"{stamp}-{config.task}-{config.controller}-{network}"
    try:
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            raise ConfigError(f"out: expected a new or empty folder, {out} has files in it")
    except OSError as error:
        raise ConfigError(f"out: cannot create {out}: {error.strerror}") from None
    return out


def _resolve_view(view: str) -> str:
    if view != "auto":
        return view
    screen = sys.platform != "linux" or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
    if not screen:
        print("no screen: the run is recorded, not shown (--view web for a browser)", flush=True)
    return "native" if screen else "off"


def _free_ports(count: int) -> list[int]:
    sockets = [socket.socket() for _ in range(count)]
    try:
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]
    finally:
        for each in sockets:
            each.close()


if __name__ == "__main__":
    run(main)
