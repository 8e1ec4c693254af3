"""The local controllers: what the robot does with the newest answer it has.

PR (purely remote) applies the torque of the answer as it came. LA (locally assisted) applies the
answer's projector to a fresh b, Eq. (4), and recovers the torque with fresh dynamics. LC (locally
corrected, `robot_node/corrected.py`) corrects its last solution by the answer's factorisation.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from robot_node.cache import AnswerCache, CacheEntry, ProjectorCache
from shared.config import RunConfig
from shared.motion.reference import Reference
from shared.wbc.contacts import ContactMode
from shared.wbc.model import WholeBodyModel
from shared.wbc.stack import Stack
from shared.wbc.torque import recover_torque
from shared.wire.codec import Codec


class Source(enum.IntEnum):
    """Where a command came from: this tick's answer, an older one as it is, nowhere (the joints are
    held), the robot's own computer, an older answer corrected, or the same while the robot ends its
    walk because corrections have become doubtful."""

    FRESH = 0
    CACHED = 1
    HELD = 2
    ON_BOARD = 3
    CORRECTED = 4
    STOPPING = 5


@dataclass(frozen=True, slots=True)
class Decision:
    """What a controller commands: joint torques `tau` (nv − 6,) [N m] and the solution `y` (n,) of
    contact mode `mode` they stand for, with its `active_set` as a bit mask. `source` is what it is
    called if its answer is not to this very state.

    It rests on the answer to the state `sequence`, measured at `stamp_ns`. `contraction` estimates
    by how much a correction shrinks the error, `staleness` is the largest joint distance [rad]
    from where the answer was computed; NaN where there is no such thing.
    """

    tau: np.ndarray
    y: np.ndarray
    mode: ContactMode
    active_set: int
    source: Source
    sequence: int
    stamp_ns: int
    contraction: float = math.nan
    staleness: float = math.nan


@dataclass(frozen=True, slots=True)
class Command:
    """The torque of one tick (nv − 6,) [N m], clamped; the decision behind it, if there is one.

    `age_ns` is the time since the state was measured that the decision's answer was computed from.
    """

    tau: np.ndarray
    source: Source
    age_ns: int
    decision: Decision | None


class Controller(Protocol):
    """From the edge's answers and a fresh measurement to a command."""

    @property
    def cache(self) -> AnswerCache:
        """What takes in the answers."""
        ...

    @property
    def ages(self) -> bool:
        """Whether an answer is of no use once it is older than `loop.hold_after`."""
        ...

    @property
    def doubtful(self) -> bool:
        """Whether the robot should come to a stand while it can."""
        ...

    def observe(self, q: np.ndarray, v: np.ndarray, reference: Reference) -> None:
        """First phase of a tick: what can be computed before its answer comes."""
        ...

    def command(self, *, time_ns: int) -> Decision | None:
        """Second phase, at a task time; None if no answer may be used."""
        ...


@dataclass(frozen=True)
class ControllerParts:
    """What a robot has to make its controller from.

    `codec` and `session` are for its cache; `model` and `stacks` are the robot's own, with `model`
    a workspace that every call overwrites.
    """

    config: RunConfig
    codec: Codec
    session: int
    model: WholeBodyModel
    stacks: dict[ContactMode, Stack]


MakeController = Callable[[ControllerParts], Controller]


class PurelyRemote:
    """PR: the last torque received, whatever it was computed for."""

    ages = True
    doubtful = False

    def __init__(self, cache: ProjectorCache) -> None:
        self.cache = cache

    def observe(self, q: np.ndarray, v: np.ndarray, reference: Reference) -> None:
        pass

    def command(self, *, time_ns: int) -> Decision | None:
        entry = self.cache.newest_solution
        if entry is None or entry.tau is None or entry.y is None:
            return None
        return _decision(entry, entry.tau, entry.y)


class LocallyAssisted:
    """LA: ŷ = Â† b with the newest projector of the contact mode and the b of this tick."""

    ages = True
    doubtful = False

    def __init__(
        self, cache: ProjectorCache, model: WholeBodyModel, stacks: dict[ContactMode, Stack]
    ) -> None:
        self.cache = cache
        self._model = model
        self._stacks = stacks
        self._stack: Stack
        self._q: np.ndarray
        self._v: np.ndarray
        self._b: np.ndarray

    def observe(self, q: np.ndarray, v: np.ndarray, reference: Reference) -> None:
        self._q, self._v = q, v
        self._stack = self._stacks[reference.mode]
        self._b = self._stack.right_hand_side(self._model.kinematics(q, v), reference)

    def command(self, *, time_ns: int) -> Decision | None:
        entry = self.cache.lookup(self._stack.mode, time_ns=time_ns)
        if entry is None:
            return None
        y = entry.projector.apply(self._b)
        tau = recover_torque(self._model, self._stack.contacts, self._q, self._v, y)
        return _decision(entry, tau, y)


def _decision(entry: CacheEntry, tau: np.ndarray, y: np.ndarray) -> Decision:
    projector = entry.projector
    return Decision(
        tau,
        y,
        projector.mode,
        projector.active_set,
        Source.ON_BOARD if entry.on_board else Source.CACHED,
        entry.sequence,
        entry.stamp_ns,
    )
