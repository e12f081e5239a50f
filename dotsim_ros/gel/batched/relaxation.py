# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Viscoelastic relaxation of many gels: `gel.implicit.relaxation` with a batch axis."""

from __future__ import annotations

import torch

from dotsim_ros.gel.batched.elastic import ElasticForces
from dotsim_ros.gel.material import PronySeries


class Relaxation:
    """The internal stresses of B gels, which its elastic forces take part of.

    Args:
        prony: the series, of one term at least.
        elastic: the forces.
        count: B.
    """

    def __init__(self, prony: PronySeries, elastic: ElasticForces, count: int) -> None:
        self._elastic = elastic
        like = elastic.shape_stress(
            torch.zeros(elastic.node_count, 3, count, device=elastic.device)
        )
        # [term, 1, 1, 1]
        self._share, self._time_s = (
            like.new_tensor(values)[:, None, None, None] for values in (prony.shares, prony.times_s)
        )
        self._last_pa = torch.zeros_like(like)
        self._internal_pa = like.new_zeros(len(prony.shares), *like.shape)

    def reset(self, gels: torch.Tensor) -> None:
        """Forget the stresses of some gels (B,)."""
        self._last_pa[..., gels] = 0.0
        self._internal_pa[..., gels] = 0.0

    def begin(self, dt_s: torch.Tensor) -> None:
        """Begin a substep that lasts (B,)."""
        ratio = dt_s / self._time_s
        self._decay, self._gain = torch.exp(-ratio), -self._share * torch.expm1(-ratio) / ratio
        slow = self._gain.sum(dim=0)
        self._elastic.fast_share = (1.0 - self._share.sum() + slow).view(-1).contiguous()
        history_pa = (self._decay * self._internal_pa).sum(dim=0) - slow * self._last_pa
        self._elastic.history_pa = history_pa

    def finish(self, displacement_m: torch.Tensor, moved: torch.Tensor) -> None:
        """End it at displacements (N, 3, B), for the gels (B,) that moved."""
        stress_pa = self._elastic.shape_stress(displacement_m)
        new = self._decay * self._internal_pa + self._gain * (stress_pa - self._last_pa)
        self._internal_pa = torch.where(moved, new, self._internal_pa)
        self._last_pa = torch.where(moved, stress_pa, self._last_pa)
