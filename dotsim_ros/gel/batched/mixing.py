# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Anderson's mixing of fixed-point iterations, for each gel by itself (Walker and Ni, "Anderson
acceleration for fixed-point iterations", 2011)."""

from __future__ import annotations

import torch

MEMORY = 5
"""Changes that it remembers."""
REGULARISATION = 1.0e-8
"""Share of the mean diagonal that keeps the least squares solvable."""
GROWTH = 2.0
"""A step that grew by more has left the range where what is remembered means something."""


class Mixing:
    """What steps did with points; it lasts from one substep to the next, since the gel's stiffness
    hardly changes between them: three steps under a ball then leave 0.2 % of the force, not 3 %."""

    def __init__(self) -> None:
        self._point_changes: list[torch.Tensor] = []
        self._step_changes: list[torch.Tensor] = []
        self._last: tuple[torch.Tensor, torch.Tensor] | None = None

    def begin(self) -> None:
        """Begin another iteration."""
        self._last = None

    def step(self, point: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
        """Return the step (N, 3, B) to take from a point where the iteration takes another one."""
        here, move = point.reshape(-1, point.shape[2]), step.reshape(-1, point.shape[2])
        grew = torch.zeros(point.shape[2], dtype=torch.bool, device=point.device)
        if self._last is not None:
            before, move_before = self._last
            self._point_changes = [*self._point_changes, here - before][-MEMORY:]
            self._step_changes = [*self._step_changes, move - move_before][-MEMORY:]
            grew = move.norm(dim=0) > GROWTH * move_before.norm(dim=0)
        self._last = here, move
        if not self._step_changes:
            return step
        changes = torch.stack(self._step_changes)
        gram = torch.einsum("mnb,knb->bmk", changes, changes)
        mean = gram.diagonal(dim1=1, dim2=2).mean(dim=1).clamp(min=1e-30)
        eye = torch.eye(gram.shape[1], device=gram.device)
        gram = gram + REGULARISATION * mean[:, None, None] * eye
        share = torch.linalg.solve(gram, torch.einsum("mnb,nb->bm", changes, move))
        share = torch.where(grew[:, None], 0.0, share)
        together = torch.stack(self._point_changes) + changes
        return (move - torch.einsum("bm,mnb->nb", share, together)).view(point.shape)
