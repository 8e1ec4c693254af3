"""What a study cannot be is refused in one line that says what was expected."""

from __future__ import annotations

import pytest

from experiments.studies.study_file import read_study
from shared.errors import ConfigError

BISECT_LOOP = "[bisect]\nsetting = 'loop.period_ns'\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seeds = 0", "seeds: expected a number of at least 1, got 0"),
        ("seeds = true", "seeds: expected a number of at least 1, got True"),
        ("seed = 3", "expected one of name, description, seeds, "),
        ("[base]\nseed = 3", "seed: expected seeds, the number of seeds of a study, got"),
        ("[base]\nwalk.stepp = 3", "the only cell: walk.stepp: expected some of steps"),
        ("base = 3", "base: expected a table of settings, got 3"),
        ("[base]\nlink.network = 'constant:1'", "expected a duration as in 30ms"),
        ("[base]\nlink.network = 'profiles:x'", "expected one of profiles:building, profiles:fac"),
        ("[base]\n'walk.steps' = 1\nwalk.steps = 2", "base.walk.steps: expected once, got it twic"),
        ("[grid]", "grid: expected lists of values, got an empty table"),
        ("[grid]\ntask = []", "grid.task: expected a list of different values, got []"),
        ("[grid]\ntask = 'walk'", "grid.task: expected a list of different values, got 'walk'"),
        ("[grid]\nloop.hold_after = [1, 1]", "expected a list of different values, got [1, 1]"),
        ("[grid]\npush = ['1N@1s:1s:+x']", "push=1N@1s:1s:+x: push: expected a list of strings"),
        ("[grid]\ntask = ['walk']\n[[cells]]\nname = 'a'\ntask = 'walk'", "got it in two"),
        ("[[cells]]\ntask = 'walk'", "cells: expected a different name in each, got None"),
        (
            "[[cells]]\nname = 'a'\n[[cells]]\nname = 'b'\nwalk.x = 1",
            "b: walk.x: expected some",
        ),
        ("columns = 'fell'", "columns: expected a list of fields of a summary, got 'fell'"),
        ("[random]\npush = 3", "random.push: expected { kind = "),
        (
            "[random]\nloop.hold_after = { kind = 'uniform', low = 1 }",
            "random.loop.hold_after: exp",
        ),
        ("[random]\npush = { kind = 'gust' }", "random.push: expected { kind = "),
        ("[random]\nlink.outage = { kind = 'cut' }", "random.link.outage: expected { kind = "),
        (
            "[random]\nlink.outage = { kind = 'cut', start = 3.0 }",
            "random.link.outage: expected { kind = ",
        ),
        ("seeds =", "is not valid TOML"),
        ("all_active_sets = 1", "all_active_sets: expected true or false, got 1"),
        (
            "[base]\nlink.network = 'generated:x'",
            "expected a scenario and a seed as in",
        ),
        ("quick = 1", "quick: quick: expected a table of settings, got 1"),
        ("[quick]\nseeds = 0", "quick: seeds: expected a number of at least 1, got 0"),
        ("[quick]\ntask = ['walk']", "quick: task: expected one of seeds, cells, bisect.low"),
        ("[quick]\nbisect.high = 3", "quick: bisect.high: expected one of seeds, cells"),
        (
            "[grid]\ntask = ['walk']\n[quick]\ntask = []",
            "quick: grid.task: expected a list",
        ),
        ("[quick]\ncells = ['a']", "quick: cells: expected names among none, got ['a']"),
        ("[[cells]]\nname = 'a'\n[quick]\ncells = []", "expected names among a, got []"),
        ("bisect = 3", "bisect: expected a table, got 3"),
        ("[bisect]\nsettings = 'x'", "bisect: expected one of setting, value, low, "),
        ("[bisect]\nvalue = 1\nhigh = 9", "bisect.setting: expected the name of a setting, got N"),
        (f"{BISECT_LOOP}value = 'x'\nhigh = 9", "bisect.value: expected text with {} for the inte"),
        (f"{BISECT_LOOP}value = 0\nhigh = 9", "or a number to multiply by it, got 0"),
        (f"{BISECT_LOOP}value = true\nhigh = 9", "or a number to multiply by it, got True"),
        (f"{BISECT_LOOP}value = []\nhigh = 9", "or a number to multiply by it, got []"),
        (f"{BISECT_LOOP}value = 1", "bisect: expected integers low < high and a resolution from"),
        (f"{BISECT_LOOP}value = 1\nhigh = 0", "low = 0, high = 0, resolution = 1"),
        (f"{BISECT_LOOP}value = 1\nhigh = 9.0", "low = 0, high = 9.0, resolution = 1"),
        (f"{BISECT_LOOP}value = 1\nhigh = 9\nresolution = 10", "high = 9, resolution = 10"),
        (
            f"{BISECT_LOOP}value = 1\nhigh = 9\nalso = 1",
            "bisect.also: expected a table",
        ),
        (
            f"{BISECT_LOOP}value = 1\nhigh = 9\nalso = {{ loop = {{ period_ns = 1 }} }}",
            "bisect.also: expected settings other than the bisected one, got loop.period_ns",
        ),
        (
            f"{BISECT_LOOP}value = 1\nhigh = 9\nalso = {{ task = 'walk' }}",
            "bisect.also.task: expected text with {}",
        ),
        (
            f"{BISECT_LOOP}value = 1\nhigh = 9\n[grid]\nloop.period_ns = [1, 2]",
            "loop.period_ns: expected in one of grid, cells, random and bisect, got it in two",
        ),
        (
            "[bisect]\nsetting = 'seed'\nvalue = 1\nhigh = 9",
            "seed: expected seeds, the number of seeds",
        ),
        (
            "[bisect]\nsetting = 'x.y'\nvalue = 1\nhigh = 9",
            "only cell: x: expected some of task",
        ),
    ],
)
def test_a_bad_study_is_an_error_in_one_line(study_of, text, message):
    with pytest.raises(ConfigError) as caught:
        study_of(text)
    assert message in str(caught.value)
    assert "short" in str(caught.value)  # which study
    assert "\n" not in str(caught.value)


def test_a_study_without_quick_has_no_quick_form(study_of):
    with pytest.raises(ConfigError, match=r"short: quick: expected a table \[quick\] in the study"):
        study_of("seeds = 1", quick=True)


def test_an_unknown_study_lists_those_shipped():
    with pytest.raises(ConfigError, match=r"corrected-push, .*table4, .*got 'wolk'"):
        read_study("wolk")
