"""Limits of a stale factorisation, measured at random states without a simulation.

`./wbc corrections --out DIR` writes `corrections.png` and `corrections.md`. They show the
convergence and the contraction of the corrections over the distance between the state and the
standing pose, at which the factorisation was computed.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pinocchio as pin

from shared.config.config_file import load_config
from shared.motion.plan import make_motion
from shared.output.figure import save_figure
from shared.output.versions import versions
from shared.robots import load_robot
from shared.wbc.answer import Factorisation
from shared.wbc.contacts import ContactMode
from shared.wbc.correction import Corrector, Iterate
from shared.wbc.factorisation import factorise_kkt
from shared.wbc.model import WholeBodyModel
from shared.wbc.projector import full_problem
from shared.wbc.qp import make_solver
from shared.wbc.reference import Reference
from shared.wbc.stack import Stack, StackMatrices

mpl.use("Agg")
from matplotlib import pyplot as plt

# (level, damping) by name.
VARIANTS = {
    "b": ("b", 0.0),
    "b_adjoint": ("b_adjoint", 0.0),
    "c": ("c", 0.0),
    "c, damping 0.05": ("c", 0.05),
}
_MODES = {
    "double support": (ContactMode.DOUBLE_SUPPORT, 0),
    "single support": (ContactMode.RIGHT_SUPPORT, 1_300_000_000),
}
_POSTURE_ERRORS = (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5)
_ITERATIONS = 30
_VELOCITY = 0.1


@dataclass(frozen=True)
class _State:
    """A state near the standing pose, and the optimum at it."""

    q: np.ndarray
    v: np.ndarray
    matrices: StackMatrices
    optimum: np.ndarray


class Laboratory:
    """Corrections of one contact mode, at states drawn around the standing pose."""

    def __init__(self, mode: ContactMode, time_ns: int) -> None:
        config = load_config(None, {"task": "walk"})
        self.robot = load_robot(config.robot.name)
        self.model = WholeBodyModel(self.robot)
        self.stack = Stack(self.robot, config.wbc, mode)
        self.reference: Reference = make_motion(self.robot, config).reference(time_ns)
        self._solver = make_solver("daqp")
        self._standing = self.matrices(self.robot.q_standing)

    def matrices(self, q: np.ndarray) -> StackMatrices:
        return self.stack.matrices(self.model.jacobians(q))

    def state(self, posture_error: float, rng: np.random.Generator) -> _State:
        """A state with normally distributed joint offsets [rad], and its full QP's optimum."""
        nv = self.model.nv
        offset = np.concatenate([0.03 * rng.standard_normal(6), np.zeros(nv - 6)])
        offset[6:] = posture_error * rng.standard_normal(nv - 6)
        q = pin.integrate(self.robot.model, self.robot.q_standing, offset)
        v = _VELOCITY * rng.standard_normal(nv)
        matrices = self.matrices(q)
        b = self.stack.right_hand_side(self.model.kinematics(q, v), self.reference)
        solution = self._solver.solve(full_problem(self.stack, matrices, b))
        return _State(q, v, matrices, solution.x)

    def standing_factorisation(self, damping: float) -> Factorisation:
        """The factorisation that the edge computes for the standing pose."""
        posture = self.robot.q_standing[7:]
        return factorise_kkt(self.stack, self._standing, posture, damping=damping)

    def errors(self, state: _State, factorisation: Factorisation, level: str) -> np.ndarray:
        """Relative error of the accelerations after each iteration from zero."""
        corrector = Corrector(self.stack, factorisation, level=level)
        iterate = Iterate.zero(self.stack)
        n_a = self.model.nv
        errors = np.full(_ITERATIONS, np.nan)
        for k in range(_ITERATIONS):
            now = self.stack.kinematics_at(iterate.y, model=self.model, q=state.q, v=state.v)
            residual = self.stack.right_hand_side(now, self.reference)
            corrected = corrector.step(iterate, residual, self.model, now)
            if corrected is None:
                break
            iterate, _ = corrected
            difference = iterate.y[:n_a] - state.optimum[:n_a]
            errors[k] = np.linalg.norm(difference) / np.linalg.norm(state.optimum[:n_a])
        return errors

    def contraction(self, state: _State, factorisation: Factorisation) -> complex:
        """The eigenvalue of K₀ (M − M₀) of largest modulus: the factor of level b's error."""
        P, Q, A = factorisation.P, factorisation.Q, factorisation.A
        n_a = self.model.nv
        K = np.hstack([Q, P[:, :n_a] @ A.T])
        moved = self._rows(state.matrices) - self._rows(self._standing)
        eigenvalues = np.linalg.eigvals(K @ moved)
        return complex(eigenvalues[np.argmax(np.abs(eigenvalues))])

    def _rows(self, matrices: StackMatrices) -> np.ndarray:
        n_a, n = self.model.nv, self.stack.layout.n_unknowns
        rows = np.zeros((len(matrices.E_a) + len(matrices.A), n))
        rows[:, :n_a] = np.concatenate([matrices.E_a, matrices.A])
        rows[: len(matrices.E_f), n_a:] = matrices.E_f
        return rows


def add_corrections_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `corrections`."""
    parser.add_argument(
        "--out", type=Path, default=Path("docs/figures"), metavar="DIR", help="folder to write to"
    )
    parser.add_argument(
        "--states", type=int, default=40, help="states per point (default %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the states (default 0)")


def run_corrections(arguments: argparse.Namespace) -> int:
    """Measure, draw and write. Return 0."""
    arguments.out.mkdir(parents=True, exist_ok=True)
    figure, axes = plt.subplots(1, 3, figsize=(13, 4.2))
    lines = [
        "| contact mode | offset per joint [rad] | spectral radius of K₀(M − M₀): median, worst "
        "| not contracting |",
        "|---|---|---|---|",
    ]
    for axis, (name, (mode, time_ns)) in zip(axes, _MODES.items(), strict=False):
        laboratory = Laboratory(mode, time_ns)
        rng = np.random.default_rng(arguments.seed)
        states = [laboratory.state(0.05, rng) for _ in range(arguments.states)]
        for label, (level, damping) in VARIANTS.items():
            factorisation = laboratory.standing_factorisation(damping)
            errors = np.array([laboratory.errors(s, factorisation, level) for s in states])
            axis.semilogy(range(1, _ITERATIONS + 1), np.median(errors, axis=0), label=label)
        axis.set(
            title=f"{name}, 0.05 rad off in every joint",
            xlabel="iteration at one state",
            ylabel="median relative error of a",
            ylim=(1e-10, 3.0),
        )
        axis.legend(fontsize=8)
        radii = []
        for posture_error in _POSTURE_ERRORS:
            rng = np.random.default_rng(arguments.seed)
            factorisation = laboratory.standing_factorisation(0.0)
            values = [
                abs(laboratory.contraction(laboratory.state(posture_error, rng), factorisation))
                for _ in range(arguments.states)
            ]
            radii.append(values)
            lines.append(
                f"| {name} | {posture_error} | {np.median(values):.2f}, {np.max(values):.2f} "
                f"| {sum(value >= 1.0 for value in values)} of {len(values)} |"
            )
        median, worst = np.median(radii, axis=1), np.max(radii, axis=1)
        (line,) = axes[2].plot(_POSTURE_ERRORS, median, marker="o", label=f"{name}, median")
        axes[2].plot(_POSTURE_ERRORS, worst, ls=":", color=line.get_color(), label=f"{name}, worst")
    axes[2].axhline(1.0, color="grey", lw=0.8)
    axes[2].set(
        title="contraction of level b",
        xlabel="standard deviation of joint offsets [rad]",
        ylabel="spectral radius of K₀ (M − M₀)",
    )
    axes[2].legend(fontsize=8)
    save_figure(figure, arguments.out / "corrections.png", what="out")
    made = versions()
    lines += [
        "",
        f"`./wbc corrections --states {arguments.states} --seed {arguments.seed}`, "
        f"Python {made['python']}, pin {made['pin']}, daqp {made['daqp']}, numpy {made['numpy']}.",
    ]
    (arguments.out / "corrections.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"{arguments.out}/corrections.png, {arguments.out}/corrections.md")
    return 0
