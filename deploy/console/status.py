"""The state of a run in one line that fits the terminal, with the link's delay over time."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Iterable, Iterator

import numpy as np

from deploy.console.events import TOLD_NS, Event, Events
from shared.bus.base import Delivery
from shared.telemetry.row_log import decode_rows
from shared.telemetry.schema import LINK_SCHEMA, Schema, Source
from shared.wbc.contacts import ContactMode

# The columns whose numbers are times, kinds and forces.
_SHOWN = ("time_ns", "wall_ns", "source", "mode", "push_n", "projector_age_ns", "overruns")
# Beyond, a time is no count of nanoseconds.
_LIMIT = 2.0**62
_BARS = "▁▂▃▄▅▆▇█"
# The delays of the lowest and the highest bar; the scale is logarithmic [ms].
_LEAST_MS, _MAX_MS = 1.0, 1000.0
# The largest and the smallest number of bars.
_LONGEST, _SHORTEST = 40, 8


class Status:
    """The newest rows that the services publish, and the events in them.

    `ticks` are the columns of the robot's rows. `refused` counts the blocks that cannot be used. A
    run that `stays` has no end.
    """

    def __init__(
        self, ticks: Schema, *, duration: float, walks: bool = False, stays: bool = False
    ) -> None:
        self.events = Events()
        self.refused = 0
        self._ticks = ticks
        self._duration = duration
        self._walks = walks
        self._stays = stays
        self._rows: np.ndarray | None = None
        self._delay_ms: list[float | None] = [None, None]
        self._lost = [False, False]
        self._delays_ms: deque[float] = deque(maxlen=_LONGEST)

    def take_ticks(self, delivery: Delivery) -> None:
        """Take in a block of the robot's rows."""
        with self._refusing():
            _, rows = decode_rows(delivery.data, self._ticks)
            _check_finite(self._ticks, rows, _SHOWN)
            self._rows = rows
            self.events.take_ticks(self._ticks, rows)
            delay_ms = self._round_trip_ms(rows)
            if delay_ms is not None:
                self._delays_ms.append(delay_ms)

    def take_link(self, delivery: Delivery) -> None:
        """Take in a block of the shim's rows."""
        schema = LINK_SCHEMA
        with self._refusing():
            _, rows = decode_rows(delivery.data, schema)
            _check_finite(schema, rows, tuple(schema.slices))
            self.events.take_link(schema, rows)
            directions = schema.column(rows, "direction")
            achieved = schema.column(rows, "achieved_ns")
            for direction in (0, 1):
                way = achieved[directions == direction]
                if way.size:
                    self._lost[direction] = bool(way[-1] < 0)
                    if way[-1] >= 0:
                        self._delay_ms[direction] = way[-1] * 1e-6

    @contextlib.contextmanager
    def _refusing(self) -> Iterator[None]:
        """Count a block that cannot be used. No error reaches the thread of the bus."""
        try:
            yield
        except Exception:
            self.refused += 1

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        return self.events.take()

    def line(self, columns: int = 160) -> str:
        """Return a line of at most `columns` characters. Bars shrink first, then words.

        Until the robot has begun, the line says that it waits.
        """
        schema, rows = self._ticks, self._rows
        if rows is None:
            return "waiting for the robot"[:columns]
        last = {name: rows[-1, where][0] for name, where in schema.slices.items()}
        time_ns = last["time_ns"]
        if time_ns < 0:
            return "robot waits for its first projector"[:columns]
        source, age_ms = Source(last["source"]).label, last["projector_age_ns"] * 1e-6
        at = f"t {time_ns * 1e-9:5.2f}" + ("" if self._stays else f"/{self._duration:g}") + " s"
        up, down = self._way(0), self._way(1)
        com_cm, overruns = 100 * last["com_error_m"], int(last["overruns"])
        pushed = " push!" if np.any(schema.column(rows, "push_n")) else ""
        mode = ContactMode(int(last["mode"])).label if self._walks else ""
        refused = f"{self.refused} blocks refused" if self.refused else ""
        long = _joined(
            " | ",
            (f"{at} | {source:<9} | link up {up} down {down} ms", pushed),
            f"projector age {age_ms:.1f} ms" if age_ms >= 0 else "",
            f"CoM error {com_cm:.1f} cm",
            f"{mode:<10}" if mode else "",
            f"overruns {overruns}",
            refused,
        )
        short = _joined(
            "  ",
            (f"{at}  {source}  {up}/{down} ms", pushed),
            f"age {age_ms:.0f} ms" if age_ms >= 0 else "",
            f"CoM {com_cm:.1f} cm",
            f"overruns {overruns}",
            mode,
            refused,
        )
        before, after = long if len(long[0] + long[1]) <= columns else short
        room = min(columns - len(before + after) - 1, _LONGEST)
        if self._delays_ms and room >= _SHORTEST:
            before += f" {sparkline(list(self._delays_ms)[-room:]).ljust(room)}"
        return (before + after)[:columns]

    def _way(self, direction: int) -> str:
        if self._lost[direction]:
            return "lost"
        delay_ms = self._delay_ms[direction]
        return "-" if delay_ms is None else f"{delay_ms:.{1 if delay_ms < 100 else 0}f}"

    def _round_trip_ms(self, rows: np.ndarray) -> float | None:
        """Return the round trip [ms], or the time without a message if an outage makes it longer.

        The time without a message is the time since the last state came out of the shim, or the age
        of the answer in use. The age counts only if the answer is used as it came. Without a shim
        here the result is that age.
        """
        schema = self._ticks
        source = Source(schema.column(rows, "source")[-1]).label
        age_ns = float(schema.column(rows, "projector_age_ns")[-1])
        as_it_came = source in ("fresh", "cached") and age_ns >= 0
        if self._delay_ms[0] is None:
            return age_ns * 1e-6 if as_it_came else None
        known = sum(delay for delay in self._delay_ms if delay is not None)
        waited_ns = max(self.events.silence_ns, age_ns if as_it_came else 0)
        return max(known, waited_ns * 1e-6) if waited_ns >= TOLD_NS else known


def _check_finite(schema: Schema, rows: np.ndarray, names: Iterable[str]) -> None:
    """Raise `ValueError` if a column has a value that is impossible for a clock or a count."""
    for name in names:
        if not np.all(np.abs(schema.column(rows, name)) < _LIMIT):
            raise ValueError(f"{name}: expected finite numbers, got others")
    if "source" in schema.slices:
        for source in np.unique(schema.column(rows, "source")):
            Source(source)


def _joined(separator: str, ends: tuple[str, str], *parts: str) -> tuple[str, str]:
    """Return the text before and after the bars; empty parts are left out."""
    return ends[0], separator.join([ends[1], *(part for part in parts if part)])


def sparkline(delays_ms: Iterable[float]) -> str:
    """Return a bar for each delay.

    The scale is logarithmic from 1 ms to 1 s in every run, so that runs can be compared.
    """
    decades = math.log10(_MAX_MS / _LEAST_MS)
    bars = ""
    for delay in delays_ms:
        part = math.log10(max(delay, _LEAST_MS) / _LEAST_MS) / decades
        bars += _BARS[min(int(part * len(_BARS)), len(_BARS) - 1)]
    return bars
