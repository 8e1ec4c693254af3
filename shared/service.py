"""What every process of the stack shares: flags, stop signal, telemetry hub, files of its part.

A service prints `READY …` once it can be used; whoever supervises it waits for that line.
"""

from __future__ import annotations

import argparse
import json
import signal
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

from shared.bus.zenoh_bus import ZenohBus
from shared.errors import ConfigError
from shared.telemetry import RowLog, Schema, write_parquet

EDGE_ENDPOINT = "tcp/127.0.0.1:7460"
NETEM_ENDPOINT = "tcp/127.0.0.1:7461"


class StopSignal:
    """Turns SIGINT and SIGTERM into a flag that loops look at."""

    def __init__(self) -> None:
        self.requested = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._request)

    def _request(self, number: int, frame: FrameType | None) -> None:
        self.requested = True


def add_service_arguments(parser: argparse.ArgumentParser) -> None:
    """Where a service reports to and where it leaves its files."""
    parser.add_argument("--out", metavar="DIR", type=Path, help="folder for this process's files")
    parser.add_argument(
        "--telemetry", metavar="ENDPOINT", help="hub to publish measurements to, never the link"
    )


class ServiceLog:
    """Rows of one service: on file while it runs, then Parquet and a JSON report in its folder.

    Without a folder the rows live in a temporary file, long enough to make the report.
    """

    def __init__(
        self, name: str, schema: Schema, *, out: Path | None, telemetry: str | None, key: str
    ) -> None:
        self.name = name
        self._out = out
        self._temporary = tempfile.TemporaryDirectory(prefix="remote-wbc-")
        self._hub = ZenohBus(connect=[telemetry], mode="client") if telemetry else None
        publish: Callable[[bytes], None] | None = None
        if self._hub is not None:
            publish = self._hub.publisher(key).publish
        if out is not None:
            try:
                out.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise ConfigError(f"out: cannot create {out}: {error.strerror}") from None
        folder = out if out is not None else Path(self._temporary.name)
        self.rows = RowLog(schema, path=folder / f"{name}.rows", publish=publish)

    def finish(self, report: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """End the log, turn its rows into Parquet, write and return `report(rows)`."""
        self.rows.close()
        rows = self.rows.rows()
        result = report(rows)
        if self._out is not None:
            write_parquet(self.rows.schema, rows, self._out / f"{self.name}.parquet")
            text = json.dumps(result, indent=2)
            (self._out / f"{self.name}.json").write_text(text + "\n", encoding="utf-8")
            assert self.rows.path is not None
            self.rows.path.unlink()
        if self._hub is not None:
            self._hub.close()
        self._temporary.cleanup()
        return result
