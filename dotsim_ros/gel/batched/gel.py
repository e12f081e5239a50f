# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Many gels of one sensor at equilibrium with their indenters, in one state with a batch axis.

Each frame is a fixed point of u = u + G (lam' + r(u)): r are the elastic forces out of balance at
displacements u, G the inverse of the stiffness at rest, and lam' the contact forces that balance
the gel that is linear around u (`inner`). Anderson's mixing (Walker and Ni, "Anderson acceleration
for fixed-point iterations", 2011) makes it converge where the gel's stiffness is far from that at
rest. Nothing is factored, and no gel needs a matrix of its own but the compliance of the few nodes
around its contact.

The shape does not depend on Young's modulus: a gel that is stiffer by a factor has its forces
multiplied by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from dotsim_ros.gel.batched import kernels
from dotsim_ros.gel.batched.inner import ContactSolver, Markers, Region, matrices, vectors
from dotsim_ros.gel.batched.rest_compliance import RestCompliance
from dotsim_ros.gel.discretization import discretize
from dotsim_ros.gel.distance_field import indenter_field
from dotsim_ros.gel.elasticity import GHOST_PENALTY, group_by_cell, linear_stiffness
from dotsim_ros.gel.implicit.contact import ONSET_M, REFERENCE_SPACING_M, SMOOTHING_M
from dotsim_ros.gel.implicit.refinement import Refinement, refine
from dotsim_ros.gel.implicit.rest_compliance import kept_compliance
from dotsim_ros.gel.make import body_of, law_of, skin_of
from dotsim_ros.gel.material import small_strain_moduli_pa
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.warp_runtime import wp
from dotsim_ros.specification import SensorSpecification

LARGEST_MOVE_M = 0.6e-3
"""The indenter moves no farther in a substep..."""
TOUCH_SHARE = 0.05
"""...and, until it has been in contact for a step, by no more than this share of the grid's
spacing."""
MARGIN_M = 1.5e-3
"""Markers nearer to the indenter than this may touch in a substep."""
NEAR_M = 0.5e-3
"""The region of a gel are the nodes around markers nearer than this..."""
FINE_NEAR_M = 0.15e-3
"""...and those of the finer grid around markers nearer than this."""
LARGEST_STEP_M = 0.6e-3
"""No outer step moves a node farther."""
MEMORY = 5
"""Steps that Anderson's mixing remembers."""
REGULARISATION = 1.0e-8
FAR_SLIDE_M = 0.1e-3
"""A marker that slides farther follows the indenter's surface, not a straight line."""
FIRST_STEPS = 2
"""A substep's first contact problem takes so many times the Newton steps of the others."""
CHUNK = 16
"""So many gels solve their contact together on a CPU: what they need fits its caches."""


@dataclass(frozen=True)
class BatchState:
    """All gels after a step.

    Attributes:
        skin_position_m: (B, V, 3) base frame.
        force_n, torque_nm: (B, 3) of each gel on its indenter; torque about the base's origin.
        max_penetration_m: (B,) of a marker into the indenter.
        left_m: (B,) how far the last outer step moved any node.
    """

    skin_position_m: torch.Tensor
    force_n: torch.Tensor
    torque_nm: torch.Tensor
    max_penetration_m: torch.Tensor
    left_m: torch.Tensor


@dataclass(frozen=True)
class Effort:
    """What a substep may cost.

    Attributes:
        outer: fixed-point steps at most.
        newton: steps of each contact problem at most.
        tolerance_m: both end early where no node of any gel moves farther; 0 for fixed counts.
        markers: of the skin that may touch an indenter.
        nodes, fine_nodes: of the grid and of the refinement around a contact.
    """

    outer: int = 4
    newton: int = 6
    tolerance_m: float = 0.0
    markers: int = 512
    nodes: int = 128
    fine_nodes: int = 192


class BatchedGel:
    """B gels of one sensor.

    Args:
        specification: of the sensor; its camera has no part in it.
        indenters: one for all gels, or one for each.
        count: B.
        friction: (B,) coefficients; None for the sensor's.
        modulus_factor: (B,) each gel's Young's modulus over the sensor's; None for 1.
        effort: of a substep.
        device: torch's name of the device.

    Raises:
        ValueError: an argument of another length than B, or a material with relaxation.
    """

    def __init__(
        self,
        specification: SensorSpecification,
        indenters: Indenter | Sequence[Indenter],
        count: int,
        *,
        friction: FloatArray | None = None,
        modulus_factor: FloatArray | None = None,
        effort: Effort | None = None,
        device: str = "cpu",
    ) -> None:
        s = specification
        if s.material.prony_shares:
            raise ValueError("material.prony_shares are given, expected none for a batched gel")
        self.count, self.device, self.effort = count, device, effort or Effort()
        self.skin = skin_of(s.gel)
        law, body = law_of(s.material), body_of(s.gel)
        d = self.discretization = discretize(
            body, self.skin.rest_position_m, s.solver.grid_spacing_m
        )
        compliance = kept_compliance(body, self.skin.rest_position_m, d, law)
        self.rest = RestCompliance(d, compliance, is_mirrored=True, device=device)
        n = d.node_count
        self._between = (
            self.rest.matrix.view(n, 3, n, 3).permute(0, 2, 1, 3).reshape(n * n, 9).contiguous()
        )

        def tensor(values: object, dtype: torch.dtype = torch.float32) -> torch.Tensor:
            return torch.as_tensor(np.ascontiguousarray(values), device=device).to(dtype)

        cells = group_by_cell(d)
        volume = np.where(cells.particle >= 0, d.particle_volume_m3[cells.particle], 0.0)
        self._cell_node = tensor(cells.node, torch.int64).reshape(-1)
        self._cell_gradient = tensor(cells.gradient)
        self._cell_divergence = self._cell_gradient.transpose(1, 2).contiguous()
        self._volume = wp.from_torch(tensor(volume).reshape(-1))
        linear = linear_stiffness(d, law, GHOST_PENALTY)
        self._linear = _sparse(linear, device)
        self._skin_weight = _sparse(d.skin_interpolation.matrix(n), device)
        self._marker_node = tensor(d.skin_interpolation.node_index, torch.int64)
        self._marker_weight = tensor(d.skin_interpolation.weight)
        self._rest_m = tensor(self.skin.rest_position_m)
        self._area_m2 = tensor(self.skin.rest_area_m2)
        self._on_base = tensor(self.skin.on_base, torch.bool)
        self._law = wp.array(
            np.tile(law.coefficients_pa(), (count, 1)).astype(np.float32),
            dtype=kernels.coefficients,
            device=device,
        )
        self._youngs_pa, _ = small_strain_moduli_pa(law)
        self._contact = s.contact
        self._factor = tensor(_each(modulus_factor, 1.0, count, "modulus_factor"))
        self._friction = _each(friction, s.contact.friction_coefficient, count, "friction")
        self._markers_kept = min(self.effort.markers, self.skin.vertex_count)
        self._nodes_kept = min(self.effort.nodes, n)
        self._refinement: _Refinement | None = None
        if s.solver.refined:
            table = refine(body, self.skin.rest_position_m, d, lambda: compliance, law)
            self._refinement = _Refinement(table, device)
        fine = 0 if self._refinement is None else self.effort.fine_nodes
        self._chunk = min(CHUNK, count) if device == "cpu" else count
        self._solvers = {
            size: ContactSolver(size, self._markers_kept, self._nodes_kept, fine, device)
            for size in {self._chunk, count % self._chunk or self._chunk}
        }
        self.set_indenters(indenters)

    def set_indenters(self, indenters: Indenter | Sequence[Indenter]) -> None:
        """Replace the indenters, one for all gels or one for each, and return to rest."""
        given = [indenters] if isinstance(indenters, Indenter) else list(indenters)
        if len(given) not in (1, self.count):
            raise ValueError(f"{len(given)} indenters for {self.count} gels, expected one or each")
        # The same shape is on the device once.
        known = {
            id(one): indenter_field(one, scalar=wp.float32, device=self.device) for one in given
        }
        fields = [known[id(one)] for one in given] * (self.count // len(given))
        self._fields = known
        self._field = wp.array(fields, dtype=kernels.IndenterField, device=self.device)
        laws = []
        for friction in self._friction.tolist():
            law = kernels.ContactLaw()
            law.stiffness = self._contact.stiffness * self._youngs_pa / REFERENCE_SPACING_M
            law.tangential_stiffness = self._contact.tangential_ratio * law.stiffness
            law.friction, law.onset, law.smoothing = friction, ONSET_M, SMOOTHING_M
            laws.append(law)
        self._contact_law = wp.array(laws, dtype=kernels.ContactLaw, device=self.device)
        self.reset()

    def reset(self) -> None:
        """Return every gel to rest, with its indenter away."""
        b, n, v = self.count, self.discretization.node_count, self.skin.vertex_count
        zeros = torch.zeros
        at = {"device": self.device}
        self.displacement_m = zeros(n, 3, b, **at)
        self._change_m = zeros(n, 3, b, **at)
        self._nodal_force_n = zeros(n, 3, b, **at)
        fine = 0 if self._refinement is None else self._refinement.node_count
        self._fine_force_n = zeros(b, fine, 3, **at)
        self._added_m = zeros(b, v, 3, **at)
        self._skin_m = self._rest_m.expand(b, v, 3).contiguous()
        self._local_m, self._local_change_m = zeros(b, v, 3, **at), zeros(b, v, 3, **at)
        self._slip_m = zeros(b, v, 3, **at)
        self._gap_m = torch.full((b, v), torch.inf, **at)
        self._origin_m, self._rotation = zeros(b, 3, **at), torch.eye(3, **at).expand(b, 3, 3)
        self._move_m = zeros(b, 3, **at)
        self._is_touching = torch.zeros(b, dtype=torch.bool, **at)
        self._is_placed = False
        self._mixing = _Mixing()
        self._force_n, self._torque_nm = zeros(b, 3, **at), zeros(b, 3, **at)
        self._penetration_m, self._left_m = zeros(b, **at), zeros(b, **at)

    def step(self, position_m: FloatArray, quaternion_xyzw: FloatArray) -> BatchState:
        """Move each indenter to its pose on a straight way and find the gels.

        Args:
            position_m: (B, 3) base frame.
            quaternion_xyzw: (B, 4).
        """
        target = torch.as_tensor(np.asarray(position_m, dtype=np.float32), device=self.device)
        turn = rotation_of(
            torch.as_tensor(np.asarray(quaternion_xyzw, dtype=np.float32), device=self.device)
        )
        if not self._is_placed:
            reach = float(np.ptp(self.skin.rest_position_m, axis=0).max())
            self._origin_m, self._rotation = target + reach * turn[:, :, 2], turn
            self._is_placed = True
        start, start_turn = self._origin_m, self._rotation
        way = (target - start).norm(dim=1)
        # From the air, only the way after the first touch counts, in short moves.
        touch = torch.where(
            self._is_touching, torch.zeros_like(way), self._touch_share(start, target, turn)
        )
        longest = torch.where(
            self._is_touching, LARGEST_MOVE_M, TOUCH_SHARE * self.discretization.spacing_m
        )
        moves = (way * (1.0 - touch) / longest).ceil().clamp(min=1.0)
        for k in range(int(moves.max())):
            share = (touch + (1.0 - touch) * (k + 1) / moves)[:, None]
            is_moving = k < moves
            origin = torch.where(is_moving[:, None], start + share * (target - start), target)
            last = k + 1 >= moves
            rotation = torch.where(
                last[:, None, None],
                turn,
                nearest_rotation(start_turn + share[:, :, None] * (turn - start_turn)),
            )
            self._substep(origin, rotation, is_moving)
        return BatchState(
            self._skin_m,
            self._factor[:, None] * self._force_n,
            self._factor[:, None] * self._torque_nm,
            self._penetration_m,
            self._left_m,
        )

    def _touch_share(
        self, start: torch.Tensor, target: torch.Tensor, turn: torch.Tensor
    ) -> torch.Tensor:
        """Return the share (B,) of a straight way after which each indenter may touch the gel at
        rest; the distance is a way that touches nothing."""
        share = torch.zeros(self.count, device=self.device)
        if self.device == "cpu" and bool(self._is_touching.all()):
            return share
        way = (target - start).norm(dim=1).clamp(min=1e-12)
        for _ in range(12):
            origin = start + share[:, None] * (target - start)
            gap = self._skin_distance(self._rest_m.expand(self.count, -1, 3), origin, turn)
            share = (share + (gap.amin(dim=1) - ONSET_M).clamp(min=0.0) / way).clamp(max=1.0)
        return share

    def _surface(
        self, position_m: torch.Tensor, origin_m: torch.Tensor, rotation: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the signed distances (B, n) of points (B, n, 3) and their gradients (B, n, 3)."""
        distance = torch.empty(position_m.shape[:2], device=self.device)
        normal = torch.empty(position_m.shape, device=self.device)
        wp.launch(
            kernels.surface,
            dim=tuple(distance.shape),
            inputs=[
                vectors(position_m.contiguous()),
                self._field,
                matrices(rotation.contiguous()),
                vectors(origin_m.contiguous()),
                wp.from_torch(distance),
                vectors(normal),
            ],
            device=self.device,
        )
        return distance, normal

    def _skin_distance(
        self, position_m: torch.Tensor, origin_m: torch.Tensor, rotation: torch.Tensor
    ) -> torch.Tensor:
        """Return the signed distances (B, V) of the skin (B, V, 3); infinite on the base."""
        distance, _ = self._surface(position_m, origin_m, rotation)
        return torch.where(self._on_base, torch.inf, distance)

    def _at_markers(
        self, markers: Markers, nodal: torch.Tensor, base_m: torch.Tensor
    ) -> torch.Tensor:
        """Return base_m (B, M, 3) and what nodes move by, (N, 3, B), at the markers."""
        result = torch.empty_like(base_m)
        wp.launch(
            kernels.interpolate,
            dim=tuple(base_m.shape[:2]),
            inputs=[
                wp.from_torch(markers.node),
                wp.from_torch(markers.weight),
                vectors(nodal.permute(2, 0, 1).contiguous()),
                vectors(base_m),
                vectors(result),
            ],
            device=self.device,
        )
        return result

    def _elastic_force(self, displacement_m: torch.Tensor) -> torch.Tensor:
        """Return the derivative of the elastic energy (N, 3, B) by displacements (N, 3, B)."""
        n, _, b = displacement_m.shape
        flat = displacement_m.reshape(n, 3 * b)
        cells = len(self._cell_gradient)
        moved = flat[self._cell_node].view(cells, 27, 3 * b)
        gradient = torch.bmm(self._cell_gradient, moved).view(-1, 3, b)
        stress = torch.empty_like(gradient)
        wp.launch(
            kernels.first_piola_kirchhoff,
            dim=(8 * cells, b),
            inputs=[wp.from_torch(gradient), self._volume, self._law, wp.from_torch(stress)],
            device=self.device,
        )
        force = self._linear @ flat
        force.index_add_(
            0,
            self._cell_node,
            torch.bmm(self._cell_divergence, stress.view(cells, 24, 3 * b)).view(-1, 3 * b),
        )
        return force.view(n, 3, b)

    def _skin(self, displacement_m: torch.Tensor) -> torch.Tensor:
        """Return the skin (B, V, 3) at displacements (N, 3, B)."""
        n, _, b = displacement_m.shape
        moved = (self._skin_weight @ displacement_m.reshape(n, 3 * b)).view(-1, 3, b)
        return (self._rest_m[:, :, None] + moved).permute(2, 0, 1).contiguous()

    def _substep(
        self, origin_m: torch.Tensor, rotation: torch.Tensor, is_moving: torch.Tensor
    ) -> None:
        """Advance the gels that move to new poses (B, 3), (B, 3, 3) of their indenters."""
        b = self.count
        rotation = rotation.contiguous()
        at_rest = self._skin_distance(self._rest_m.expand(b, -1, 3), origin_m, rotation)
        touches = at_rest.amin(dim=1) < ONSET_M
        begins = touches & ~self._is_touching
        to_local = rotation.transpose(1, 2)[:, None]
        local = torch.matmul(to_local, (self._skin_m - origin_m[:, None])[..., None])[..., 0]
        fresh = begins[:, None, None]
        self._local_m = torch.where(fresh, local, self._local_m)
        for remembered in (self._local_change_m, self._slip_m):
            remembered.masked_fill_(fresh, 0.0)
        share = self._share_of_last_move(origin_m, begins)
        distance = self._skin_distance(self._skin_m, origin_m, rotation)
        markers = self._markers(distance, origin_m, rotation)
        guess = self._guess(markers, share)
        u = self.displacement_m + share * self._change_m
        u, load, contact, left = self._equilibrium(u, markers, guess)
        self._finish(u, load, markers, contact, left, touches, is_moving)

    def _share_of_last_move(self, origin_m: torch.Tensor, begins: torch.Tensor) -> torch.Tensor:
        """Return how much of the last substep's motion this one repeats (B,)."""
        length = self._move_m.square().sum(dim=1)
        along = ((origin_m - self._origin_m) * self._move_m).sum(dim=1)
        share = (along / length.clamp(min=1e-18)).clamp(-1.0, 2.0)
        return torch.where(begins | ~self._is_touching, 0.0, share)

    def _markers(
        self, distance_m: torch.Tensor, origin_m: torch.Tensor, rotation: torch.Tensor
    ) -> Markers:
        """Return the markers that are nearest to the indenters, as many for each gel."""
        count = self._markers_kept
        index = torch.topk(distance_m, count, dim=1, largest=False).indices
        three = index[:, :, None].expand(-1, -1, 3)
        return Markers(
            index,
            self._rest_m[index],
            self._area_m2[index],
            self._marker_node[index].to(torch.int32),
            self._marker_weight[index],
            torch.gather(self._local_m, 1, three),
            torch.gather(self._slip_m, 1, three),
            rotation,
            origin_m.contiguous(),
            self._field,
            self._contact_law,
        )

    def _guess(self, markers: Markers, share: torch.Tensor) -> torch.Tensor:
        """Return where the markers may come to lie (B, M, 3): they keep their motion in the
        indenter's frame."""
        three = markers.index[:, :, None].expand(-1, -1, 3)
        slide = share[:, None, None] * torch.gather(self._local_change_m, 1, three)
        local = markers.start_position_m + slide
        guess = _to_base(local, markers)
        is_far = slide.norm(dim=2) > FAR_SLIDE_M
        if self.device == "cpu" and not bool(is_far.any()):
            return guess
        # Where it slid far, a marker is as deep as those were that it meets there.
        before = torch.gather(self._gap_m, 1, markers.index)
        apart = torch.cdist(local, markers.start_position_m).square()
        apart = torch.where(before[:, None, :] < 5e-3, apart, 1e6)
        near, number = torch.topk(apart, 4, dim=2, largest=False)
        weight = 1.0 / (near + 1e-8)
        depth = torch.gather(before[:, None, :].expand(-1, guess.shape[1], -1), 2, number)
        known = (weight * depth.clamp(max=1.0)).sum(dim=2) / weight.sum(dim=2)
        now, normal = self._surface(guess, markers.origin_m, markers.rotation)
        normal = normal / normal.norm(dim=2, keepdim=True).clamp(min=1e-12)
        moved = guess + (known - now)[:, :, None] * normal
        return torch.where(is_far[:, :, None], moved, guess)

    def _region(self, u: torch.Tensor, markers: Markers) -> Region:
        """Return the nodes around the contact of each gel at displacements (N, 3, B)."""
        b, n = self.count, self.discretization.node_count
        three = markers.index[:, :, None].expand(-1, -1, 3)
        base = markers.rest_m + torch.gather(self._added_m, 1, three)
        position = self._at_markers(markers, u, base)
        distance, _ = self._surface(position, markers.origin_m, markers.rotation)
        near = (distance < NEAR_M).float()[:, :, None]
        chosen, local, weight = _chosen_nodes(
            markers.node, markers.weight, near, n, self._nodes_kept
        )
        count = self._nodes_kept
        pairs = (chosen[:, :, None] * n + chosen[:, None, :]).view(-1)
        between = self._between.index_select(0, pairs).view(b, count, count, 3, 3)
        compliance = between.permute(0, 1, 3, 2, 4).reshape(b, 3 * count, 3 * count)
        if self._refinement is None:
            return Region(
                chosen,
                chosen[:, :0],
                compliance,
                compliance[:, :0, :0],
                local.clamp(min=0),
                weight,
            )
        r = self._refinement
        fine, fine_local, fine_weight = _chosen_nodes(
            r.marker_node[markers.index],
            r.marker_weight[markers.index],
            (distance < FINE_NEAR_M).float()[:, :, None],
            r.node_count,
            self.effort.fine_nodes,
        )
        return Region(
            chosen,
            fine,
            compliance,
            r.between(fine),
            torch.cat([local.clamp(min=0), fine_local.clamp(min=0) + count], dim=2),
            torch.cat([weight, fine_weight], dim=2),
        )

    def _equilibrium(
        self, u: torch.Tensor, markers: Markers, guess: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, _Contact, torch.Tensor]:
        """Return displacements (N, 3, B), contact forces on the nodes (N, 3, B), the contact, and
        how far the last step moved any node (B,)."""
        effort = self.effort
        region = self._region(u, markers)
        three = region.node.T[:, None, :].expand(-1, 3, -1)

        def gather(nodal: torch.Tensor) -> torch.Tensor:
            return torch.gather(nodal, 0, three).permute(2, 0, 1).contiguous()

        fine_three = region.fine_node[:, :, None].expand(-1, -1, 3)
        no_fine = u.new_zeros(fine_three.shape)
        lam = torch.cat(
            [gather(self._nodal_force_n), torch.gather(self._fine_force_n, 1, fine_three)], dim=1
        )
        mixing = self._mixing
        mixing.begin()
        for outer in range(effort.outer):
            free = u - self.rest.apply(self._elastic_force(u))
            outside = u.scatter(0, three, 0.0)
            contact = self._solve_contact(
                markers,
                region,
                torch.cat([gather(free), no_fine], dim=1),
                self._at_markers(markers, outside, markers.rest_m),
                lam,
                guess,
                effort.newton * (FIRST_STEPS if outer == 0 else 1),
            )
            guess, lam = contact.position_m, contact.nodal_force_n
            on_grid = lam[:, : region.node.shape[1]].permute(1, 2, 0).contiguous()
            load = torch.zeros_like(u).scatter_(0, three, on_grid)
            step = mixing.step(u, free + self.rest.apply(load) - u)
            largest = step.abs().amax(dim=(0, 1))
            u = u + step * (LARGEST_STEP_M / largest.clamp(min=1e-12)).clamp(max=1.0)
            if effort.tolerance_m > 0.0 and float(largest.max()) < effort.tolerance_m:
                break
        fine = lam[:, region.node.shape[1] :]
        self._fine_force_n = torch.zeros_like(self._fine_force_n).scatter_(1, fine_three, fine)
        if self._refinement is not None:
            self._added_m = self._refinement.added(region.fine_node, fine)
        return u, load, contact, largest

    def _solve_contact(
        self,
        markers: Markers,
        region: Region,
        free_m: torch.Tensor,
        base_m: torch.Tensor,
        force_n: torch.Tensor,
        guess_m: torch.Tensor,
        newton_steps: int,
    ) -> _Contact:
        """Return the contact of gels that are linear, a few gels at a time on a CPU."""
        parts = []
        for first in range(0, self.count, self._chunk):
            gels = slice(first, min(first + self._chunk, self.count))
            solver = self._solvers[gels.stop - gels.start]
            solver.set_problem(markers, region, gels)
            solver.solve(
                free_m=free_m[gels],
                base_m=base_m[gels],
                force_n=force_n[gels],
                guess_m=guess_m[gels],
                newton_steps=newton_steps,
                tolerance_m=0.5 * self.effort.tolerance_m,
            )
            parts.append(
                [
                    solver.force_n,
                    solver.marker_force_n.clone(),
                    solver.position_m.clone(),
                    solver.distance_m.clone(),
                    solver.slip_m.clone(),
                ]
            )
        return _Contact(*(torch.cat(part) for part in zip(*parts, strict=True)))

    def _finish(
        self,
        u: torch.Tensor,
        nodal: torch.Tensor,
        markers: Markers,
        contact: _Contact,
        left: torch.Tensor,
        touches: torch.Tensor,
        is_moving: torch.Tensor,
    ) -> None:
        """Remember a substep of the gels that moved; those that nothing touches are at rest."""
        u = torch.where(touches, u, 0.0)
        nodal = torch.where(touches, nodal, 0.0)
        force = torch.where(touches[:, None, None], contact.marker_force_n, 0.0)
        skin = self._skin(u)
        if self._refinement is not None:
            skin = skin + torch.where(touches[:, None, None], self._added_m, 0.0)
        three = markers.index[:, :, None].expand(-1, -1, 3)
        position = torch.gather(skin, 1, three)
        turn_back = markers.rotation.transpose(1, 2)[:, None]
        local = torch.matmul(turn_back, (skin - markers.origin_m[:, None])[..., None])[..., 0]
        slip = torch.zeros_like(skin).scatter_(1, three, contact.slip_m)
        gap = torch.full(skin.shape[:2], torch.inf, device=u.device)
        gap.scatter_(1, markers.index, contact.distance_m)
        moves = is_moving[:, None, None]
        keeps = self._is_touching & touches
        change = torch.where(keeps, u - self.displacement_m, 0.0)
        local_change = torch.where(keeps[:, None, None], local - self._local_m, 0.0)
        self._change_m = torch.where(is_moving, change, self._change_m)
        self._local_change_m = torch.where(moves, local_change, self._local_change_m)
        self._move_m = torch.where(
            is_moving[:, None], markers.origin_m - self._origin_m, self._move_m
        )
        self.displacement_m = torch.where(is_moving, u, self.displacement_m)
        self._nodal_force_n = torch.where(is_moving, nodal, self._nodal_force_n)
        self._skin_m = torch.where(moves, skin, self._skin_m)
        self._local_m = torch.where(moves, local, self._local_m)
        self._slip_m = torch.where(moves, slip, self._slip_m)
        self._gap_m = torch.where(is_moving[:, None], gap, self._gap_m)
        self._origin_m = torch.where(is_moving[:, None], markers.origin_m, self._origin_m)
        self._rotation = torch.where(moves, markers.rotation, self._rotation)
        self._force_n = torch.where(is_moving[:, None], -nodal.sum(dim=0).T, self._force_n)
        torque = -torch.linalg.cross(position, force).sum(dim=1)
        self._torque_nm = torch.where(is_moving[:, None], torque, self._torque_nm)
        deepest = torch.where(touches, (-contact.distance_m.amin(dim=1)).clamp(min=0.0), 0.0)
        self._penetration_m = torch.where(is_moving, deepest, self._penetration_m)
        self._left_m = torch.where(is_moving, torch.where(touches, left, 0.0), self._left_m)
        self._is_touching = torch.where(is_moving, touches, self._is_touching)


class _Refinement:
    """What a finer grid adds to the skin's compliance, on the device; see `Refinement`."""

    def __init__(self, table: Refinement, device: str) -> None:
        self.node_count, self._device = table.node_count, device
        weight = table.skin_weight
        self._skin_weight = _sparse(weight, device)
        node = np.zeros((weight.shape[0], 27), dtype=np.int32)
        value = np.zeros((weight.shape[0], 27), dtype=np.float32)
        length = np.diff(weight.indptr)
        row = np.repeat(np.arange(len(length)), length)
        column = np.arange(len(row)) - np.repeat(weight.indptr[:-1], length)
        node[row, column], value[row, column] = weight.indices, weight.data
        self.marker_node = torch.as_tensor(node, device=device)
        self.marker_weight = torch.as_tensor(value, device=device)
        self._table = [
            wp.array(table.indptr, dtype=wp.int32, device=device),
            wp.array(table.index, dtype=wp.int32, device=device),
            wp.array(table.block.astype(np.float32), dtype=wp.mat33, device=device),
        ]

    def between(self, node: torch.Tensor) -> torch.Tensor:
        """Return the added compliance (B, 3 F, 3 F) between nodes (B, F)."""
        b, count = node.shape
        number = torch.full((b, self.node_count), -1, dtype=torch.int32, device=self._device)
        every = torch.arange(count, dtype=torch.int32, device=self._device)
        number.scatter_(1, node, every.expand(b, -1))
        result = torch.zeros(b, 3 * count, 3 * count, device=self._device)
        wp.launch(
            kernels.gather_refinement,
            dim=(b, count),
            inputs=[
                wp.from_torch(node.to(torch.int32)),
                wp.from_torch(number),
                *self._table,
                wp.from_torch(result),
            ],
            device=self._device,
        )
        return result

    def added(self, node: torch.Tensor, force_n: torch.Tensor) -> torch.Tensor:
        """Return what is added to the skin's displacement (B, V, 3) under forces (B, F, 3)."""
        b = len(node)
        moved = torch.zeros(b, self.node_count, 3, device=self._device)
        wp.launch(
            kernels.refined_displacement,
            dim=tuple(node.shape),
            inputs=[
                wp.from_torch(node.to(torch.int32)),
                vectors(force_n.contiguous()),
                *self._table,
                vectors(moved),
            ],
            device=self._device,
        )
        flat = moved.permute(1, 2, 0).reshape(self.node_count, 3 * b)
        return (self._skin_weight @ flat).view(-1, 3, b).permute(2, 0, 1).contiguous()


def _chosen_nodes(
    node: torch.Tensor, weight: torch.Tensor, share: torch.Tensor, node_count: int, count: int
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the nodes (B, count) that have most of the weight of markers, of each by its share,
    the numbers of the markers' nodes among these (B, M, 27), -1 for others, and their weights."""
    b = len(node)
    flat = node.to(torch.int64).reshape(b, -1)
    score = torch.zeros(b, node_count, device=node.device)
    score.scatter_add_(1, flat, (share * weight.abs()).reshape(b, -1))
    chosen = torch.topk(score, count, dim=1).indices
    number = torch.full((b, node_count), -1, dtype=torch.int32, device=node.device)
    every = torch.arange(count, dtype=torch.int32, device=node.device)
    number.scatter_(1, chosen, every.expand(b, -1))
    local = torch.gather(number, 1, flat).view(node.shape)
    return chosen, local, torch.where(local >= 0, weight, 0.0)


@dataclass(frozen=True)
class _Contact:
    """Forces on the region's nodes (B, R, 3) and on the markers (B, M, 3); the markers' positions
    (B, M, 3), distance (B, M) and elastic slip (B, M, 3)."""

    nodal_force_n: torch.Tensor
    marker_force_n: torch.Tensor
    position_m: torch.Tensor
    distance_m: torch.Tensor
    slip_m: torch.Tensor


class _Mixing:
    """Anderson's mixing of a fixed-point iteration, for each gel by itself.

    It remembers how steps changed with points from one substep to the next: the gel's stiffness
    hardly changes between them.
    """

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
            # A step that grew has left the range where the history means something.
            grew = move.norm(dim=0) > 2.0 * move_before.norm(dim=0)
        self._last = here, move
        if not self._step_changes:
            return step
        step_changes = torch.stack(self._step_changes)
        gram = torch.einsum("mnb,knb->bmk", step_changes, step_changes)
        mean = gram.diagonal(dim1=1, dim2=2).mean(dim=1).clamp(min=1e-30)
        eye = torch.eye(gram.shape[1], device=gram.device)
        gram = gram + REGULARISATION * mean[:, None, None] * eye
        right = torch.einsum("mnb,nb->bm", step_changes, move)
        share = torch.linalg.solve(gram, right)
        share = torch.where(grew[:, None], 0.0, share)
        changes = torch.stack(self._point_changes) + step_changes
        return (move - torch.einsum("bm,mnb->nb", share, changes)).view(point.shape)


def _each(values: FloatArray | None, default: float, count: int, name: str) -> FloatArray:
    """Return one value for each gel.

    Raises:
        ValueError: another number of them.
    """
    result = np.full(count, default) if values is None else np.asarray(values, dtype=float)
    if result.shape != (count,):
        raise ValueError(f"{name} has the shape {result.shape}, expected ({count},)")
    return result


def _sparse(matrix: object, device: str) -> torch.Tensor:
    csr = matrix.tocsr()
    return torch.sparse_csr_tensor(
        torch.as_tensor(csr.indptr, dtype=torch.int64),
        torch.as_tensor(csr.indices, dtype=torch.int64),
        torch.as_tensor(csr.data, dtype=torch.float32),
        csr.shape,
        device=device,
    )


def _to_base(local_m: torch.Tensor, markers: Markers) -> torch.Tensor:
    turned = torch.matmul(markers.rotation[:, None], local_m[..., None])[..., 0]
    return markers.origin_m[:, None] + turned


def rotation_of(quaternion_xyzw: torch.Tensor) -> torch.Tensor:
    """Return the rotations (B, 3, 3) of quaternions (B, 4)."""
    x, y, z, w = (quaternion_xyzw / quaternion_xyzw.norm(dim=1, keepdim=True)).unbind(dim=1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)


def nearest_rotation(matrix: torch.Tensor) -> torch.Tensor:
    """Return the rotations (B, 3, 3) that are nearest to matrices, as those between two poses."""
    u, _, v = torch.linalg.svd(matrix)
    sign = torch.linalg.det(u @ v)
    u = torch.cat([u[:, :, :2], sign[:, None, None] * u[:, :, 2:]], dim=2)
    return u @ v
