# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Anderson's mixing of fixed-point iterations, for each gel by itself (Walker and Ni, "Anderson
acceleration for fixed-point iterations", 2011)."""

from __future__ import annotations

from typing import Any

import torch

from dotsim_ros.gel.batched import kernels
from dotsim_ros.io.warp_runtime import wp

LEAST_CHANGE_M = 2.0e-7
"""A shorter one is mostly rounding."""
REGULARISATION = 1.0e-7
"""Share of the mean diagonal that keeps the least squares solvable."""


class Mixing:
    """What steps did with points; it lasts from one substep to the next, since the gel's stiffness
    hardly changes between them: three steps under a ball then leave 0.2 % of the force, not 3 %.

    Memory explains a part of a step. The rest is taken times 1 / sqrt(s), where s is the largest
    quotient of a change of step and its change of point in memory: the gel's stiffness over that at
    rest. From 2 mm of depth on, whole steps grow up to ninefold each.

    Args:
        count: B.
        size: numbers in a point.
        memory: changes of points and steps that it remembers.
        device: torch's name of the device.
    """

    def __init__(self, count: int, size: int, memory: int, device: str) -> None:
        self._every = torch.arange(count, device=device, dtype=torch.int32)
        self._device = device
        self._known = [
            torch.zeros(count, memory, size, device=device),
            torch.zeros(count, memory, size, device=device),
            torch.zeros(count, memory, memory, device=device),
        ]
        self._stiffness = torch.ones(count, memory, device=device)
        memories: Any = kernels.Memories()
        memories.points, memories.steps, memories.products = map(wp.from_torch, self._known)
        memories.stiffness = wp.from_torch(self._stiffness)
        memories.count = wp.zeros(count, dtype=wp.int32, device=device)
        memories.last_point = wp.zeros((count, size), dtype=wp.float32, device=device)
        memories.last_step = wp.zeros((count, size), dtype=wp.float32, device=device)
        memories.least_change, memories.regularisation = LEAST_CHANGE_M, REGULARISATION
        self._memories = memories
        self.begin()

    def begin(self) -> None:
        """Begin another iteration of all gels."""
        self._gels = self._every
        self._is_first = True

    def forget(self, gels: torch.Tensor) -> None:
        """Forget what the steps of some gels (B,) did."""
        for known in self._known:
            known.masked_fill_(gels[:, None, None], 0.0)
        self._stiffness.masked_fill_(gels[:, None], 1.0)

    def keep(self, number: torch.Tensor) -> None:
        """Go on with some of the gels only, in this order."""
        self._gels = self._gels[number]

    def step(self, point: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
        """Return the step (N, 3, b) to take from a point where the iteration takes another one."""
        count, memory = len(self._gels), self._known[0].shape[1]
        here, move = (each.reshape(-1, count).T.contiguous() for each in (point, step))
        mixed = torch.empty_like(move)
        wp.launch_tiled(
            kernels.mix,
            dim=[count],
            inputs=[
                wp.from_torch(self._gels),
                wp.from_torch(here),
                wp.from_torch(move),
                self._is_first,
                self._memories,
                wp.from_torch(move.new_empty(count, memory, memory, dtype=torch.float64)),
                wp.from_torch(move.new_empty(count, memory, dtype=torch.float64)),
                wp.from_torch(mixed),
            ],
            block_dim=kernels.BLOCK,
            device=self._device,
        )
        self._is_first = False
        return mixed.T.reshape(point.shape)
