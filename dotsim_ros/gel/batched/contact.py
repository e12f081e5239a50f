# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frictional contact of gels that respond linearly: Newton's method, each step by GMRES.

Under forces f on K markers, they lie at x = base + C f, and the indenter answers there with F(x).
Newton's method solves f = F(x). Its linear system (I + H C) df = F - f, with H minus the derivative
of F, needs no preconditioner but C, which stands in it (Saad, "Iterative methods for sparse linear
systems", 2003, section 6.5, for GMRES). H leaves out that the indenter's surface is curved: with
that, Newton's method diverges in deep presses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch

from dotsim_ros.gel.batched import kernels
from dotsim_ros.io.warp_runtime import wp

FORCING = 0.03
"""GMRES ends where its residual is below this share of the right hand side."""
LARGEST_STEP_M = 0.3e-3
"""No Newton step moves a marker farther."""
LEAST_FORCE_N = 1.0e-12
"""Smaller forces on all markers of a gel are none."""
SECANTS = 2
"""Trial steps of a line search."""


@dataclass(frozen=True)
class Markers:
    """The markers of each gel that may touch.

    Attributes:
        index: (B, K) their numbers.
        area_m2: (B, K).
        start_position_m, start_slip_m: (B, K, 3) in the indenter's frame.
        gel: (B,) numbers of the gels, for what follows.
        rotation, origin_m: poses of all indenters.
        field, law: Warp arrays of all indenters and of the contact's laws.
    """

    index: torch.Tensor
    area_m2: torch.Tensor
    start_position_m: torch.Tensor
    start_slip_m: torch.Tensor
    gel: torch.Tensor
    rotation: torch.Tensor
    origin_m: torch.Tensor
    field: Any
    law: Any

    def part(self, number: torch.Tensor, count: int) -> Markers:
        """Return the first markers of some of these gels."""
        return replace(
            self,
            index=self.index[number, :count],
            area_m2=self.area_m2[number, :count],
            start_position_m=self.start_position_m[number, :count],
            start_slip_m=self.start_slip_m[number, :count],
            gel=self.gel[number],
        )

    def gather(self, values: torch.Tensor) -> torch.Tensor:
        """Return values (B, V, 3) of all markers at these (B, K, 3)."""
        return torch.gather(values, 1, self.index[:, :, None].expand(-1, -1, 3))


@dataclass
class Contact:
    """Forces f (B, K, 3) on the markers, their positions (B, K, 3), their distances (B, K) from the
    indenter, and elastic slip (B, K, 3) in its frame."""

    force_n: torch.Tensor
    position_m: torch.Tensor
    distance_m: torch.Tensor
    slip_m: torch.Tensor


def vectors(tensor: torch.Tensor) -> Any:
    """Return a tensor (..., 3) as a Warp array of vectors, without a copy."""
    return wp.from_torch(tensor, dtype=wp.vec3)


def matrices(tensor: torch.Tensor) -> Any:
    """Return a tensor (..., 3, 3) as a Warp array of matrices, without a copy."""
    return wp.from_torch(tensor, dtype=wp.mat33)


def solve_contact(
    markers: Markers,
    compliance: torch.Tensor,
    *,
    base_m: torch.Tensor,
    force_n: torch.Tensor,
    guess_m: torch.Tensor,
    newton_steps: int,
    tolerance_m: float,
) -> Contact:
    """Return the contact of gels that are linear around it.

    Args:
        markers: that may touch.
        compliance: (B, 3 K, 3 K) C, symmetric.
        base_m: (B, K, 3) markers without contact forces.
        force_n: (B, K, 3) to begin with.
        guess_m: (B, K, 3) where the markers may come to lie. The contact is so stiff that where
            forces take them says little of who touches.
        newton_steps: at most.
        tolerance_m: it ends where no marker moves farther. With 0 every count is fixed, and nothing
            is read from the device.
    """
    problem = _Problem(markers, compliance, base_m, may_stop=tolerance_m > 0.0)
    force = force_n
    moved = problem.moved_by(force)
    problem.answer_at(guess_m)
    # The indenter's linear answer around the guess, at the markers that the forces would cause.
    problem.answer_n -= problem.stiffness_times(base_m + moved - guess_m)
    for number in range(newton_steps):
        left = problem.answer_n - force
        change = problem.gmres(left)
        step = problem.moved_by(change)
        largest = step.abs().amax(dim=(1, 2))
        share = (LARGEST_STEP_M / largest.clamp(min=1e-12)).clamp(max=1.0)[:, None, None]
        problem.answer_at(base_m + moved + share * step)
        if number > 0:
            share = problem.line_search(moved, force, step, change, left, share)
        moved, force = moved + share * step, force + share * change
        if problem.may_stop and bool((largest * share[:, 0, 0] < tolerance_m).all()):
            break
    return Contact(force, base_m + moved, problem.distance_m, problem.slip_m)


class _Problem:
    """The linear gels with the indenters' answers at the markers' present positions."""

    def __init__(
        self, markers: Markers, compliance: torch.Tensor, base_m: torch.Tensor, *, may_stop: bool
    ) -> None:
        self._compliance, self._base_m, self.may_stop = compliance, base_m, may_stop
        count, k, _ = base_m.shape
        self.position_m = torch.empty_like(base_m)
        self.answer_n, self.slip_m = torch.empty_like(base_m), torch.empty_like(base_m)
        self._stiffness = base_m.new_empty(count, k, 3, 3)
        self.distance_m = base_m.new_empty(count, k)
        self._launch = wp.launch(
            kernels.coulomb,
            dim=(count, k),
            inputs=[
                vectors(self.position_m),
                wp.from_torch(markers.area_m2),
                wp.from_torch(markers.gel),
                markers.field,
                matrices(markers.rotation),
                vectors(markers.origin_m),
                markers.law,
                vectors(markers.start_position_m),
                vectors(markers.start_slip_m),
            ],
            outputs=[
                vectors(self.answer_n),
                matrices(self._stiffness),
                wp.from_torch(self.distance_m),
                vectors(self.slip_m),
            ],
            device=markers.field.device,
            record_cmd=True,
        )
        self._hessenberg = base_m.new_empty(count, kernels.KRYLOV + 1, kernels.KRYLOV)
        self._size, self._residual = base_m.new_empty(count), base_m.new_empty(count)
        self._share = base_m.new_empty(count, kernels.KRYLOV)
        # To prepare a launch takes longer than this kernel does.
        self._least_squares = wp.launch(
            kernels.least_squares,
            dim=count,
            inputs=[wp.from_torch(self._hessenberg), wp.from_torch(self._size), 0],
            outputs=[wp.from_torch(self._share), wp.from_torch(self._residual)],
            device=markers.field.device,
            record_cmd=True,
        )

    def answer_at(self, position_m: torch.Tensor) -> None:
        """Find what the indenters answer markers at (B, K, 3)."""
        self.position_m.copy_(position_m)
        self._launch.launch()

    def moved_by(self, force_n: torch.Tensor) -> torch.Tensor:
        """Return C f (B, K, 3)."""
        # It is symmetric; on a CPU a row times a matrix takes a tenth of a matrix times a column.
        row = force_n.reshape(len(force_n), 1, -1)
        return torch.bmm(row, self._compliance).view(force_n.shape)

    def stiffness_times(self, moved_m: torch.Tensor) -> torch.Tensor:
        """Return H x (B, K, 3)."""
        return torch.matmul(self._stiffness, moved_m[..., None])[..., 0]

    def line_search(
        self,
        moved: torch.Tensor,
        force: torch.Tensor,
        step: torch.Tensor,
        change: torch.Tensor,
        left: torch.Tensor,
        share: torch.Tensor,
    ) -> torch.Tensor:
        """Return shares (B, 1, 1) of a Newton step after which it would not turn back, with the
        indenter's answer there; that at the given shares is known."""
        before = (step * left).sum((1, 2), keepdim=True)
        for _ in range(SECANTS):
            after = (step * (self.answer_n - force - share * change)).sum((1, 2), keepdim=True)
            turns_back = (after < -0.5 * before.abs()) & (before > 0.0)
            if self.may_stop and not bool(turns_back.any()):
                break
            secant = share * (before / (before - after)).clamp(0.1, 0.9)
            share = torch.where(turns_back, secant, share)
            self.answer_at(self._base_m + moved + share * step)
        return share

    def gmres(self, right: torch.Tensor) -> torch.Tensor:
        """Return df (B, K, 3) of (I + H C) df = right, from zero."""
        count, shape = len(right), right.shape
        # Squares of less would underflow, and the basis would not be of unit length.
        is_nothing = right.abs().amax(dim=(1, 2), keepdim=True) < LEAST_FORCE_N
        flat = torch.where(is_nothing, 0.0, right).reshape(count, -1)
        size = torch.clamp(flat.norm(dim=1), min=1e-30, out=self._size)
        basis = flat.new_empty(count, kernels.KRYLOV + 1, flat.shape[1])
        basis[:, 0] = flat / size[:, None]
        hessenberg = self._hessenberg.zero_()
        for k in range(kernels.KRYLOV):
            vector = basis[:, k]
            moved = self.moved_by(vector.view(shape))
            image = vector + self.stiffness_times(moved).view(count, -1)
            known = basis[:, : k + 1]
            # Twice is enough for orthogonality to the last bits.
            for _ in range(2):
                along = torch.bmm(image[:, None], known.transpose(1, 2))
                image = image - torch.bmm(along, known)[:, 0]
                hessenberg[:, : k + 1, k] += along[:, 0]
            length = image.norm(dim=1)
            hessenberg[:, k + 1, k] = length
            basis[:, k + 1] = image / length.clamp(min=1e-30)[:, None]
            done = k + 1
            if done < kernels.KRYLOV and not (self.may_stop and done >= 3):
                continue
            self._least_squares.set_param_by_name("steps", done)
            self._least_squares.launch()
            if self.may_stop and bool((self._residual < FORCING * size).all()):
                break
        return torch.bmm(self._share[:, None, :done], basis[:, :done]).view(shape)
