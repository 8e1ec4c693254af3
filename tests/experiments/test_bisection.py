"""A bisection asks for the same trials whatever happens, and ends where standing does."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from experiments.studies.bisection import Limit, limits, limits_in_words, median_interval
from experiments.studies.trial_sequence import Bisection
from shared.errors import ConfigError

STUDY = """
seeds = 2
[grid]
controller = ["la", "pr"]
[bisect]
setting = "link.network"
value = "constant:{}ms"
high = 100
resolution = 10
"""


def asked_and_found(bisection, stands):
    """The integers that a search asks for, and what it finds."""
    search, asked = bisection.search(), []
    at = next(search)
    while True:
        asked.append(at)
        try:
            at = search.send(stands(at))
        except StopIteration as end:
            return asked, end.value


def rows_of(study, stands, *, error=None):
    """Rows of a sweep in which a robot stands as it is told by controller, seed and integer."""
    rows = []
    for sequence in study.sequences():

        def outcome(trial):
            label = trial.label
            at = int(label["link.network"].removeprefix("constant:").removesuffix("ms"))
            key = (label["controller"], label["seed"], at)
            fell = None if key == error else not stands(*key)
            rows.append({**label, "fell": fell, "error": "E: x" if key == error else None})
            return "error" if key == error else "fell" if fell else "stood"

        sequence.follow(outcome)
    return rows


@given(
    low=st.integers(-50, 50),
    width=st.integers(1, 2000),
    resolution=st.integers(1, 100),
    limit=st.integers(-100, 2100),
)
def test_a_monotone_robot_has_its_limit_between_standing_and_falling(low, width, resolution, limit):
    bisection = Bisection({"x": 1}, low, low + width, min(resolution, width))
    asked, (standing, falling) = asked_and_found(bisection, lambda at: at <= limit)
    assert asked[0] == bisection.high
    assert len(asked) == len(set(asked)) <= bisection.max_trials
    if limit >= bisection.high:
        assert (standing, falling) == (bisection.high, None)
    else:
        assert standing <= max(limit, low) < falling
        assert falling - standing <= bisection.resolution
        assert standing in {low, *asked}
        assert falling in asked


def test_so_many_trials_are_needed_at_most_and_no_fewer_in_the_worst_case():
    bisection = Bisection({"x": 1}, 0, 400, 1)
    max_trials = max(
        len(asked_and_found(bisection, lambda at, k=k: at <= k)[0]) for k in range(400)
    )
    # 400 is played first, then ⌈log₂ 400⌉ = 9 halvings.
    assert max_trials == bisection.max_trials == 10


def test_a_robot_that_is_not_monotone_gets_one_of_the_places_where_it_falls():
    bisection = Bisection({"x": 1}, 0, 100, 1)
    stands = {*range(21), *range(40, 61)}
    asked, found = asked_and_found(bisection, lambda at: at in stands)
    assert found == (60, 61)
    assert asked == [100, 50, 75, 62, 56, 59, 60, 61]


def test_every_value_follows_the_integer():
    values = {"a": "constant:{}ms/{}ms", "b": 1000, "c": ["{}N", "5N"], "d": 0.5}
    assert Bisection(values, 0, 9, 1).settings(7) == {
        "a": "constant:7ms/7ms", "b": 7000, "c": ["7N", "5N"], "d": 3.5
    }  # fmt: skip


def test_limits_are_of_every_cell_and_seed(study_of):
    study = study_of(STUDY)
    ends = {("la", 0): 53, ("la", 1): 100, ("pr", 0): 0, ("pr", 1): 33}
    rows = rows_of(study, lambda controller, seed, at: at <= ends[controller, seed])
    expected = [
        Limit({"controller": "la"}, 0, 50, 56),
        Limit({"controller": "la"}, 1, 100, None),
        Limit({"controller": "pr"}, 0, 0, 6),
        Limit({"controller": "pr"}, 1, 31, 37),
    ]
    assert limits(study, rows) == expected
    # In whatever order the rows are.
    assert limits(study, rows[::-1]) == expected
    assert limits_in_words(study, expected, rows).splitlines() == [
        "the largest n that stood, link.network = constant:{}ms, n from 0 to 100, resolution 10",
        "controller  limits  median  interval of the median  least  most",
        "la          2       75      50 … ≥ 100 (50.0 %)     50     ≥ 100",
        "pr          2       15.5    0 … 31 (50.0 %)         0      31",
    ]


def test_without_all_its_trials_a_bisection_has_no_limit(study_of):
    study = study_of(STUDY)
    rows = rows_of(study, lambda controller, seed, at: at <= 53, error=("la", 0, 50))
    found = limits(study, rows)
    assert found[0] == Limit({"controller": "la"}, 0, None, None)
    # It ends there: at 100 it fell, at 50 was the error.
    assert len([row for row in rows if row["controller"] == "la" and row["seed"] == 0]) == 2
    errors = "trials without a result: 1; the first: E: x"
    assert errors in limits_in_words(study, found, rows)
    assert all(limit.standing == 50 for limit in found[1:])
    unfinished = [row for row in rows if row["link.network"] != "constant:56ms"]
    assert all(limit.standing is None for limit in limits(study, unfinished))
    assert limits_in_words(study, limits(study, []), []).splitlines()[2].split() == [
        *("la", "0"), *"----"
    ]  # fmt: skip


def test_a_study_without_a_bisection_has_no_limits(study_of):
    with pytest.raises(ConfigError, match=r"study short: expected a study with \[bisect\]"):
        limits(study_of("seeds = 1"), [])


@pytest.mark.parametrize("confidence", [0.5, 0.9, 0.95, 0.99])
@pytest.mark.parametrize("n", range(1, 41))
def test_the_interval_is_the_narrowest_that_the_binomial_allows(n, confidence):
    found = median_interval(range(n), confidence=confidence)
    assert found.median == (n - 1) / 2
    k = int(found.low) + 1
    assert found.high == n - k
    # The k-th smallest is above the true median if fewer than k values are below it.
    outside = 2 * binom.cdf(k - 1, n, 0.5)
    assert found.coverage == pytest.approx(1 - outside, abs=1e-12)
    assert found.coverage >= confidence or k == 1
    if k < (n + 1) // 2:
        assert 1 - 2 * binom.cdf(k, n, 0.5) < confidence


def test_the_interval_of_ten_seeds_leaves_one_out_at_either_end():
    found = median_interval([31, 25, 28, 90, 27, 26, 29, 30, 24, 5])
    assert (found.median, found.low, found.high) == (27.5, 24, 31)
    # 1 − 2 (1 + 10)/2¹⁰.
    assert found.coverage == 1002 / 1024
    with pytest.raises(ValueError, match="at least one value"):
        median_interval([])
