from __future__ import annotations

import numpy as np
import pytest

from shared.wbc.finite import all_finite


@pytest.mark.parametrize("largest", [0.0, 1.0, 1e200, np.finfo(float).max], ids=str)
def test_numbers_are_finite_however_large(largest):
    assert all_finite(np.full(31, largest))
    assert all_finite(np.full((3, 4), -largest))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf], ids=str)
@pytest.mark.parametrize("others", [0.0, 1e200], ids=str)
def test_one_number_that_is_not_finite_is_found(bad, others):
    for k in (0, 17, 30):
        numbers = np.full(31, others)
        numbers[k] = bad
        assert not all_finite(numbers)


def test_of_no_numbers_all_are_finite():
    assert all_finite(np.empty(0))
