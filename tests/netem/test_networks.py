from __future__ import annotations

import numpy as np
import pytest

from netem.capacity import CapacityProfile
from netem.generator.channel import SCENARIOS
from netem.generator.generate import generate_profile
from netem.networks import load_network, load_profile
from shared.errors import ProfileError


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_generated_network_is_the_profile_that_its_seed_generates(scenario):
    profile = load_profile(f"generated:{scenario}/7")
    made = generate_profile(SCENARIOS[scenario], 7)
    np.testing.assert_array_equal(profile.delays_ns, made.delays_ns)
    assert profile.name == f"generated:{scenario}/7"
    assert profile.metadata["seed"] == 7
    assert not np.array_equal(profile.delays_ns, load_profile(f"generated:{scenario}/8").delays_ns)


def test_a_generated_network_is_made_once():
    assert load_profile("generated:factory/3") is load_profile("generated:factory/3")


def test_the_capacity_of_a_generated_network_is_that_of_its_channel():
    profile = load_profile("generated:building/2")
    link = load_network("capacity:generated:building/2")
    assert isinstance(link, CapacityProfile)
    np.testing.assert_array_equal(link.capacity[1], profile.columns["downlink_capacity_bytes"])


@pytest.mark.parametrize(
    "network",
    [
        *("generated:", "generated:factory", "generated:factory/", "generated:office/7"),
        *("generated:factory/-1", "generated:factory/1.5", "generated:factory/007"),
        *("generated:factory/7\n", "generated:factory/1000000000"),
    ],
)
def test_a_generated_network_without_scenario_and_seed_is_refused(network):
    with pytest.raises(ProfileError) as error:
        load_network(network)
    assert "expected a scenario and a seed as in generated:factory/7 or" in str(error.value)
    assert "\n" not in str(error.value)
