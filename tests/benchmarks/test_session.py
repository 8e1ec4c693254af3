"""The commands of a random session: the same for a seed, and none disturbs for ever."""

from __future__ import annotations

import itertools
from collections import Counter

from benchmarks.session import _kind, commands
from netem.networks import profile_of
from shared.wire.operator.commands import LinkCommand


def first(number: int, *, seed: int) -> list[str]:
    return [str(command) for command, _ in itertools.islice(commands(seed), number)]


def test_a_seed_gives_the_same_commands_and_another_seed_others() -> None:
    assert first(50, seed=3) == first(50, seed=3)
    assert first(50, seed=3) != first(50, seed=4)


def test_every_kind_of_command_comes_and_a_cut_is_mended_by_the_next() -> None:
    found = list(itertools.islice(commands(0), 600))
    kinds = Counter(_kind(command) for command, _ in found)
    assert set(kinds) == {
        *("push", "controller", "pause", "resume", "speed", "reset"),
        *(f"link {word}" for word in ("cut", "restore", "outage", "delay", "loss", "profile")),
    }
    for (one, pause), (other, _) in itertools.pairwise(found):
        assert 0.5 <= pause <= 2.0
        if isinstance(one, LinkCommand):
            # A profile that does not exist would be refused.
            profile_of(one)
        if str(one) in ("link cut", "pause", "speed 0.5"):
            assert str(other) in ("link restore", "resume", "speed 1")
