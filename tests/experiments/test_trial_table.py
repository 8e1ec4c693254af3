from __future__ import annotations

import pytest

from experiments.studies.trial_table import table_in_words, wilson_interval


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        # Newcombe, Statistics in Medicine 17 (1998), Table I, method 3.
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0000, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_intervals_are_those_published(successes, trials, low, high):
    # Published with four digits.
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=5e-5)
    mirrored = wilson_interval(trials - successes, trials)
    assert mirrored == pytest.approx((1 - high, 1 - low), abs=5e-5)


def test_without_trials_nothing_is_known():
    assert wilson_interval(0, 0) == (0.0, 1.0)


def test_the_table_in_words_has_the_means_of_those_that_stand():
    def row(cell, com_error_m, *, fell=False):
        return {"cell": cell, "fell": fell, "com_error_m": com_error_m, "error": None}

    rows = [row("a", 0.01), row("a", 0.02), row("a", 9.0, fell=True), row("b", None, fell=True)]
    assert table_in_words(rows, ["cell"]).splitlines() == [
        "cell  stood  95 %     CoM error [cm]",
        "a     2/3    21–94 %  1.5",
        "b     0/1    0–79 %   -",
    ]
