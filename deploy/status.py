"""What a person sees in the terminal: the services' lines and one live status line."""

from __future__ import annotations

import shutil
import sys
import time

import numpy as np

from shared.bus.base import Delivery
from shared.report import SOURCES
from shared.telemetry import Schema, decode_rows

_COLOURS = {
    "edge": "\033[34m",
    "netem": "\033[33m",
    "robot": "\033[32m",
    "viewer": "\033[35m",
    "router": "\033[36m",
}
_RESET, _CLEAR_LINE = "\033[0m", "\r\033[2K"
_PLAIN_PERIOD_SECONDS = 1.0


class Terminal:
    """Prints services' lines with their name; keeps the status line last."""

    def __init__(self) -> None:
        self._live = sys.stdout.isatty()
        self._status = ""
        self._last_plain = 0.0

    def say(self, name: str, line: str) -> None:
        """One line of a service."""
        if self._live:
            colour = _COLOURS.get(name, "")
            print(f"{_CLEAR_LINE}{colour}{name:>6} │{_RESET} {line}\n{self._status}", end="")
            sys.stdout.flush()
        else:
            print(f"{name:>6} | {line}", flush=True)

    def show(self, status: str) -> None:
        """The status line: in place on a terminal, once a second elsewhere."""
        if self._live:
            self._status = status[: shutil.get_terminal_size().columns - 1]
            print(f"{_CLEAR_LINE}{self._status}", end="", flush=True)
        elif time.monotonic() - self._last_plain >= _PLAIN_PERIOD_SECONDS:
            self._last_plain = time.monotonic()
            print(f"status | {status}", flush=True)

    def clear(self) -> None:
        """Remove the status line."""
        if self._live and self._status:
            print(_CLEAR_LINE, end="", flush=True)
        self._status = ""


class Status:
    """The latest of what the services publish, as one line."""

    def __init__(self, *, duration: float) -> None:
        self._duration = duration
        self._tick: tuple[Schema, np.ndarray] | None = None
        self._delay_ms = ["-", "-"]

    def take_ticks(self, delivery: Delivery) -> None:
        """Block of the robot's rows."""
        self._tick = decode_rows(delivery.data)

    def take_link(self, delivery: Delivery) -> None:
        """Block of the shim's rows."""
        schema, rows = decode_rows(delivery.data)
        directions, achieved = schema.column(rows, "direction"), schema.column(rows, "achieved_ns")
        for direction in (0, 1):
            way = achieved[directions == direction]
            if way.size:
                self._delay_ms[direction] = "lost" if way[-1] < 0 else f"{way[-1] * 1e-6:.1f}"

    def line(self) -> str:
        """One line; says that it waits until the robot has begun."""
        if self._tick is None:
            return "waiting for the robot"
        schema, rows = self._tick
        last = {name: rows[-1, where][0] for name, where in schema.slices.items()}
        time_ns = last["time_ns"]
        if time_ns < 0:
            return "robot waits for its first projector"
        age = f"{last['projector_age_ns'] * 1e-6:.1f}" if last["projector_age_ns"] >= 0 else "-"
        pushed = " push!" if np.any(schema.column(rows, "push_n")) else ""
        return (
            f"t {time_ns * 1e-9:5.2f}/{self._duration:g} s | {SOURCES[int(last['source'])]:<9}"
            f" | link up {self._delay_ms[0]} down {self._delay_ms[1]} ms"
            f" | projector age {age} ms | CoM error {100 * last['com_error_m']:.1f} cm"
            f" | overruns {int(last['overruns'])}{pushed}"
        )
