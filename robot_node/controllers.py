"""The local controllers: the robot's use of the newest answer it has.

PR (purely remote) applies the torque of the answer as it came. LA (locally assisted) applies the
answer's projector to a fresh b, Eq. (4), and recovers the torque with fresh dynamics. LC (locally
corrected, `robot_node/corrected.py`) corrects its last solution by the answer's factorisation.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from robot_node.cache import AnswerCache, CacheEntry, ProjectorCache
from robot_node.onboard import OnBoard, OnBoardWindow, StartComputer, projector_solve
from robot_node.verification import ProjectorVerifier
from shared.config.extensions import CONTROLLERS
from shared.config.settings import RunConfig
from shared.robots import Foot
from shared.telemetry.schema import Source
from shared.user_code import Attribute, Members, Method, array_fault, kind_fault
from shared.wbc.assisted import Assisted, apply_projector
from shared.wbc.balance import BalanceLaw
from shared.wbc.contacts import ContactMode
from shared.wbc.model import WholeBodyModel
from shared.wbc.reference import Motion, Reference
from shared.wbc.stack import N_DYNAMICS, Stack
from shared.wire.codec import Codec


@dataclass(slots=True)
class Decision:
    """The decision of a controller: joint torques, and the solution behind them.

    `tau` (nv − 6,) [N m] are the torques. `y` (n,) is the solution in contact mode `mode`, with its
    `active_set` as a bit mask. `source` is the source of the command if the answer is to an earlier
    state.

    The decision rests on the answer to the state `sequence`, measured at `stamp_ns`. `contraction`
    is the estimated ratio of two successive corrections. `staleness` is the largest joint distance
    [rad] from the posture at which the answer was computed. Both are NaN where they do not apply.
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


@dataclass(slots=True)
class Command:
    """The torque of one tick (nv − 6,) [N m], clamped, and the decision behind it, if there is one.

    `age_ns` is the age of the decision's answer: the time since the measurement of its state.
    """

    tau: np.ndarray
    source: Source
    age_ns: int
    decision: Decision | None


class Controller(ABC):
    """Makes a command from the edge's answers and a fresh measurement.

    `cache` takes in the answers. `on_board` is the robot's own computer, if the controller needs
    one. `com_command` is what its balance law asks for in this tick, see `RobotState`.

    * `every_state_answered`: an answer to each state is expected, so that waiting d* for it may be
      worth it.
    * `answers_expire`: an answer is of no use once it is older than `loop.hold_after`.
    * `bounds_torque_steps`: where the kind of command changes, the torque moves there in steps.
    * `corrects`: it reports a contraction, and needs no fresh projector after a contact switch.
    """

    every_state_answered = True
    answers_expire = True
    bounds_torque_steps = False
    corrects = False

    cache: AnswerCache
    on_board: OnBoard | None = None
    com_command: np.ndarray | None = None
    balance: BalanceLaw | None = None

    @property
    def disturbance(self) -> np.ndarray:
        """The external force, as the shift of the CoP that balances it, (2,) [m]."""
        return np.zeros(2) if self.balance is None else self.balance.disturbance

    def should_stop(self) -> bool:
        """Return whether the robot should come to a stand while it can."""
        return False

    def observe(self, q: np.ndarray, v: np.ndarray, reference: Reference) -> None:  # noqa: B027
        """First phase of a tick: compute the terms that do not need the tick's answer.

        (q, v) are finite. A tick without such a measurement calls neither phase.
        """

    @abstractmethod
    def command(self, *, time_ns: int) -> Decision | None:
        """Second phase, at a task time. Return None if no answer may be used."""


@dataclass(frozen=True)
class ControllerParts:
    """The parts from which a robot makes its controller.

    `codec` and `session` are for its cache. `model` and `stacks` are the robot's own; every call
    overwrites `model`, a workspace. `start_computer` starts the on-board computer.
    """

    config: RunConfig
    motion: Motion
    codec: Codec
    session: int
    model: WholeBodyModel
    stacks: dict[ContactMode, Stack]
    start_computer: StartComputer


def make_balance_law(parts: ControllerParts) -> BalanceLaw | None:
    """Return the balance law that the configuration names, or None for the CoM task's own."""
    config = parts.config
    if config.wbc.balance.law == "com":
        return None
    robot, period = parts.model.robot, config.loop.period_ns * 1e-9
    return BalanceLaw(robot, config.wbc.balance, period=period)


MakeController = Callable[[ControllerParts], Controller]


def make_controller(parts: ControllerParts) -> Controller:
    """Make the controller that `parts.config.controller` names.

    Raise `ConfigError` if it cannot be imported or lacks a member.
    """
    members: Members = {
        "cache": Attribute(partial(kind_fault, kind=AnswerCache)),
        "observe": Method(3),
        "command": Method(keywords=("time_ns",), fault=partial(_decision_fault, parts)),
        "should_stop": Method(),
    }
    controller: Controller = CONTROLLERS.make(parts.config.controller, parts, members=members)
    return controller


def _decision_fault(parts: ControllerParts, decision: Any) -> str:
    """Return the fault of what a user's controller decides, or an empty text."""
    if decision is None:
        return ""
    if fault := kind_fault(decision, Decision, or_none=True):
        return fault
    kinds = (("mode", ContactMode), ("source", Source), ("sequence", int), ("stamp_ns", int))
    for name, kind in kinds:
        if fault := kind_fault(getattr(decision, name), kind):
            return f"{name}: {fault}"
    n_joints = parts.model.robot.model.nv - 6
    return array_fault(decision.tau, (n_joints,), "torques tau") or array_fault(
        decision.y, (parts.stacks[decision.mode].layout.n_unknowns,), "the solution y"
    )


class PurelyRemote(Controller):
    """PR: the last torque received, at any state."""

    def __init__(self, parts: ControllerParts) -> None:
        self.cache: ProjectorCache = ProjectorCache(parts.codec, session=parts.session)
        self.balance = make_balance_law(parts)
        self._model = parts.model
        self._stacks = parts.stacks
        self._wrenches: dict[Foot, np.ndarray] = {}

    def observe(self, q: np.ndarray, v: np.ndarray, reference: Reference) -> None:
        if self.balance is not None:
            now = self._model.kinematics(q, v)
            self.com_command = self.balance.com_command(now, reference, self._wrenches)

    def command(self, *, time_ns: int) -> Decision | None:
        entry = self.cache.newest_solution
        if entry is None or entry.tau is None or entry.y is None:
            return None
        if self.balance is not None:
            contacts = self._stacks[entry.projector.mode].contacts
            self._wrenches = contacts.wrenches(entry.y[self._model.nv :])
        return _decision(entry, entry.tau, entry.y, entry.projector.active_set)


class LocallyAssisted(Controller):
    """LA: ŷ = Â† b with the newest projector of the contact mode and the b of this tick.

    In a walk the on-board computer supports it at the contact switches.
    """

    def __init__(self, parts: ControllerParts) -> None:
        self.cache: ProjectorCache = ProjectorCache(parts.codec, session=parts.session)
        switch, motion = parts.config.switch, parts.motion
        wanted = switch.prepare_on_board or switch.solve_on_board
        if wanted and motion.next_switch(0) is not None:
            computer = parts.start_computer(projector_solve)
            self.on_board = OnBoardWindow(switch, motion, computer, self.cache)
        self._model = parts.model
        self._stacks = parts.stacks
        # Seeded as that of LC.
        self._verifier = ProjectorVerifier(
            parts.model, parts.stacks, motion.reference(0), np.random.default_rng()
        )
        self.balance = make_balance_law(parts)
        self._wrenches: dict[Foot, np.ndarray] = {}
        self._stack: Stack
        self._q: np.ndarray
        self._v: np.ndarray
        self._b: np.ndarray

    def observe(self, q: np.ndarray, v: np.ndarray, reference: Reference) -> None:
        self._q, self._v = q, v
        self._stack = self._stacks[reference.mode]
        now = self._model.kinematics(q, v)
        if self.balance is not None:
            self.com_command = self.balance.com_command(now, reference, self._wrenches)
            reference = dataclasses.replace(reference, com_command=self.com_command)
        self._b = self._stack.right_hand_side(now, reference, with_limits=False)

    def command(self, *, time_ns: int) -> Decision | None:
        model, stack = self._model, self._stack
        while (entry := self.cache.lookup(stack.mode, time_ns=time_ns)) is not None:
            assisted = apply_projector(
                stack, entry.projector, self._b, model=model, q=self._q, v=self._v
            )
            y, force = assisted.y, assisted.force
            tau = force[N_DYNAMICS:].copy()
            if self._is_right(entry, assisted):
                # From now on it may grow stale, which is no fault of the edge.
                entry.proven = True
                if self.balance is not None:
                    self._wrenches = stack.contacts.wrenches(y[model.nv :])
                return _decision(entry, tau, y, assisted.active_set)
            self.cache.reject(entry)
        return None

    def _is_right(self, entry: CacheEntry, assisted: Assisted) -> bool:
        """Test an answer at its first use, and once more at the first use of its pushes."""
        if entry.exact or entry.on_board:
            return True
        plausible = entry.proven or self._verifier.is_plausible(assisted.force)
        if plausible and not assisted.pushes:
            return True
        state = self.cache.state_of(entry)
        entry.exact = state is not None and self._verifier.is_exact(entry.projector, *state)
        return entry.exact


def _decision(entry: CacheEntry, tau: np.ndarray, y: np.ndarray, active_set: int) -> Decision:
    return Decision(
        tau,
        y,
        entry.projector.mode,
        active_set,
        Source.ON_BOARD if entry.on_board else Source.CACHED,
        entry.sequence,
        entry.stamp_ns,
    )
