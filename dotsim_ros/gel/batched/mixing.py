# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Anderson's mixing of fixed-point iterations, for each gel by itself (Walker and Ni, "Anderson
acceleration for fixed-point iterations", 2011)."""

from __future__ import annotations

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
        self._every = torch.arange(count, device=device)
        # Changes of points and of steps.
        self._points = torch.zeros(count, memory, size, device=device)
        self._steps = torch.zeros_like(self._points)
        self._gram = torch.zeros(count, memory, memory, device=device)
        self._stiffness = torch.ones(count, memory, device=device)
        self._known = torch.zeros(count, dtype=torch.int64, device=device)
        self._eye = torch.eye(memory, device=device)
        self.begin()

    def begin(self) -> None:
        """Begin another iteration of all gels."""
        self._gels = self._every
        self._last: tuple[torch.Tensor, torch.Tensor] | None = None

    def forget(self, gels: torch.Tensor) -> None:
        """Forget what the steps of some gels (B,) did."""
        for known in (self._points, self._steps, self._gram):
            known.masked_fill_(gels[:, None, None], 0.0)
        self._stiffness.masked_fill_(gels[:, None], 1.0)

    def keep(self, number: torch.Tensor) -> None:
        """Go on with some of the gels only, in this order."""
        self._gels = self._gels[number]
        if self._last is not None:
            self._last = self._last[0][number], self._last[1][number]

    def step(self, point: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
        """Return the step (N, 3, b) to take from a point where the iteration takes another one."""
        count = len(self._gels)
        here, move = (each.reshape(-1, count).T.contiguous() for each in (point, step))
        if self._last is not None:
            before, move_before = self._last
            self._remember(here - before, move - move_before)
        self._last = here, move
        gram = self._gram[self._gels]
        mean = gram.diagonal(dim1=1, dim2=2).mean(dim=1).clamp(min=LEAST_CHANGE_M**2)
        # What is not known yet gets no share.
        gram = gram + REGULARISATION * mean[:, None, None] * self._eye
        along = torch.bmm(self._of_gels(self._steps), move[:, :, None])[:, :, 0]
        share = self._solved(gram.double(), along.double()).to(move.dtype)
        point_share, step_share = (
            torch.bmm(share[:, None], self._of_gels(each))[:, 0]
            for each in (self._points, self._steps)
        )
        damping = self._of_gels(self._stiffness).amax(dim=1, keepdim=True).clamp(min=1.0).rsqrt()
        mixed = damping * (move - step_share) - point_share
        return mixed.T.reshape(point.shape)

    def _solved(self, matrix: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
        """Return the solutions (b, m) of symmetric systems (b, m, m), (b, m), which are lost."""
        inputs = [wp.from_torch(matrix), wp.from_torch(right)]
        device = str(matrix.device)
        wp.launch(kernels.solve_symmetric, dim=len(right), inputs=inputs, device=device)
        return right

    def _of_gels(self, values: torch.Tensor) -> torch.Tensor:
        """Return the values (B, ...) of the gels that go on, without a copy if all do."""
        return values if self._gels is self._every else values[self._gels]

    def _remember(self, point_change: torch.Tensor, step_change: torch.Tensor) -> None:
        # A gel that diverged or does not move any more adds nothing to what it knows.
        is_one = (point_change + step_change).isfinite().all(dim=1)
        is_one &= point_change.abs().amax(dim=1) > LEAST_CHANGE_M
        gels, slot = self._gels, self._known[self._gels] % len(self._eye)
        for known, new in ((self._points, point_change), (self._steps, step_change)):
            known[gels, slot] = torch.where(is_one[:, None], new, known[gels, slot])
        stiffness = step_change.norm(dim=1) / point_change.norm(dim=1)
        self._stiffness[gels, slot] = torch.where(is_one, stiffness, self._stiffness[gels, slot])
        latest = self._steps[gels, slot][:, :, None]
        products = torch.bmm(self._of_gels(self._steps), latest)[:, :, 0]
        self._gram[gels, slot, :] = products
        self._gram[gels, :, slot] = products
        self._known[gels] += is_one
