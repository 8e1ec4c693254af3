"""Reader of the states of an SRDF: group states, with a configuration of each joint."""

from __future__ import annotations

import math
from pathlib import Path

from shared.errors import ConfigError, one_of
from shared.robots.urdf import read_xml


def read_state(path: Path, name: str, *, what: str) -> dict[str, list[float]]:
    """Return the configuration of each joint in the state `name`.

    Raise `ConfigError`, which begins with `what`, if the file has no such state, or if a value is
    no list of finite numbers.
    """
    states = {each.get("name", ""): each for each in read_xml(path, what=what).iter("group_state")}
    if name not in states:
        known = (
            one_of(states, name) if states else f"expected a group_state, got none of name {name!r}"
        )
        raise ConfigError(f"{what}: posture.state: {known}; the file is {path}")
    found = {}
    for joint in states[name].iterfind("joint"):
        text = joint.get("value", "")
        try:
            numbers = [float(word) for word in text.split()]
        except ValueError:
            numbers = []
        if not numbers or not all(map(math.isfinite, numbers)):
            raise ConfigError(
                f"{what}: posture.state {name}: expected finite numbers for joint "
                f"{joint.get('name')}, got {text!r}; correct it in {path}"
            )
        found[joint.get("name", "")] = numbers
    return found
