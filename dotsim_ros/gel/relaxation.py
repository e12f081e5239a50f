"""Viscoelastic relaxation by a Prony series, as an incremental potential.

The shape-changing second Piola-Kirchhoff stress S relaxes as S - sum g_k (S - q_k) with internal
stresses q_k of time tau_k (Simo and Hughes, "Computational Inelasticity", 1998, section 10.2). Over
a step that ends at F the stress is fast_share * S(F) plus a constant that the past has left, so
the step still has an energy: fast_share * psi(F) + history : F^T F / 2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.gel.material import PronySeries

Array = NDArray[np.float64]


class Relaxation:
    """The internal stresses of one environment."""

    def __init__(self, prony: PronySeries) -> None:
        self.shares = np.array(prony.shares)
        self.times_s = np.array(prony.times_s)
        self._internal: Array | None = None
        self._last_stress: Array | None = None

    def _factors(self, dt_s: float) -> tuple[Array, Array]:
        ratio = dt_s / self.times_s
        return np.exp(-ratio), -np.expm1(-ratio) / ratio

    def step_terms(self, dt_s: float, particle_count: int) -> tuple[float, Array]:
        """Return the fast share and the stress (P, 3, 3) that the past leaves, for a step."""
        if len(self.shares) == 0:
            return 1.0, np.zeros((particle_count, 3, 3))
        if self._internal is None:
            self._internal = np.zeros((len(self.shares), particle_count, 3, 3))
            self._last_stress = np.zeros((particle_count, 3, 3))
        decay, gain = self._factors(dt_s)
        fast = 1.0 - float(np.sum(self.shares * (1.0 - gain)))
        history = np.einsum("k,kpij->pij", decay, self._internal)
        history -= float(np.sum(self.shares * gain)) * self._last_stress
        return fast, history

    def finish_step(self, dt_s: float, stress_pa: Array) -> None:
        """Advance the internal stresses to the step's end, where S is `stress_pa` (P, 3, 3)."""
        if self._internal is None or self._last_stress is None:
            return
        decay, gain = self._factors(dt_s)
        change = stress_pa - self._last_stress
        self._internal = decay[:, None, None, None] * self._internal + (
            (self.shares * gain)[:, None, None, None] * change
        )
        self._last_stress = stress_pa
