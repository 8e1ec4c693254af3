from __future__ import annotations

import dataclasses

import pytest

from shared.config.config_file import load_config
from shared.config.extensions import TASKS
from shared.config.settings import RunConfig
from shared.errors import ConfigError
from shared.robots import CATALOGUE, load_robot
from shared.robots.description import robots_folder
from shared.robots.loading import load


def test_an_unknown_robot_is_refused_with_the_names_that_exist():
    with pytest.raises(ConfigError) as error:
        load_robot("juliet")
    assert "'juliet'" in str(error.value)
    for name in CATALOGUE:
        assert name in str(error.value)


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_robot_of_the_catalogue_loads_under_its_name(name):
    assert load_robot(name).name == name


@pytest.mark.parametrize("name", CATALOGUE)
def test_the_settings_of_an_entry_are_settings_of_its_tasks(name):
    assert set(CATALOGUE[name].settings) <= set(TASKS.own)
    for task in TASKS.own:
        config = load_config(None, {"task": task, "robot.name": name})
        assert (config.task, config.robot.name) == (task, name)


def test_the_default_robot_has_the_defaults():
    assert not CATALOGUE[RunConfig().robot.name].settings


TALOS = CATALOGUE["talos"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"posture": "asleep"},
            "expected a posture of the SRDF, one of half_sitting, got 'asleep'",
        ),
        (
            {"feet": (TALOS.feet[0], dataclasses.replace(TALOS.feet[1], joint="toe"))},
            "expected the joint of the right foot, one of leg_left_1_joint",
        ),
    ],
    ids=["posture", "joint"],
)
def test_an_entry_with_a_name_that_is_not_there_is_refused_with_those_that_are(change, message):
    with pytest.raises(ConfigError, match=message):
        load(dataclasses.replace(TALOS, **change))


def test_a_joint_that_turns_without_end_is_refused_by_name(tmp_path):
    published = (robots_folder() / TALOS.urdf).read_text()
    limited = '<joint name="torso_1_joint" type="revolute">'
    assert limited in published
    urdf = tmp_path / "endless.urdf"
    urdf.write_text(published.replace(limited, limited.replace("revolute", "continuous")))
    with pytest.raises(ConfigError, match="expected hinges with limits, joint torso_1_joint"):
        load(dataclasses.replace(TALOS, urdf=str(urdf)))
