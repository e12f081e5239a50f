# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frictional contact of gels that respond linearly: Newton's method, each step by GMRES.

Around the contact of each gel lies a region of R nodes of the grid, and of F nodes of a finer grid
that refines the contact (`implicit.refinement`). Under contact forces lam on them they move to
w = free + G lam, G block-diagonal, and the indenter answers the markers at x = base + W w with
forces f(x). Newton's method solves lam = W' f; its linear system (I + W' H W G) dlam = W' f - lam
needs no other preconditioner than that G stands in it (Saad, "Iterative methods for sparse linear systems", 2003,
section 6.5, for GMRES). H leaves out that the indenter's surface is curved: with it, Newton's method
diverges in deep presses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch

from dotsim_ros.gel.batched import kernels
from dotsim_ros.io.warp_runtime import wp

KRYLOV = 8
"""Steps of GMRES at most."""
FORCING = float(__import__("os").environ.get("FORC", "0.1"))
"""On a CPU it ends where its residual is below this share of the right hand side."""
LARGEST_STEP_M = 0.3e-3
"""No Newton step moves a node farther."""
SECANTS = 2
"""Trial steps of a line search."""


@dataclass(frozen=True)
class Markers:
    """The markers of each gel that may touch.

    Attributes:
        index: (B, M) their numbers.
        rest_m: (B, M, 3).
        area_m2: (B, M).
        node: (B, M, 27) int32 nodes of the grid around each.
        weight: (B, M, 27).
        start_position_m, start_slip_m: (B, M, 3) in the indenter's frame.
        rotation, origin_m: (B, 3, 3), (B, 3) pose of each indenter.
        field, law: Warp arrays (B,) of the indenters and of the contact's law.
    """

    index: torch.Tensor
    rest_m: torch.Tensor
    area_m2: torch.Tensor
    node: torch.Tensor
    weight: torch.Tensor
    start_position_m: torch.Tensor
    start_slip_m: torch.Tensor
    rotation: torch.Tensor
    origin_m: torch.Tensor
    field: Any
    law: Any


@dataclass(frozen=True)
class Region:
    """The nodes around the contact of each gel, those of the finer grid last.

    Attributes:
        node: (B, R) of the grid, fine_node: (B, F) of the finer one; F may be 0.
        compliance: (B, 3 R, 3 R) G between the former.
        fine_compliance: (B, 3 F, 3 F) what refinement adds between the latter.
        local: (B, M, S) int32 number in the region of the nodes of each marker; 0 for one outside.
        weight: (B, M, S), 0 for one outside.
    """

    node: torch.Tensor
    fine_node: torch.Tensor
    compliance: torch.Tensor
    fine_compliance: torch.Tensor
    local: torch.Tensor
    weight: torch.Tensor


def vectors(tensor: torch.Tensor) -> Any:
    """Return a tensor (..., 3) as a Warp array of vectors, without a copy."""
    return wp.from_torch(tensor, dtype=wp.vec3)


def matrices(tensor: torch.Tensor) -> Any:
    """Return a tensor (..., 3, 3) as a Warp array of matrices, without a copy."""
    return wp.from_torch(tensor, dtype=wp.mat33)


class ContactSolver:
    """The contact problems of a few gels, whose arrays keep their place.

    Args:
        count: B.
        markers, nodes, fine_nodes: M, R and F; 0 for a gel that is not refined.
        device: torch's name of the device.

    Attributes:
        force_n: (B, R + F, 3) lam.
        displacement_m: (B, R + F, 3) w.
        marker_force_n: (B, M, 3) f at w, by the contact's law made linear where lam was found.
        position_m, distance_m: (B, M, 3), (B, M) of the markers, signed distance to the indenter.
        local_position_m, slip_m: (B, M, 3) in the indenter's frame, for the next step's friction.
        step_m: (B,) how far the last Newton step moved a node.
    """

    def __init__(self, count: int, markers: int, nodes: int, fine_nodes: int, device: str) -> None:
        def make(*shape: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
            return torch.zeros(count, *shape, dtype=dtype, device=device)

        self._is_on_host = device == "cpu"
        every, stencil = nodes + fine_nodes, 54 if fine_nodes else 27
        self._shape = (count, every, 3)
        self._coarse = 3 * nodes
        self.force_n, self.displacement_m = make(every, 3), make(every, 3)
        self.marker_force_n, self.distance_m = make(markers, 3), make(markers)
        self.local_position_m, self.slip_m = make(markers, 3), make(markers, 3)
        self.step_m = make()
        self._compliance = make(3 * nodes, 3 * nodes)
        self._fine_compliance = make(3 * fine_nodes, 3 * fine_nodes)
        self._local = make(markers, stencil, dtype=torch.int32)
        self._weight = make(markers, stencil)
        self._area_m2, self._base_m = make(markers), make(markers, 3)
        self._start_m, self._start_slip_m = make(markers, 3), make(markers, 3)
        self._rotation, self._origin_m = make(3, 3), make(3)
        self.position_m, self._force_there_n = make(markers, 3), make(markers, 3)
        self._stiffness, self._moved_m = make(markers, 3, 3), make(markers, 3)
        self._at_nodes, self._from_nodes = make(every, 3), make(every, 3)
        self._basis = make(KRYLOV + 1, 3 * every)
        self._no_base_m = make(markers, 3)
        local, weight = wp.from_torch(self._local), wp.from_torch(self._weight)
        at_nodes, from_nodes = vectors(self._at_nodes), vectors(self._from_nodes)
        position, stiffness = vectors(self.position_m), matrices(self._stiffness)
        force = vectors(self._force_there_n)

        def record(kernel: Any, *arrays: Any) -> Any:
            return wp.launch(
                kernel,
                dim=(count, markers),
                inputs=list(arrays),
                device=position.device,
                record_cmd=True,
            )

        self._interpolate = record(
            kernels.interpolate, local, weight, at_nodes, vectors(self._base_m), position
        )
        self._interpolate_change = record(
            kernels.interpolate,
            local,
            weight,
            at_nodes,
            vectors(self._no_base_m),
            vectors(self._moved_m),
        )
        self._spread = record(kernels.spread, local, weight, force, from_nodes)
        self._stiffen = record(
            kernels.add_contact_stiffness, local, weight, stiffness, at_nodes, from_nodes
        )
        laws = wp.zeros(count, dtype=kernels.ContactLaw, device=position.device)
        fields = wp.zeros(count, dtype=kernels.IndenterField, device=position.device)
        self._answer = record(
            kernels.coulomb,
            position,
            wp.from_torch(self._area_m2),
            fields,
            matrices(self._rotation),
            vectors(self._origin_m),
            laws,
            vectors(self._start_m),
            vectors(self._start_slip_m),
            force,
            stiffness,
            wp.from_torch(self.distance_m),
            vectors(self.local_position_m),
            vectors(self.slip_m),
        )

    def set_problem(self, markers: Markers, region: Region, gels: slice) -> None:
        """Take the markers and regions of some of the gels."""
        self._local.copy_(region.local[gels])
        self._weight.copy_(region.weight[gels])
        self._compliance.copy_(region.compliance[gels])
        self._fine_compliance.copy_(region.fine_compliance[gels])
        self._area_m2.copy_(markers.area_m2[gels])
        self._start_m.copy_(markers.start_position_m[gels])
        self._start_slip_m.copy_(markers.start_slip_m[gels])
        self._rotation.copy_(markers.rotation[gels])
        self._origin_m.copy_(markers.origin_m[gels])
        self._answer.set_param_by_name("field", markers.field[gels])
        self._answer.set_param_by_name("law", markers.law[gels])

    def solve(
        self,
        *,
        free_m: torch.Tensor,
        base_m: torch.Tensor,
        force_n: torch.Tensor,
        guess_m: torch.Tensor,
        newton_steps: int,
        tolerance_m: float,
    ) -> None:
        """Find the contact.

        Args:
            free_m: (B, R + F, 3) where the nodes would be without contact forces.
            base_m: (B, M, 3) markers without the region's share.
            force_n: (B, R + F, 3) lam to begin with.
            guess_m: (B, M, 3) where the markers may come to lie. The contact is so stiff that where
                forces take them says little of who touches.
            newton_steps: at most.
            tolerance_m: on a CPU it ends where no node moves farther; 0 never.
        """
        self._base_m.copy_(base_m)
        lam, w = force_n, free_m + self._times(force_n)
        is_current = False
        for step in range(newton_steps):
            is_guess = step == 0
            if is_guess:
                self._answer_at(guess_m)
                self._at_nodes.copy_(w)
                self._interpolate.launch()
                # The linear answer at the markers that lam would cause.
                aside = self.position_m - guess_m
                self._force_there_n -= (self._stiffness @ aside[..., None])[..., 0]
            elif not is_current:
                self._answer_nodes(w)
            left = self._nodal() - lam
            change = self._gmres(left)
            moved = self._times(change)
            largest = moved.abs().amax(dim=(1, 2))
            share = (LARGEST_STEP_M / largest.clamp(min=1e-12)).clamp(max=1.0)[:, None, None]
            self._at_nodes.copy_(moved)
            self._interpolate_change.launch()
            linear = self._force_there_n - (self._stiffness @ self._moved_m[..., None])[..., 0]
            self._answer_nodes(w + share * moved)
            if not is_guess:
                share = self._searched(w, lam, moved, change, left, share)
            w, lam = w + share * moved, lam + share * change
            is_current = True
            is_small = largest * share[:, 0, 0] < tolerance_m
            if self._is_on_host and bool(is_small.all()):
                break
        self.marker_force_n.copy_(linear)
        self.force_n, self.displacement_m, self.step_m = lam, w, largest

    def _searched(
        self,
        w: torch.Tensor,
        lam: torch.Tensor,
        moved: torch.Tensor,
        change: torch.Tensor,
        left: torch.Tensor,
        share: torch.Tensor,
    ) -> torch.Tensor:
        """Return shares (B, 1, 1) of a Newton step after which it would not turn back, with the
        indenter's answer there; the answer at the given shares is known."""
        before = (moved * left).sum((1, 2), keepdim=True)
        for _ in range(SECANTS):
            trial = self._nodal() - (lam + share * change)
            after = (moved * trial).sum((1, 2), keepdim=True)
            turns_back = (after < -0.5 * before.abs()) & (before > 0.0)
            if self._is_on_host and not bool(turns_back.any()):
                break
            secant = share * (before / (before - after)).clamp(0.1, 0.9)
            share = torch.where(turns_back, secant, share)
            self._answer_nodes(w + share * moved)
        return share

    def _answer_at(self, position_m: torch.Tensor) -> None:
        self.position_m.copy_(position_m)
        self._answer.launch()

    def _answer_nodes(self, displacement_m: torch.Tensor) -> None:
        self._at_nodes.copy_(displacement_m)
        self._interpolate.launch()
        self._answer.launch()

    def _nodal(self) -> torch.Tensor:
        """Return W' f (B, R + F, 3)."""
        self._from_nodes.zero_()
        self._spread.launch()
        return self._from_nodes.clone()

    def _times(self, force_n: torch.Tensor) -> torch.Tensor:
        # It is symmetric; on a CPU a row times a matrix takes a tenth of a matrix times a column.
        row = force_n.reshape(self._shape[0], 1, -1)
        parts = [torch.bmm(row[..., : self._coarse], self._compliance)]
        if row.shape[2] > self._coarse:
            parts.append(torch.bmm(row[..., self._coarse :], self._fine_compliance))
        return torch.cat(parts, dim=2).view(self._shape)

    def _gmres(self, right: torch.Tensor) -> torch.Tensor:
        """Return dlam (B, R + F, 3) of (I + W' H W G) dlam = right, from zero."""
        count = self._shape[0]
        flat = right.view(count, -1)
        size = flat.norm(dim=1).clamp(min=1e-30)
        basis = self._basis
        basis[:, 0] = flat / size[:, None]
        hessenberg = flat.new_zeros(count, KRYLOV + 1, KRYLOV)
        target = flat.new_zeros(count, KRYLOV + 1, 1)
        target[:, 0, 0] = size
        for k in range(KRYLOV):
            vector = basis[:, k].view(self._shape)
            self._at_nodes.copy_(self._times(vector))
            self._from_nodes.copy_(vector)
            self._stiffen.launch()
            image = self._from_nodes.view(count, -1)
            known = basis[:, : k + 1]
            # Twice is enough for orthogonality to the last bits.
            for _ in range(2):
                share = torch.bmm(known, image[:, :, None])
                image = image - torch.bmm(known.transpose(1, 2), share)[:, :, 0]
                hessenberg[:, : k + 1, k] += share[:, :, 0]
            length = image.norm(dim=1)
            hessenberg[:, k + 1, k] = length
            basis[:, k + 1] = image / length.clamp(min=1e-30)[:, None]
            done = k + 1
            if (done == KRYLOV) or (self._is_on_host and done >= 3):
                share, rest = _least_squares(
                    hessenberg[:, : done + 1, :done], target[:, : done + 1]
                )
                if self._is_on_host and bool((rest < FORCING * size).all()):
                    break
        return torch.bmm(basis[:, :done].transpose(1, 2), share).view(self._shape)


def _least_squares(
    hessenberg: torch.Tensor, target: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return (B, k, 1) with least |target - hessenberg x|, and these norms (B,)."""
    q, r = torch.linalg.qr(hessenberg, mode="complete")
    turned = q.transpose(1, 2) @ target
    diagonal = r.diagonal(dim1=1, dim2=2)
    tiny = 1e-7 * diagonal.abs().amax(dim=1, keepdim=True).clamp(min=1e-30)
    filled = torch.where(diagonal.abs() < tiny, tiny, 0.0)
    square = r[:, :-1] + torch.diag_embed(filled)
    return (
        torch.linalg.solve_triangular(square, turned[:, :-1], upper=True),
        turned[:, -1, 0].abs(),
    )
