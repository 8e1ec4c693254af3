"""The local controllers: what the robot does with the newest answer it has.

PR (purely remote) applies the torque of the answer as it came. LA (locally assisted) applies the
answer's projector to a fresh b, Eq. (4), and recovers the torque with fresh dynamics.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from robot_node.cache import CacheEntry, ProjectorCache
from shared.errors import ConfigError
from shared.wbc.contacts import ContactMode
from shared.wbc.model import WholeBodyModel
from shared.wbc.stack import Stack
from shared.wbc.torque import recover_torque


class Source(enum.IntEnum):
    """Where a command came from: this tick's answer, an older one, the robot's own QP, or none."""

    FRESH = 0
    CACHED = 1
    HELD = 2
    ON_BOARD = 3


@dataclass(frozen=True, slots=True)
class Measurement:
    """What the robot knows in one tick. `b` is the right-hand side of its contact mode."""

    q: np.ndarray
    v: np.ndarray
    b: np.ndarray


class Controller(Protocol):
    """From the cache and a fresh measurement to a command."""

    def choose(
        self, cache: ProjectorCache, mode: ContactMode, *, time_ns: int
    ) -> CacheEntry | None:
        """The entry to command from in a contact mode at a task time; None if none may be used."""
        ...

    def command(self, entry: CacheEntry, now: Measurement) -> tuple[np.ndarray, np.ndarray]:
        """(τ, y): joint torques (nv − 6,) [N m] and the solution (n,) they stand for."""
        ...


class PurelyRemote:
    """PR: the last torque received, whatever it was computed for."""

    def choose(
        self, cache: ProjectorCache, mode: ContactMode, *, time_ns: int
    ) -> CacheEntry | None:
        return cache.newest_solution

    def command(self, entry: CacheEntry, now: Measurement) -> tuple[np.ndarray, np.ndarray]:
        assert entry.tau is not None
        assert entry.y is not None
        return entry.tau, entry.y


class LocallyAssisted:
    """LA: ŷ = Â† b with the newest projector of the contact mode and the b of this tick."""

    def __init__(self, model: WholeBodyModel, stacks: dict[ContactMode, Stack]) -> None:
        self._model = model
        self._stacks = stacks

    def choose(
        self, cache: ProjectorCache, mode: ContactMode, *, time_ns: int
    ) -> CacheEntry | None:
        return cache.lookup(mode, time_ns=time_ns)

    def command(self, entry: CacheEntry, now: Measurement) -> tuple[np.ndarray, np.ndarray]:
        y = entry.projector.apply(now.b)
        contacts = self._stacks[entry.projector.mode].contacts
        return recover_torque(self._model, contacts, now.q, now.v, y), y


def make_controller(
    name: str, model: WholeBodyModel, stacks: dict[ContactMode, Stack]
) -> Controller:
    """A controller by its name in the configuration."""
    if name == "pr":
        return PurelyRemote()
    if name == "la":
        return LocallyAssisted(model, stacks)
    raise ConfigError(f"controller: expected la or pr, got {name!r}")
