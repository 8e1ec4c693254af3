"""The local controllers: what the robot does with the newest answer it has.

PR (purely remote) applies the torque of the answer as it came. LA (locally assisted) applies the
answer's projector to a fresh b, Eq. (4), and recovers the torque with fresh dynamics.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from robot_node.cache import CacheEntry
from shared.errors import ConfigError
from shared.wbc.model import WholeBodyModel
from shared.wbc.stack import Stack
from shared.wbc.torque import recover_torque


class Source(enum.IntEnum):
    """Where a command came from: this tick's answer, an older one, or none that is usable."""

    FRESH = 0
    CACHED = 1
    HELD = 2


@dataclass(frozen=True, slots=True)
class Measurement:
    """What the robot knows in one tick. `b` is the right-hand side of its contact mode."""

    q: np.ndarray
    v: np.ndarray
    b: np.ndarray


class Controller(Protocol):
    """From an answer of the edge and a fresh measurement to a command."""

    def command(self, entry: CacheEntry, now: Measurement) -> tuple[np.ndarray, np.ndarray]:
        """(τ, y): joint torques (nv − 6,) [N m] and the solution (n,) they stand for."""
        ...


class PurelyRemote:
    """PR: the last torque received."""

    def command(self, entry: CacheEntry, now: Measurement) -> tuple[np.ndarray, np.ndarray]:
        return entry.message.tau, entry.message.y


class LocallyAssisted:
    """LA: ŷ = Â† b with the last projector received and the b of this tick."""

    def __init__(self, model: WholeBodyModel, stack: Stack) -> None:
        self._model = model
        self._contacts = stack.contacts

    def command(self, entry: CacheEntry, now: Measurement) -> tuple[np.ndarray, np.ndarray]:
        y = entry.projector.apply(now.b)
        return recover_torque(self._model, self._contacts, now.q, now.v, y), y


def make_controller(name: str, model: WholeBodyModel, stack: Stack) -> Controller:
    """A controller by its name in the configuration, for one contact mode."""
    if name == "pr":
        return PurelyRemote()
    if name == "la":
        return LocallyAssisted(model, stack)
    raise ConfigError(f"controller: expected la or pr, got {name!r}")
