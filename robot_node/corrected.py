"""LC: the last solution corrected by a stale factorisation; `docs/locally-corrected.md`.

Each tick takes the exact residuals of all rows at the last solution, by the passes that b needs
anyway. It adds the product of the factorisation and the residuals, decides the active set, and
recovers the torque with fresh dynamics. At intervals a second correction shows how much error the
first one has left.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from robot_node.cache import CorrectorEntry, FactorisationCache
from robot_node.controllers import Controller, ControllerParts, Decision, make_balance_law
from robot_node.onboard import OnBoardRefresh, factorisation_solve
from robot_node.verification import FactorisationVerifier
from shared.telemetry.schema import Source
from shared.wbc.contacts import ContactMode
from shared.wbc.correction import Iterate
from shared.wbc.model import Kinematics
from shared.wbc.reference import Reference
from shared.wbc.stack import Stack
from shared.wbc.torque import recover_torque

# The number of ticks between two probes of the contraction, and the weight of a probe in the
# average: 50 ms.
_PROBE_TICKS = 10
_AVERAGE = 0.2
# The weight of forces [N] against accelerations in the size of a correction. A correction below the
# least size [rad/s²] is too small for an estimate.
_FORCE_SCALE = 0.1
_NEGLIGIBLE = 1e-3
# The maximum number of further corrections in a tick whose torques would be clamped.
_TORQUE_STEPS = 2


class Contraction:
    """Share of the error that a correction leaves: the ratio of two successive corrections at one
    state.

    Below 1 corrections converge. Both are from exact residuals at the same state. Noise and motion,
    which cause the error, therefore do not enter the ratio.
    """

    def __init__(self) -> None:
        self.estimate = math.nan

    def observe(self, first: float, second: float) -> None:
        """Take in the sizes of a correction and of the next one."""
        if first < _NEGLIGIBLE:
            return
        ratio = second / first
        known = not math.isnan(self.estimate)
        self.estimate = self.estimate + _AVERAGE * (ratio - self.estimate) if known else ratio


class LocallyCorrected(Controller):
    """LC: y⁺ = y + K₀ r(y), the friction rows decided anew, from the newest factorisation.

    With a budget for it, the on-board computer factorises when corrections leave too much error.
    """

    every_state_answered = False
    answers_expire = False
    bounds_torque_steps = True
    corrects = True

    def __init__(self, parts: ControllerParts) -> None:
        config = parts.config.correction
        # Seeded by the operating system's entropy, because an edge that knew the numbers could pass
        # the test. Which factorisations pass does not depend on them.
        rng = np.random.default_rng()
        self.cache: FactorisationCache = FactorisationCache(
            parts.codec,
            parts.stacks,
            session=parts.session,
            level=config.level,
            verifier=FactorisationVerifier(parts.model.robot, parts.stacks, parts.config, rng),
        )
        if config.on_board_budget > 0.0:
            computer = parts.start_computer(factorisation_solve)
            self.on_board = OnBoardRefresh(
                parts.config, computer, self.cache, lambda: self.wants_refresh
            )
        self._model = parts.model
        self._stacks = parts.stacks
        self.balance = make_balance_law(parts)
        self._config = config
        self._contraction = Contraction()
        self._iterate = Iterate.zero(parts.stacks[ContactMode.DOUBLE_SUPPORT])
        self._steps = self._tick = 0
        self._uncorrected = False
        self._stack: Stack
        self._reference: Reference
        self._now: Kinematics
        self._residual: np.ndarray

    def should_stop(self) -> bool:
        return self._contraction.estimate > self._config.stop_above

    @property
    def wants_refresh(self) -> ContactMode | None:
        """Return the present contact mode if a factorisation at the present state would help, else
        None.
        """
        helpful = self._contraction.estimate > self._config.refresh_above
        return self._iterate.mode if helpful else None

    def observe(self, q: np.ndarray, v: np.ndarray, reference: Reference) -> None:
        stack = self._stacks[reference.mode]
        self._steps = max(1, self._config.iterations)
        if stack.mode is not self._iterate.mode:
            self._iterate = self._iterate.in_mode(stack, self._model.nv)
            self._steps = max(self._steps, self._config.iterations_at_switch)
        self._uncorrected = (
            self._config.iterations == 0 or self._contraction.estimate > self._config.give_up_above
        )
        if self._uncorrected:
            self._iterate, self._steps = Iterate.zero(stack), 1
        self._stack = stack
        self._now = stack.kinematics_at(self._iterate.y, model=self._model, q=q, v=v)
        if self.balance is not None:
            wrenches = stack.contacts.wrenches(self._iterate.y[self._model.nv :])
            self.com_command = self.balance.com_command(self._now, reference, wrenches)
            reference = dataclasses.replace(reference, com_command=self.com_command)
        self._reference = reference
        self._residual = stack.right_hand_side(self._now, reference)

    def command(self, *, time_ns: int) -> Decision | None:
        entry = self.cache.lookup(self._stack.mode)
        if entry is None:
            return None
        q, v = self._now.q, self._now.v
        self._tick += 1
        probing = self._tick % _PROBE_TICKS == 0
        sizes = []
        active_set: int | None = 0
        for step in range(self._steps + probing):
            before = self._iterate.y
            active_set = self._correct(entry, q, v, again=step > 0)
            if active_set is None:
                return None
            if step == 0:
                first = self._iterate
            if probing:
                sizes.append(self._size(self._iterate.y - before))
        if probing:
            self._contraction.observe(*sizes[-2:])
            if self._uncorrected:  # the probe was a look ahead only
                self._iterate = first
        tau = self._torque(q, v)
        for _ in range(_TORQUE_STEPS):
            # D is stale: a large correction may overshoot a torque limit, the next one less.
            if self._within_clamp(tau):
                break
            active_set = self._correct(entry, q, v, again=True)
            tau = self._torque(q, v)
        if active_set is None:
            return None
        y = self._iterate.y
        posture = entry.corrector.factorisation.posture
        return Decision(
            tau=tau,
            y=y,
            mode=self._stack.mode,
            active_set=active_set,
            source=self._source(entry),
            sequence=entry.sequence,
            stamp_ns=entry.stamp_ns,
            contraction=self._contraction.estimate,
            staleness=float(np.abs(q[7:] - posture).max()),
        )

    def _correct(
        self, entry: CorrectorEntry, q: np.ndarray, v: np.ndarray, *, again: bool
    ) -> int | None:
        """Correct the iterate. Return its active set, or None if it is lost. `again`: a further
        correction at (q, v).
        """
        if again:
            self._linearise(q, v)
        corrected = entry.corrector.step(
            self._iterate,
            self._residual,
            self._model,
            self._now,
            relaxation=self._config.relaxation,
        )
        if corrected is None:
            self._iterate = Iterate.zero(self._stack)
            return None
        self._iterate, active_set = corrected
        return active_set

    def _torque(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return recover_torque(self._model, self._stack.contacts, q, v, self._iterate.y)

    def _within_clamp(self, tau: np.ndarray) -> bool:
        """Return whether the clamp leaves all torques as they are, or no correction would help."""
        limits = self._stack.limits
        if limits is None or self._uncorrected:
            return True
        beyond = np.abs(tau)
        beyond -= limits.clamp
        return bool(beyond[beyond.argmax()] <= 0.0)

    def _source(self, entry: CorrectorEntry) -> Source:
        if self._uncorrected:
            return Source.CACHED
        return Source.ON_BOARD if entry.on_board else Source.CORRECTED

    def _linearise(self, q: np.ndarray, v: np.ndarray) -> None:
        """Compute the residuals of all rows at the iterate and the present state."""
        self._now = self._stack.kinematics_at(self._iterate.y, model=self._model, q=q, v=v)
        self._residual = self._stack.right_hand_side(self._now, self._reference)

    def _size(self, correction: np.ndarray) -> float:
        a, f = correction[: self._model.nv], _FORCE_SCALE * correction[self._model.nv :]
        return math.sqrt(a @ a + f @ f)
