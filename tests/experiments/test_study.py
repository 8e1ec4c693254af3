"""Studies become trials: what can be asked for, and what is refused in one line."""

from __future__ import annotations

import pytest
import tomli_w

from experiments.studies.study import draw
from experiments.studies.study_file import DEFAULT_SEEDS, SHIPPED, read_study
from netem.networks import shipped_names
from shared.errors import ConfigError
from shared.toml_file import read_toml

PUSH = {"kind": "push", "force": 40.0, "duration": 0.2, "start": [1.0, 6.0], "directions": ["+x"]}


def shown(study):
    return [cell.shown for cell in study.cells]


def test_every_combination_of_the_grid_with_every_named_cell_is_a_cell(study_of):
    study = study_of(
        """
        [base]
        task = "walk"
        "walk.steps" = 4
        [grid]
        controller = ["la", "pr"]
        [grid.link]
        network = ["constant:3ms", "constant:5ms"]
        [[cells]]
        name = "short"
        walk.step_length = 0.05
        [[cells]]
        name = "as it is"
        """
    )
    assert len(study.cells) == 2 * 2 * 2
    assert shown(study)[1] == {
        "cell": "short", "controller": "la", "link.network": "constant:5ms"
    }  # fmt: skip
    assert study.cells[-1].settings == {
        "task": "walk", "walk.steps": 4, "controller": "pr", "link.network": "constant:5ms"
    }  # fmt: skip
    # What varies is in every row, with its default where a cell does not set it.
    assert {trial.label["walk.step_length"] for trial in study.trials} == {0.05, 0.1}
    assert len({trial.identity for trial in study.trials}) == 8 * study.seeds


def test_without_grid_and_cells_there_is_one_cell(study_of):
    study = study_of("seeds = 3")
    assert [trial.label for trial in study.trials] == [{"seed": k} for k in range(3)]
    assert str(study.cells[0]) == "the only cell"


def test_a_setting_of_a_table_that_has_a_kind_is_a_setting_like_any_other(study_of):
    study = study_of(
        '[[cells]]\nname = "as it is"\n[[cells]]\nname = "rigid"\nplant.kind = "rigid"'
    )
    assert [trial.label["plant.kind"] for trial in study.trials[:2]] == ["mujoco", "rigid"]
    assert [trial.config.plant.kind for trial in study.trials[:2]] == ["mujoco", "rigid"]


def test_a_value_may_be_a_list_in_the_base_and_in_the_grid(study_of):
    push = '"100N@1.0s:0.2s:+y"'
    in_base = study_of(f"[base]\npush = [{push}]")
    in_grid = study_of(f"[grid]\npush = [[{push}], []]")
    pushes = [trial.config.push for trial in in_grid.trials[:2]]
    assert pushes == [("100N@1.0s:0.2s:+y",), ()]
    assert in_base.trials[0].config.push == pushes[0]
    assert in_grid.cells[1].names == ["push=none"]


def test_seed_k_gets_the_kth_profile_and_after_the_last_the_first_again(study_of):
    names = [name for name in shipped_names() if name.startswith("factory/")]
    study = study_of(f'seeds = {len(names) + 1}\n[grid]\nlink.network = ["profiles:factory"]')
    networks = [trial.config.link.network for trial in study.trials]
    assert networks == [*names, names[0]]
    first, last = study.trials[0], study.trials[-1]
    assert (first.config.seed, last.config.seed) == (0, len(names))
    assert first.label["link.network"] == "profiles:factory"


def test_seed_k_gets_the_profile_generated_from_seed_k(study_of):
    study = study_of(
        'seeds = 3\n[grid]\nlink.network = ["generated:factory", "capacity:generated:building"]'
    )
    assert [trial.config.link.network for trial in study.trials] == [
        f"{kind}/{seed}"
        for seed in range(3)
        for kind in ("generated:factory", "capacity:generated:building")
    ]
    assert study.trials[2].label["link.network"] == "generated:factory"
    assert len({trial.identity for trial in study.trials}) == 6
    fixed = study_of('seeds = 2\n[base]\nlink.network = "generated:factory/7"')
    assert {trial.config.link.network for trial in fixed.trials} == {"generated:factory/7"}


def test_solving_all_active_sets_makes_it_another_trial(study_of):
    plain, all_sets = study_of("seeds = 1"), study_of("seeds = 1\nall_active_sets = true")
    (trial,), (other,) = plain.trials, all_sets.trials
    assert (trial.all_active_sets, other.all_active_sets) == (False, True)
    assert trial.config == other.config
    assert trial.identity != other.identity


QUICK = """
seeds = 5
[grid]
controller = ["la", "pr"]
link.network = ["constant:0ms", "constant:5ms"]
[[cells]]
name = "a"
walk.steps = 2
[[cells]]
name = "b"
walk.steps = 4
[quick]
seeds = 2
cells = ["b"]
link.network = ["constant:3ms"]
"""


def test_quick_changes_what_its_table_says_and_nothing_else(study_of):
    full, quick = study_of(QUICK), study_of(QUICK, quick=True)
    assert (full.seeds, len(full.cells)) == (5, 8)
    assert shown(quick) == [
        {"cell": "b", "controller": controller, "link.network": "constant:3ms"}
        for controller in ("la", "pr")
    ]
    assert quick.seeds == 2
    assert study_of(QUICK, quick=True, seeds=1).seeds == 1
    # What a quick sweep leaves in its folder is the quick study; a full one can still be quick.
    assert "quick" not in quick.table
    assert full.table["quick"] == {
        "seeds": 2, "cells": ["b"], "link": {"network": ["constant:3ms"]}
    }  # fmt: skip


def test_a_study_written_and_read_again_is_the_same(study_of):
    for text in (QUICK, BISECT):
        study = study_of(text)
        again = study_of(tomli_w.dumps(study.table))
        assert again == study
        assert again.trials == study.trials


BISECT = """
seeds = 2
[grid]
controller = ["la", "pr"]
[bisect]
setting = "link.network"
value = "constant:{}ms"
high = 400
[bisect.also]
loop.edge_compute_ns = 1000
push = ["{}N@1.0s:0.2s:+y", "10N@2.0s:0.2s:+y"]
[quick]
bisect.resolution = 40
"""


def test_a_bisection_begins_at_its_high_end_and_takes_other_settings_along(study_of):
    study = study_of(BISECT)
    assert len(study.trials) == 4
    assert study.trials[3].label == {
        "controller": "pr", "link.network": "constant:400ms", "seed": 1
    }  # fmt: skip
    for trial in study.trials:
        assert trial.config.link.network == "constant:400ms"
        assert trial.config.loop.edge_compute_ns == 400_000
        assert trial.config.push == ("400N@1.0s:0.2s:+y", "10N@2.0s:0.2s:+y")
    bisection = study.bisection
    assert (bisection.low, bisection.high, bisection.resolution) == (0, 400, 1)
    assert study_of(BISECT, quick=True).bisection.resolution == 40


def test_draws_depend_on_the_seed_and_the_setting_alone(study_of):
    random = (
        '[random]\npush = { kind = "push", force = 40.0, duration = 0.2, start = [1.0, 6.0], '
        'directions = ["+x"] }\n'
    )
    friction = 'plant.friction = { kind = "uniform", low = 0.4, high = 1.0 }\n'
    alone = study_of("seeds = 4\n" + random)
    among = study_of("seeds = 9\n[grid]\ntask = ['balance', 'walk']\n" + random + friction)
    for trial in among.trials:
        assert list(trial.config.push) == draw("push", PUSH, seed=trial.config.seed)
        assert 0.4 <= trial.config.plant.friction < 1.0
    pushes = [trial.config.push for trial in alone.trials]
    assert pushes == [trial.config.push for trial in among.trials if trial.cell == 0][:4]
    assert len(set(pushes)) == 4
    assert alone.trials[1].label["push"] == list(pushes[1])


def test_the_link_is_cut_at_a_random_time_of_the_span(study_of):
    study = study_of("seeds = 20\n[random]\nlink.outage = { kind = 'cut', start = [1.0, 1.5] }")
    outages = [trial.config.link.outages for trial in study.trials]
    assert all(each[0].duration_ns is None for each in outages)
    starts = [each[0].start_ns for each in outages]
    assert 1_000_000_000 <= min(starts) < max(starts) <= 1_500_000_000
    assert len(set(starts)) > 15


def test_a_draw_is_what_it_was_last_year():
    assert draw("push", PUSH, seed=3) == ["40.000N@1.659s:0.200s:+x"]


def test_a_name_that_no_cell_has_lists_those_there_are(study_of):
    study = study_of("[grid]\ncontroller = ['la', 'pr']")
    assert study.only(["controller=pr"]) == {1}
    with pytest.raises(ConfigError, match=r"expected one of controller=la, controller=pr, got 'x'"):
        study.only(["x"])


@pytest.mark.parametrize("name", [file.stem for file in SHIPPED.glob("*.toml")])
def test_shipped_studies_can_be_played(name):
    study = read_study(name, seeds=1)
    assert len(study.trials) == len(study.cells)
    assert len({trial.identity for trial in study.trials}) == len(study.trials)
    assert study.table["description"]
    if "quick" in study.table:
        quick = read_study(name, quick=True)
        seeds = read_toml(SHIPPED / f"{name}.toml", what="study").get("seeds", DEFAULT_SEEDS)
        assert quick.seeds * len(quick.cells) <= seeds * len(study.cells)


def test_the_walk_over_constant_delays_has_a_computer_on_board_as_slow_as_the_link():
    trials = read_study("table3", seeds=1).trials
    configs = [trial.config for trial in trials if trial.config.controller == "la"]
    delays = [config.link.network.partition(":")[2] for config in configs]
    assert delays == ["0ms", "3ms", "5ms", "25ms", "60ms", "100ms"]
    for delay, config in zip(delays, configs, strict=True):
        assert config.switch.ready_after_ns(0) == int(delay.removesuffix("ms")) * 1_000_000
