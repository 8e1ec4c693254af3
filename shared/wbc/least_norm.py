"""The QP of one contact mode as the search for the shortest vector that obeys linear equations.

    min ½ ‖z‖²   s.t.  B z = Z b,      z = (ρ₁, √ω_f f, ρ₂)

ρ is the error of a in the weighted tasks: ρ₁ = A₁ a − s₁ of the CoM, the base and the joints, which
determine a, and ρ₂ = s₂ − A₂ a of a swing foot. With T = A₁⁻¹, and C_𝒜 f = l_𝒜 the friction rows
that are held,

        ⎡ E_a T   E_f / √ω_f   0 ⎤
    B = ⎢ A₂ T        0        I ⎥ ,
        ⎣   0     C_𝒜 / √ω_f   0 ⎦

          ⎡ e − E_a T s₁ ⎤
    Z b = ⎢ s₂ − A₂ T s₁ ⎥ ,     a = T (s₁ + ρ₁).
          ⎣      l_𝒜      ⎦

With its diagonal and three rows of the CoM, A₁ is inverted by hand. `docs/maths.md` derives it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from shared.wbc.contacts import ContactGeometry


@dataclass(frozen=True, slots=True)
class LeastNorm:
    """The equations at one configuration, without friction rows.

    `rows` (m, n_z + n_rows): B and Z side by side. `T` (nv, nv). `D` (n_x, n): limited quantities.
    """

    rows: np.ndarray
    T: np.ndarray
    D: np.ndarray

    def limit_rows(self, form: LeastNormForm, quantities: np.ndarray) -> np.ndarray:
        """Rows of (B, Z) for D y of some quantities (k,), (k, n_z + n_rows)."""
        D, n_a = self.D[quantities], len(self.T)
        rows = np.zeros((len(D), form.b.stop))
        np.matmul(D[:, :n_a], self.T, out=rows[:, form.rho_1])
        np.multiply(D[:, n_a:], form.force_scale, out=rows[:, form.f])
        np.negative(rows[:, form.rho_1], out=rows[:, form.s_1])
        return rows


class LeastNormForm:
    """The parts that all equations of a contact mode share: columns, constants, friction rows.

    Columns of (B, Z): `z` of B, in it `rho_1`, `f`, `rho_2`; `b` of Z, in it `s_1`. `friction_rows`
    (rows of C, n_z + n_rows): the friction rows of (B, Z); `force_scale` is 1/√ω_f.
    """

    def __init__(
        self,
        contacts: ContactGeometry,
        *,
        n_equalities: int,
        n_accelerations: int,
        task_weights: np.ndarray,
        force_weight: float,
    ) -> None:
        n_e, n_a, n_f, n_t = n_equalities, n_accelerations, contacts.n_forces, len(task_weights)
        n_z = n_t + n_f
        self.rho_1, self.f = slice(0, n_a), slice(n_a, n_a + n_f)
        self.rho_2, self.z = slice(n_a + n_f, n_z), slice(0, n_z)
        self.b = slice(n_z, n_z + n_e + n_t + 1)
        self.s_1 = slice(n_z + n_e, n_z + n_e + n_a)
        self.force_scale = 1.0 / math.sqrt(force_weight)
        scale = 1.0 / np.sqrt(task_weights[:n_a])
        self._T = np.diag(scale)
        self._T_com = -scale[0] * scale[3:]
        self._rows = np.zeros((n_e + n_t - n_a, self.b.stop))
        self._rows[:n_e, self.b.start : self.s_1.start] = np.eye(n_e)
        self._rows[n_e:, self.s_1.stop : -1] = np.eye(n_t - n_a)
        self._rows[n_e:, self.rho_2] = np.eye(n_t - n_a)
        self.friction_rows = np.zeros((len(contacts.l), self.b.stop))
        self.friction_rows[:, self.f] = contacts.C * self.force_scale
        self.friction_rows[:, -1] = contacts.l

    def at(self, E_a: np.ndarray, E_f: np.ndarray, A: np.ndarray, D: np.ndarray) -> LeastNorm:
        """The equations with the matrices of one configuration."""
        n_e, n_a = E_a.shape
        T = self._T.copy()
        # J_com = (I, X): its acceleration less X times the rest is the base's own.
        np.multiply(A[:3, 3:], self._T_com, out=T[:3, 3:])
        rows = self._rows.copy()
        np.matmul(E_a, T, out=rows[:n_e, self.rho_1])
        if len(rows) > n_e:
            np.matmul(A[n_a:], T, out=rows[n_e:, self.rho_1])
        np.multiply(E_f, self.force_scale, out=rows[: len(E_f), self.f])
        np.negative(rows[:, self.rho_1], out=rows[:, self.s_1])
        return LeastNorm(rows, T, D)
