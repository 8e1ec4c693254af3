"""The table of `bench recording`: what counts as an error, a loss and an agreement."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import recording
from netem.profile import LOST
from shared.errors import LinkError

MS = 1_000_000


def test_errors_are_of_the_periods_that_both_have(monkeypatch):
    replayed = np.array([10 * MS, 20 * MS, LOST, 40 * MS, 50 * MS])
    recorded = np.array([10 * MS + 200_000, 20 * MS - 400_000, 7 * MS, LOST, 52 * MS])
    delays = np.stack([replayed, replayed]), np.stack([recorded, recorded])
    monkeypatch.setattr(recording, "record_replay", lambda network, out, seconds: delays)
    monkeypatch.setattr(recording, "cores_busy", lambda seconds: 0.0)
    lines = recording.run(seconds=5.0).splitlines()
    rows = [line.split() for line in lines if line.startswith(recording.NETWORKS)]
    assert len(rows) == len(recording.NETWORKS) * 2 * 2  # generations and ways
    assert rows[0][3:] == ["5", "25.00%", "0.400", "1.968", "2.000", "66.7%"]


def test_a_recording_of_nothing_is_an_error(monkeypatch):
    nothing = np.full((2, 3), LOST)
    monkeypatch.setattr(recording, "record_replay", lambda network, out, seconds: (nothing,) * 2)
    monkeypatch.setattr(recording, "cores_busy", lambda seconds: 0.0)
    with pytest.raises(LinkError, match="nothing was recorded"):
        recording.run(seconds=5.0)
