from __future__ import annotations

import pytest

from shared.errors import ConfigError
from shared.robots import CATALOGUE, load_robot


def test_an_unknown_robot_is_refused_with_the_names_that_exist():
    with pytest.raises(ConfigError) as error:
        load_robot("juliet")
    assert "'juliet'" in str(error.value)
    for name in CATALOGUE:
        assert name in str(error.value)


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_robot_of_the_catalogue_loads_under_its_name(name):
    assert load_robot(name).name == name
