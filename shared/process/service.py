"""The parts that the stack's processes share: flags, name, stop signal, telemetry hub, files.

A service prints `READY …` once it can be used; its supervisor waits for that line.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType, UnionType
from typing import Any

import numpy as np

from shared.bus.security import DEFAULT_FOLDER, Credentials, robot_role
from shared.bus.zenoh_bus import ZenohBus
from shared.errors import ConfigError, writing
from shared.telemetry.lives import begin_life
from shared.telemetry.parquet import write_parquet
from shared.telemetry.row_log import MAX_ROWS, RowLog
from shared.telemetry.schema import Schema
from shared.wire.operator.events import CommandEvent, read_events

EDGE_ENDPOINT = "tcp/127.0.0.1:7460"
NETEM_ENDPOINT = "tcp/127.0.0.1:7461"
# Enough for a report, and for the summary and the log lines of the whole run.
_ROOM_BYTES = 262_144


class StopSignal:
    """Turns SIGINT and SIGTERM into a flag that loops look at."""

    def __init__(self) -> None:
        self.requested = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._request)

    def _request(self, number: int, frame: FrameType | None) -> None:
        self.requested = True


def add_service_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options for a service's files, its telemetry hub and its name on the link."""
    parser.add_argument("--out", metavar="DIR", type=Path, help="folder for this process's files")
    parser.add_argument(
        "--telemetry", metavar="ENDPOINT", help="hub for measurements, which never cross the link"
    )
    parser.add_argument(
        "--events",
        metavar="FILE",
        type=Path,
        help="commands at times of the task, of which this process carries out its own; needs "
        "--telemetry",
    )
    add_held_argument(parser)
    add_identity_arguments(parser)


def script_of(arguments: argparse.Namespace, kinds: UnionType) -> tuple[CommandEvent, ...]:
    """Return the events of `--events` with commands of these kinds, in the order of their times.

    Raise `ConfigError` if the file cannot be used, or if there is no hub with the robot's clock.
    """
    if arguments.events is None:
        return ()
    if arguments.telemetry is None:
        raise ConfigError("events: expected --telemetry too, for the robot's clock, got none")
    return tuple(each for each in read_events(arguments.events) if isinstance(each.command, kinds))


def add_held_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option to wait once the process has loaded."""
    parser.add_argument(
        "--held",
        action="store_true",
        help="load, then wait for the end of standard input before connecting",
    )


def wait_while_held(arguments: argparse.Namespace) -> None:
    """With `--held`, wait until standard input ends.

    Call this while a signal still ends the process.
    """
    if arguments.held:
        sys.stdin.read()


def add_identity_arguments(parser: argparse._ActionsContainer) -> None:
    """Add the options for a robot's name and the certificates to a parser or a group."""
    parser.add_argument(
        "--name",
        type=_names,
        help="the robot's name on the link, to tell several robots of a kind apart; amy,bob for an "
        "edge that serves both",
    )
    add_secure_argument(parser)


def add_secure_argument(parser: argparse._ActionsContainer) -> None:
    """Add the option for the folder of certificates to a parser or a group."""
    parser.add_argument(
        "--secure",
        metavar="DIR",
        nargs="?",
        type=Path,
        const=Path(DEFAULT_FOLDER),
        help="mutual TLS and access control, with the certificates that deploy/keys made "
        "(default %(const)s)",
    )


@dataclass(frozen=True)
class Identity:
    """The names of the robots that this process deals with, and its credentials.

    Without credentials nothing is secured.
    """

    robots: tuple[str, ...]
    credentials: Credentials | None

    @property
    def robot(self) -> str:
        """The name of the first robot, for a process that deals with one."""
        return self.robots[0]


def names_on_the_link(text: str) -> tuple[str, ...]:
    """Return the names in `amy,bob`; raise `ConfigError` if one cannot be part of a key."""
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        robot_role(name)
    return names


def _names(text: str) -> str:
    names_on_the_link(text)
    return text


def identity_from(
    arguments: argparse.Namespace, *, role: str | None, kind: str, several: bool = False
) -> Identity:
    """Return the identity of a service; `role` None is the robot itself.

    The robot's name is that of its `kind`, unless --name gives another; with `several`, it may give
    more than one.
    """
    name: str = kind if arguments.name is None else arguments.name
    robots = names_on_the_link(name) if several else (name,)
    robots_role = robot_role(robots[0])
    if arguments.secure is None:
        return Identity(robots, None)
    credentials = Credentials.load(arguments.secure, role or robots_role, robots=robots)
    return Identity(robots, credentials)


class ServiceLog:
    """The rows of one service: in a file while it runs, then as Parquet with a JSON report.

    Without a folder `out`, the rows are in a temporary file until the report is made. `complete` is
    that of a `RowLog`.
    """

    def __init__(
        self,
        name: str,
        schema: Schema,
        *,
        out: Path | None,
        telemetry: str | None,
        key: str,
        complete: Callable[[np.ndarray], None] | None = None,
    ) -> None:
        self._out = out
        self._temporary = tempfile.TemporaryDirectory(prefix="remote-wbc-")
        # The session of the telemetry, which never crosses the link; None without a hub.
        self.hub = ZenohBus(connect=[telemetry], mode="client") if telemetry else None
        if out is not None:
            try:
                out.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise ConfigError(f"out: cannot create {out}: {error.strerror}") from None
        self._folder = out if out is not None else Path(self._temporary.name)
        self.name = name
        self.rows = self._open(name, schema, key=key, complete=complete)
        self._beside: dict[str, RowLog] = {}

    def beside(self, name: str, schema: Schema, *, key: str) -> RowLog:
        """Return another log of the service. It has its own file of rows and no report."""
        self._beside[name] = self._open(name, schema, key=key)
        return self._beside[name]

    def _open(
        self,
        name: str,
        schema: Schema,
        *,
        key: str,
        complete: Callable[[np.ndarray], None] | None = None,
    ) -> RowLog:
        publish = None if self.hub is None else self.hub.publisher(key).publish
        if self._out is not None:
            begin_life(self._out, name)
        # Rows for which the file has no room are still published.
        path = self._folder / f"{name}.rows"
        with writing(path, what="out"):
            return RowLog(schema, path=path, publish=publish, at_most=MAX_ROWS, complete=complete)

    def row(self) -> np.ndarray:
        """Return the next row to fill."""
        return self.rows.row()

    def finish(self, report: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """End the logs, write and return `report(rows)`, and write all rows as Parquet.

        Print a line for files that cannot be written. Their rows stay in the file of rows.
        """
        # Small files first.
        logs = {**self._beside, self.name: self.rows}
        for log in logs.values():
            log.close()
        result = report(self.rows.rows())
        if self._out is not None:
            failure = next((log.failure for log in logs.values() if log.failure), None)
            try:
                self._write_report(result)
                for name, log in logs.items():
                    write_parquet(log.schema, log.rows(), self._out / f"{name}.parquet")
                    (self._out / f"{name}.rows").unlink()
            except OSError as error:
                failure = failure or error
            if failure is not None:
                print(
                    f"cannot write all of {self.name}'s files into {self._out}: "
                    f"{failure.strerror or failure}; free space on the disk, or try another --out",
                    flush=True,
                )
        if self.hub is not None:
            self.hub.close()
        self._temporary.cleanup()
        return result

    def _write_report(self, result: dict[str, Any]) -> None:
        """Write the report; on a full disk, remove the last rows to make room."""
        assert self._out is not None
        path, text = self._out / f"{self.name}.json", json.dumps(result, indent=2) + "\n"
        try:
            path.write_text(text, encoding="utf-8")
        except OSError:
            self.rows.give_way(_ROOM_BYTES)
            path.write_text(text, encoding="utf-8")
