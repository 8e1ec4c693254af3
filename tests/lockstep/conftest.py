"""Trials are played once per session and configuration, whichever tests look at them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments.lockstep import Lockstep, TrialResult
from netem.profile import LOST, DelayProfile
from shared.config.config_file import load_config

SEED = 0
# A walk of as little standing as the plans of all robots take.
SHORT_STANDS = {"walk.begin_duration": 0.6, "walk.end_duration": 0.8}


@pytest.fixture(scope="session")
def play() -> Callable[..., TrialResult]:
    """The result of a trial: `play(duration=1.0, **{"link.network": "direct"})`.

    States that the edge did not answer are solved afterwards only with `all_active_sets`: it takes
    as long as the trial.
    """
    played: dict[tuple[str, bool], TrialResult] = {}

    def trial(
        *, again: bool = False, all_active_sets: bool = False, **overrides: Any
    ) -> TrialResult:
        config = load_config(None, {"seed": SEED, **overrides})
        key = (repr(config), all_active_sets)
        if again or key not in played:
            played[key] = Lockstep(config, all_active_sets=all_active_sets).run()
        return played[key]

    return trial


@pytest.fixture
def trace(tmp_path: Path) -> Callable[[np.ndarray], str]:
    """A profile file from one-way delays in ms, shape (2, n), that a run begins at its first row.

    A run starts at an offset that its seed draws; the rows are rotated by that much.
    """

    def write(delays_ms: np.ndarray) -> str:
        profile = DelayProfile("trace", np.zeros(delays_ms.shape, dtype=np.int64))
        start = profile.start_offset_ns(SEED) // profile.period_ns
        rows = np.roll(delays_ms, start, axis=1).T
        path = tmp_path / "trace.csv"
        lines = [",".join("lost" if d == LOST else f"{d:g}" for d in row) for row in rows]
        path.write_text("uplink_ms,downlink_ms\n" + "\n".join(lines) + "\n")
        return str(path)

    return write
