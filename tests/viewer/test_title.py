"""Titles, the names of compared runs, and the colours."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from shared.config.config_file import load_config
from shared.config.settings import RunConfig
from viewer import colours
from viewer.title import compared_names, compared_title, title

# Below this distance in RGB two colours look alike on a dark ground.
APART = 40.0


def config_of(controller: str, network: str = "factory/011") -> RunConfig:
    return load_config(None, {"controller": controller, "link.network": network})


def folders(*names: str) -> list[Path]:
    return [Path("runs") / name for name in names]


def test_a_title_says_robot_task_controller_link_and_verdict() -> None:
    cut = load_config(None, {"controller": "lc", "link.outage": ("cut@3s",)})
    assert title(cut, "stands") == "### Romeo · balance · LC · factory/001, cut@3s · stands"


def test_compared_runs_are_named_by_what_differs() -> None:
    configs = [config_of("la"), config_of("pr")]
    names = compared_names(configs, folders("20261129-101500-a", "20261129-101500-b"))
    assert names == ["LA", "PR"]
    text = compared_title(configs, names, ["stands", "fell at 1.37 s"])
    assert text == "### Romeo · balance · factory/011 · LA stands, PR fell at 1.37 s"
    both = [config_of("la"), config_of("pr", "constant:5ms")]
    assert compared_names(both, folders("a", "b")) == ["LA, factory/011", "PR, constant:5ms"]


def test_runs_of_one_kind_are_named_by_what_differs_in_their_folders() -> None:
    configs = [config_of("la")] * 2
    assert compared_names(configs, folders("push-100N-la", "push-120N-la")) == ["100N", "120N"]
    assert compared_names(configs, folders("push", "push-2")) == ["push", "push-2"]
    assert compared_names(configs, [Path("a/la"), Path("b/la")]) == ["a/la", "b/la"]


def test_a_colour_has_one_meaning() -> None:
    marks = [
        value
        for name, value in vars(colours).items()
        if name.isupper() and isinstance(value, tuple) and isinstance(value[0], int)
    ]
    tables = (colours.LINK_STATES, colours.SOURCES, colours.MODES, colours.SOLES)
    lanes = [each for states in tables for each in states.values() if each != colours.LIMIT]
    assert len(marks) > 10
    # Lanes have their state written on them, so their colours only differ from those of marks.
    for one, other in (*itertools.combinations(marks, 2), *itertools.product(marks, lanes)):
        assert np.linalg.norm(np.subtract(one, other)) > APART, (one, other)
