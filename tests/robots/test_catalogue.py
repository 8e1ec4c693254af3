from __future__ import annotations

import pytest

from shared.config.config_file import load_config
from shared.config.extensions import TASKS
from shared.config.settings import RunConfig
from shared.errors import ConfigError
from shared.robots import CATALOGUE, description_of, load_robot


def test_an_unknown_robot_is_refused_with_the_names_that_exist():
    with pytest.raises(ConfigError) as error:
        load_robot("juliet")
    assert "'juliet'" in str(error.value)
    for name in CATALOGUE:
        assert name in str(error.value)
    assert "FILE.toml" in str(error.value)


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_robot_of_the_catalogue_loads_under_its_name(name):
    assert load_robot(name).name == name


@pytest.mark.parametrize("name", CATALOGUE)
def test_the_settings_of_a_robot_are_settings_of_its_tasks(name):
    assert set(description_of(name).settings) <= set(TASKS.own)
    for task in TASKS.own:
        config = load_config(None, {"task": task, "robot.name": name})
        assert (config.task, config.robot.name) == (task, name)


def test_the_default_robot_has_the_defaults():
    assert not description_of(RunConfig().robot.name).settings
