"""Romeo goes to a place over ground that it knows, also without the edge."""

from __future__ import annotations

import numpy as np
import pytest

STAIR = {
    "task": "go",
    "walk.goal": "0.5,0",
    "ground": "stairs:1x6cm",
    "link.network": "constant:10ms",
    "walk.begin_duration": 0.7,
    "walk.end_duration": 0.7,
    "duration": 6.2,
}


@pytest.mark.parametrize(
    "changes", [{"controller": "la"}, {"controller": "lc", "link.outage": ["cut@0.5s"]}], ids=str
)
def test_romeo_climbs_a_stair(play, changes):
    result = play(**{**STAIR, **changes})
    assert not result.summary["fell"]
    com = result.schema.column(result.rows, "com")
    assert com[-1, 0] > 0.45
    assert com[-1, 2] - com[0, 2] == pytest.approx(0.06, abs=0.01)
    reference = result.schema.column(result.rows, "com_reference")
    assert np.abs(com - reference).max() < 0.05
