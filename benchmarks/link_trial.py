"""One trial of a path between two ends, and its comparison with the profile."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.link_end import ARRIVED, ECHOED, SENT, SEQUENCE
from benchmarks.link_paths import LinkPath, Started, started
from shared.telemetry.parquet import read_parquet
from shared.telemetry.schema import LINK_SCHEMA

_UP_BYTES, _DOWN_BYTES = 1_000, 40_000
_SETTLE_SECONDS = 1.0

Open = Callable[[Path], AbstractContextManager[LinkPath]]


@dataclass(frozen=True)
class LinkTrial:
    """The messages sent within a span of time.

    `arrivals` holds the arrivals at the far end and at the near end, uplink and downlink, (n, 4)
    each with the columns of `link_end`. `log` is the shim's log, empty without a shim. `processor`
    is the share of a core that the process in between took. `scheduling` is the scheduling of the
    near end.
    """

    arrivals: tuple[np.ndarray, np.ndarray]
    log: np.ndarray
    processor: float
    scheduling: str

    def round_trips_ns(self) -> np.ndarray:
        """Round trips of the answers to the near end's messages (n,) [ns]."""
        answers = self.arrivals[1]
        passed: np.ndarray = answers[:, ARRIVED] - answers[:, ECHOED]
        return passed


@dataclass(frozen=True)
class WayErrors:
    """Errors of one direction: achieved minus nominal delay of each message [ns], and what went
    wrong.

    `released_ns` lasts until the shim has handed the message on, `received_ns` until the receiver
    has it.
    """

    messages: int
    lost: int
    early: int
    swapped: int
    released_ns: np.ndarray
    received_ns: np.ndarray


def run_trial(open_path: Open, *, seconds: float, answer: bool) -> LinkTrial:
    """Send both ways for `seconds`. With `answer` the far end only answers."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with ExitStack() as stack:
            path = stack.enter_context(open_path(folder))

            def start(end: str, *options: str) -> Started:
                prefix = path.far_prefix if end == "far" else path.near_prefix
                out = ("--out", f"{folder}/{end}.npy")
                process = started("benchmarks.link_end", end, *out, *options, prefix=prefix)
                return stack.enter_context(process)

            answering = ("--answer",) if answer else ()
            far = start("far", "--endpoint", path.listen, "--bytes", str(_DOWN_BYTES), *answering)
            if path.between is not None:
                path.between.wait_for("READY")
            near = start("near", "--endpoint", path.dial, "--bytes", str(_UP_BYTES))
            for process in (far, near):
                process.wait_for("FIRST")
            time.sleep(_SETTLE_SECONDS)
            begin_ns, used_before = time.monotonic_ns(), _processor_seconds(path)
            time.sleep(seconds)
            end_ns, used_after = time.monotonic_ns(), _processor_seconds(path)
            for process in (far, near):
                process.end()
            scheduling = near.output.split("READY ")[1].splitlines()[0]
        up, down = (np.load(folder / f"{end}.npy") for end in ("far", "near"))
        log = folder / "link.parquet"
        rows = read_parquet(log)[1] if log.exists() else np.zeros((0, LINK_SCHEMA.width))
    return LinkTrial(
        arrivals=(_sent_within(up, begin_ns, end_ns), _sent_within(down, begin_ns, end_ns)),
        log=rows,
        processor=(used_after - used_before) / ((end_ns - begin_ns) * 1e-9),
        scheduling=scheduling,
    )


def _processor_seconds(path: LinkPath) -> float:
    return 0.0 if path.between is None else path.between.processor_seconds()


def way_errors(trial: LinkTrial, direction: int, *, one_way_ns: int | None) -> WayErrors:
    """Errors of one direction. The nominal delay is `one_way_ns`, or the delay in the shim's log if
    None.
    """
    arrivals = trial.arrivals[direction]
    sequence, sent_ns = arrivals[:, SEQUENCE], arrivals[:, SENT]
    released_ns = np.empty(0, dtype=np.int64)
    if one_way_ns is not None:
        nominal_ns = np.full(len(arrivals), one_way_ns)
    else:
        log = trial.log[LINK_SCHEMA.column(trial.log, "direction") == direction]
        numbers, nominals, achieved = (
            LINK_SCHEMA.column(log, name).astype(np.int64)
            for name in ("sequence", "nominal_ns", "achieved_ns")
        )
        order = np.argsort(numbers)
        found = order[np.searchsorted(numbers, sequence, sorter=order)]
        assert np.array_equal(numbers[found], sequence)
        nominal_ns = nominals[found]
        released_ns = achieved[found] - nominal_ns
    received_ns = arrivals[:, ARRIVED] - sent_ns - nominal_ns
    return WayErrors(
        messages=len(arrivals),
        lost=int(np.ptp(sequence)) + 1 - len(arrivals) if len(arrivals) else 0,
        early=int(np.sum(received_ns < 0)),
        swapped=int(np.sum(np.diff(sequence) < 0)),
        released_ns=released_ns,
        received_ns=received_ns,
    )


def _sent_within(arrivals: np.ndarray, begin_ns: int, end_ns: int) -> np.ndarray:
    sent_ns = arrivals[:, SENT]
    return arrivals[(sent_ns >= begin_ns) & (sent_ns < end_ns)]
