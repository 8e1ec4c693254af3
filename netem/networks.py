"""The networks that `--network` names: a profile (shipped, generated, file), a constant, a
capacity.
"""

from __future__ import annotations

import dataclasses
import functools
import re
from pathlib import Path

import numpy as np

from netem.capacity import capacity_of
from netem.generator.channel import SCENARIOS
from netem.generator.generate import generate_profile
from netem.profile import DelayProfile, Profile
from netem.profile_file import is_file, read_profile
from shared.config.quantities import parse_duration_ns
from shared.errors import ConfigError, ProfileError, did_you_mean
from shared.wire.operator.commands import LinkCommand, ReplaceProfile

SHIPPED = Path(__file__).parent / "profiles"
CAPACITY = "capacity:"
GENERATED = "generated:"


def load_network(network: str) -> Profile:
    """The network of that name: the delays of a profile or, after `capacity:`, its capacity."""
    profile = load_profile(network.removeprefix(CAPACITY))
    return capacity_of(profile) if network.startswith(CAPACITY) else profile


def profile_of(command: LinkCommand) -> Profile | None:
    """Return the profile that an operator's command names; None if it names none."""
    return load_network(command.network) if isinstance(command, ReplaceProfile) else None


def load_profile(network: str) -> DelayProfile:
    """A profile: a shipped one (`factory/001`), a file, `constant:…` or `generated:…`."""
    if network.startswith("constant:"):
        return constant_profile(network)
    if network.startswith(GENERATED):
        return generated_profile(network)
    shipped, path = SHIPPED / f"{network}.npz", Path(network)
    if is_file(shipped):
        return read_profile(shipped, name=network)
    if is_file(path):
        return read_profile(path)
    examples = ", ".join(sorted({name.split("/")[0] + "/001" for name in shipped_names()}))
    raise ProfileError(
        f"network: expected a shipped profile ({examples}, …), a .npz or .csv file, constant:30ms, "
        f"generated:factory/7, capacity: before any of these, or direct, got {network!r}: no such "
        f"profile or file{did_you_mean(shipped_names(), network)}"
    )


def shipped_names() -> list[str]:
    """Names of the profiles that come with the project."""
    return sorted(
        p.relative_to(SHIPPED).with_suffix("").as_posix() for p in SHIPPED.glob("*/*.npz")
    )


def constant_profile(network: str) -> DelayProfile:
    """`constant:ROUND_TRIP`, half each way as in the paper's tables, or `constant:UP/DOWN`."""
    _, _, text = network.partition(":")
    try:
        parts = [parse_duration_ns(part) for part in text.split("/")]
    except ConfigError as error:
        raise ProfileError(f"network {network!r}: {error}") from None
    if len(parts) == 1:
        parts = [parts[0] // 2, parts[0] - parts[0] // 2]
    if len(parts) != 2:
        raise ProfileError(
            f"network: expected constant:30ms or constant:10ms/20ms, got {network!r}"
        )
    return DelayProfile(name=network, delays_ns=np.array(parts, dtype=np.int64).reshape(2, 1))


@functools.lru_cache(maxsize=256)
def generated_profile(network: str) -> DelayProfile:
    """`generated:SCENARIO/SEED`: the profile of `netem generate` for that seed, without a file."""
    scenarios = "|".join(SCENARIOS)
    found = re.fullmatch(f"{GENERATED}({scenarios})/(0|[1-9][0-9]{{0,8}})", network)
    if found is None:
        examples = " or ".join(f"{GENERATED}{name}/7" for name in SCENARIOS)
        raise ProfileError(
            f"network: expected a scenario and a seed as in {examples}, got {network!r}"
        )
    profile = generate_profile(SCENARIOS[found[1]], int(found[2]))
    return dataclasses.replace(profile, name=network)
