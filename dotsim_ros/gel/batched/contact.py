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

from dotsim_ros.gel.batched import contact_newton, kernels
from dotsim_ros.io.warp_runtime import wp


@dataclass(frozen=True)
class Markers:
    """The markers of each gel that may touch.

    Attributes:
        index: (B, K) their numbers.
        area_m2: (B, K).
        start_position_m, start_slip_m: (B, K, 3) in the indenter's frame.
        place: (B,) of the gels' compliances among those that are known.
        gel: (B,) numbers of the gels, for what follows.
        rotation, origin_m: poses of all indenters.
        field, law: Warp arrays of all indenters and of the contact's laws.
    """

    index: torch.Tensor
    area_m2: torch.Tensor
    start_position_m: torch.Tensor
    start_slip_m: torch.Tensor
    place: torch.Tensor
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
            place=self.place[number],
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
        compliance: (n, 3 K, 3 K) C, symmetric, of these and maybe other gels.
        base_m: (B, K, 3) markers without contact forces.
        force_n: (B, K, 3) to begin with.
        guess_m: (B, K, 3) where the markers may come to lie. The contact is so stiff that where
            forces take them says little of who touches.
        newton_steps: at most.
        tolerance_m: each gel ends where none of its markers moves farther.
    """
    count, k, _ = base_m.shape
    device = markers.field.device
    solution = Contact(
        force_n.clone(memory_format=torch.contiguous_format),
        torch.empty_like(base_m),
        base_m.new_empty(count, k),
        torch.empty_like(base_m),
    )
    problem: Any = contact_newton.Problem()
    problem.compliance = wp.from_torch(compliance)
    problem.base, problem.guess = vectors(base_m.contiguous()), vectors(guess_m.contiguous())
    problem.area, problem.gel = wp.from_torch(markers.area_m2), wp.from_torch(markers.gel)
    problem.place = wp.from_torch(markers.place)
    problem.start_position = vectors(markers.start_position_m)
    problem.start_slip = vectors(markers.start_slip_m)
    problem.field, problem.law = markers.field, markers.law
    problem.rotation, problem.origin = matrices(markers.rotation), vectors(markers.origin_m)
    answer: Any = contact_newton.Answer()
    answer.force = wp.from_torch(solution.force_n.view(count, 3 * k))
    answer.position = vectors(solution.position_m)
    answer.distance, answer.slip = wp.from_torch(solution.distance_m), vectors(solution.slip_m)
    memory: Any = contact_newton.Memory()
    for name in ("moved", "step", "change"):
        setattr(memory, name, wp.from_torch(base_m.new_empty(count, 3 * k)))
    memory.answer = vectors(base_m.new_empty(count, k, 3))
    memory.stiffness = matrices(base_m.new_empty(count, k, 3, 3))
    memory.basis = wp.from_torch(base_m.new_empty(count, contact_newton.KRYLOV + 1, 3 * k))
    wp.launch_tiled(
        contact_newton.solve,
        dim=[count],
        inputs=[problem, newton_steps, tolerance_m],
        outputs=[answer, memory],
        block_dim=kernels.BLOCK,
        device=device,
    )
    return solution
