"""The results of shared and dying edges: which tick belongs to which rate of the other robot."""

from __future__ import annotations

import numpy as np

from benchmarks.edges import _by_rate, _changes

S = 1_000_000_000


def test_the_ages_are_told_by_the_rate_of_the_other_robot() -> None:
    output = f"READY\nRATE {10 * S} 1000 0\nRATE {15 * S} 20000 5000\nRATE {20 * S} 1000 80000\n"
    changes = _changes(output)
    assert changes == [(10 * S, 1000, 0), (15 * S, 20_000, 5000), (20 * S, 1000, 80_000)]
    wall_ns = np.arange(9 * S, 21 * S, S // 1000)
    age_ns = np.where(wall_ns < 15 * S, 12e6, 15e6)
    # Just after a change, and after the last one, it is not known which rate acts.
    age_ns[(wall_ns >= 15 * S) & (wall_ns < 15.4 * S)] = 1e9
    age_ns[wall_ns >= 20 * S] = 1e9
    age_ns[(wall_ns >= 16 * S) & (wall_ns < 16 * S + 3_000_000)] = np.nan
    _, quiet, flooded = (
        line.split() for line in _by_rate(np.column_stack([wall_ns, age_ns]), changes)
    )
    assert quiet == ["1000", "1000", "4500", "0", "12.00", "12.00", "1.00"]
    assert flooded == ["20000", "15000", "4500", "3", "15.00", "15.00", "1.25"]
