# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Viscoelastic relaxation by a Prony series, as an incremental potential.

The shape-changing second Piola-Kirchhoff stress S relaxes as S - sum g_k (S - q_k) with internal
stresses q_k of time tau_k (Simo and Hughes, "Computational Inelasticity", 1998, section 10.2). Over
a step that ends at F the stress is fast_share * S(F) plus a constant that the past has left, so
the step still has an energy: fast_share * psi(F) + history : F^T F / 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dotsim_ros.gel.material import PronySeries
from dotsim_ros.io.arrays import FloatArray


@dataclass(frozen=True)
class StressMemory:
    """What relaxation remembers: internal stresses (K, P, 3, 3) and the last stress (P, 3, 3), or
    a loss's derivatives by them."""

    internal_pa: FloatArray
    last_pa: FloatArray


@dataclass(frozen=True)
class RelaxationAdjoint:
    """A loss's derivatives by what a step's relaxation depends on.

    Attributes:
        memory: by the memory at the step's start.
        shares, times_s: (K,) by the Prony series.
    """

    memory: StressMemory
    shares: FloatArray
    times_s: FloatArray


class Relaxation:
    """The internal stresses of one environment."""

    def __init__(self, prony: PronySeries) -> None:
        self.shares = np.array(prony.shares)
        self.times_s = np.array(prony.times_s)
        self._internal: FloatArray | None = None
        self._last_stress: FloatArray | None = None

    def memory(self, particle_count: int) -> StressMemory:
        """Return what is remembered now."""
        if self._internal is None or self._last_stress is None:
            zero = np.zeros((len(self.shares), particle_count, 3, 3))
            return StressMemory(zero, np.zeros((particle_count, 3, 3)))
        return StressMemory(self._internal, self._last_stress)

    def stress_adjoint(self, dt_s: float, after: StressMemory) -> FloatArray:
        """Return the derivatives (P, 3, 3) by the stress at a step's end, from those by the memory
        that `finish_step` makes of it."""
        _, gain = self._factors(dt_s)
        weighted: FloatArray = np.tensordot(self.shares * gain, after.internal_pa, axes=1)
        return after.last_pa + weighted

    def step_adjoint(
        self,
        dt_s: float,
        before: StressMemory,
        stress_pa: FloatArray,
        *,
        after: StressMemory,
        fast_share: float,
        history_pa: FloatArray,
    ) -> RelaxationAdjoint:
        """Return the derivatives of `step_terms` and `finish_step` together.

        Args:
            dt_s: duration of the step.
            before: the memory at its start.
            stress_pa: (P, 3, 3) the stress at its end.
            after, fast_share, history_pa: derivatives by the memory at the end, and by what
                `step_terms` returned.
        """
        decay, gain = self._factors(dt_s)
        ratio = dt_s / self.times_s
        gain_slope = (np.exp(-ratio) * (1.0 + ratio) - 1.0) / ratio**2
        by_internal = after.internal_pa + history_pa
        change = stress_pa - before.last_pa
        by_weight = np.tensordot(after.internal_pa, change, axes=3) - np.vdot(
            history_pa, before.last_pa
        )
        by_weight = by_weight + fast_share
        by_decay = np.einsum("kpij,kpij->k", by_internal, before.internal_pa)
        by_ratio = -decay * by_decay + self.shares * gain_slope * by_weight
        by_stress = np.tensordot(self.shares * gain, by_internal, axes=1)
        return RelaxationAdjoint(
            StressMemory(decay[:, None, None, None] * by_internal, -by_stress),
            gain * by_weight - fast_share,
            by_ratio * (-ratio / self.times_s),
        )

    def _factors(self, dt_s: float) -> tuple[FloatArray, FloatArray]:
        ratio = dt_s / self.times_s
        return np.exp(-ratio), -np.expm1(-ratio) / ratio

    def step_terms(self, dt_s: float, particle_count: int) -> tuple[float, FloatArray]:
        """Return the fast share and the stress (P, 3, 3) that the past leaves, for a step."""
        if len(self.shares) == 0:
            return 1.0, np.zeros((particle_count, 3, 3))
        if self._internal is None:
            self._internal = np.zeros((len(self.shares), particle_count, 3, 3))
            self._last_stress = np.zeros((particle_count, 3, 3))
        return self.terms_of(dt_s, self.memory(particle_count))

    def terms_of(self, dt_s: float, memory: StressMemory) -> tuple[float, FloatArray]:
        """Return what `step_terms` does, of a given memory."""
        decay, gain = self._factors(dt_s)
        fast = 1.0 - float(np.sum(self.shares * (1.0 - gain)))
        history = np.einsum("k,kpij->pij", decay, memory.internal_pa)
        history -= float(np.sum(self.shares * gain)) * memory.last_pa
        return fast, history

    def finish_step(self, dt_s: float, stress_pa: FloatArray) -> None:
        """Advance the internal stresses to the step's end, where S is `stress_pa` (P, 3, 3)."""
        if self._internal is None or self._last_stress is None:
            return
        decay, gain = self._factors(dt_s)
        change = stress_pa - self._last_stress
        self._internal = decay[:, None, None, None] * self._internal + (
            (self.shares * gain)[:, None, None, None] * change
        )
        self._last_stress = stress_pa
