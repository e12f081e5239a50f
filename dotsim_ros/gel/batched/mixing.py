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
GROWTH = 2.0
"""A step that grew by more has left the range where what is remembered means something."""


class Mixing:
    """What steps did with points; it lasts from one substep to the next, since the gel's stiffness
    hardly changes between them: three steps under a ball then leave 0.2 % of the force, not 3 %.

    Args:
        count: B.
        size: numbers in a point.
        memory: changes of points and steps that it remembers.
        device: torch's name of the device.
    """

    def __init__(self, count: int, size: int, memory: int, device: str) -> None:
        self._every = torch.arange(count, device=device)
        # Changes of steps, and those of points and steps together.
        self._changes = torch.zeros(count, memory, size, device=device)
        self._together = torch.zeros_like(self._changes)
        self._gram = torch.zeros(count, memory, memory, device=device)
        self._known = torch.zeros(count, dtype=torch.int64, device=device)
        self._eye = torch.eye(memory, device=device)
        self.begin()

    def begin(self) -> None:
        """Begin another iteration of all gels."""
        self._gels = self._every
        self._last: tuple[torch.Tensor, torch.Tensor] | None = None

    def forget(self, gels: torch.Tensor) -> None:
        """Forget what the steps of some gels (B,) did."""
        for known in (self._changes, self._together, self._gram):
            known.masked_fill_(gels[:, None, None], 0.0)

    def keep(self, number: torch.Tensor) -> None:
        """Go on with some of the gels only, in this order."""
        self._gels = self._gels[number]
        if self._last is not None:
            self._last = self._last[0][number], self._last[1][number]

    def step(self, point: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
        """Return the step (N, 3, b) to take from a point where the iteration takes another one."""
        count = len(self._gels)
        here, move = (each.reshape(-1, count).T.contiguous() for each in (point, step))
        grew = torch.zeros(count, 1, dtype=torch.bool, device=point.device)
        if self._last is not None:
            before, move_before = self._last
            self._remember(here - before, move - move_before)
            longest = GROWTH * move_before.norm(dim=1, keepdim=True)
            grew = move.norm(dim=1, keepdim=True) > longest
        self._last = here, move
        gram = self._gram[self._gels]
        mean = gram.diagonal(dim1=1, dim2=2).mean(dim=1).clamp(min=LEAST_CHANGE_M**2)
        # What is not known yet gets no share.
        gram = gram + REGULARISATION * mean[:, None, None] * self._eye
        along = torch.bmm(self._of_gels(self._changes), move[:, :, None])[:, :, 0]
        share = self._solved(gram.double(), along.double()).to(move.dtype)
        share = torch.where(grew, 0.0, share)
        mixed = torch.bmm(share[:, None], self._of_gels(self._together))[:, 0]
        return (move - mixed).T.reshape(point.shape)

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
        together = point_change + step_change
        is_one = together.isfinite().all(dim=1)
        is_one &= point_change.abs().amax(dim=1) > LEAST_CHANGE_M
        gels, slot = self._gels, self._known[self._gels] % len(self._eye)
        for known, new in ((self._changes, step_change), (self._together, together)):
            known[gels, slot] = torch.where(is_one[:, None], new, known[gels, slot])
        latest = self._changes[gels, slot][:, :, None]
        products = torch.bmm(self._of_gels(self._changes), latest)[:, :, 0]
        self._gram[gels, slot, :] = products
        self._gram[gels, :, slot] = products
        self._known[gels] += is_one
