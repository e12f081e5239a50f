# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Many gels of one sensor at equilibrium with their indenters, in one state with a batch axis.

Each substep is a fixed point of u = u + G (load(f) - r(u)): r are the elastic forces at
displacements u, G is the inverse of the stiffness at rest, and f the contact forces on the gel that
is linear around u (`contact`). Anderson's mixing makes it converge where the gel's stiffness is far
from that at rest. Nothing is factored, and no gel needs a matrix of its own but the compliance
between the markers around its contact.

The shape does not depend on Young's modulus: a gel that is stiffer by a factor has its forces
multiplied by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike

from dotsim_ros.gel.batched import kernels
from dotsim_ros.gel.batched.contact import Contact, Markers, matrices, solve_contact, vectors
from dotsim_ros.gel.batched.elastic import ElasticForces
from dotsim_ros.gel.batched.memory import TOGETHER, Grid, expect_room
from dotsim_ros.gel.batched.mixing import Mixing
from dotsim_ros.gel.batched.relaxation import Relaxation
from dotsim_ros.gel.batched.rest_compliance import RestCompliance, kept_blocks
from dotsim_ros.gel.batched.skin import Skin, rounded_up, stencils_of
from dotsim_ros.gel.bond import lost_stiffness
from dotsim_ros.gel.discretization import discretize
from dotsim_ros.gel.distance_field import indenter_field
from dotsim_ros.gel.implicit.contact import ONSET_M, contact_law
from dotsim_ros.gel.implicit.refinement import refine
from dotsim_ros.gel.implicit.rest_compliance import kept_compliance
from dotsim_ros.gel.make import body_of, bond_of, material_of, skin_of
from dotsim_ros.gel.material import small_strain_moduli_pa
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.warp_runtime import known_device, on_torch_stream, wp
from dotsim_ros.specification import SensorSpecification

LARGEST_MOVE_M = 0.6e-3
"""The indenter moves no farther in a substep, nor than twice its depth in the gel at rest..."""
TOUCH_SHARE = 0.05
"""...or than this share of the grid's spacing, if that is more."""
NEAR_M = 0.1e-3
"""Markers that are expected nearer to the indenter than this, and than what of its motion was not
expected, may touch in a substep."""
MISSED_M = 20.0e-6
"""Unless counts are fixed, a substep in which another marker goes deeper into the indenter is
solved again..."""
TRIALS = 3
"""...so often at most."""
LEVER_M = 3.0e-3
"""A turn of the indenter counts as a motion by this times its angle."""
LARGEST_STEP_M = 0.6e-3
"""No step moves a node farther."""
FAR_SLIDE_M = 0.1e-3
"""A marker that slides farther follows the indenter's surface, not a straight line."""
NEIGHBOURS = 4
NEIGHBOUR_M = 0.1e-3
"""Distance at which a neighbour's weight is half of that of one right here."""
MEMORY = 12
"""Steps that mixing remembers at most..."""
MEMORY_SHARE = 2
"""...and no more than those of so many substeps: older ones belong to another contact."""
INNER_SHARE = 0.05
"""Contact problems end at this share of the tolerance: another step of theirs costs little."""
FIRST_STEPS = 2
"""A substep's first contact problem takes so many times the Newton steps of the others."""
ADVANCES = 12
"""Steps along a way until the first touch."""
LEAST_FACTOR = 1.0e-6
"""Of Young's modulus: a gel without any has no shape."""
MOST_NODES = 384
"""With fixed counts, contact problems know so many nodes of a grid around the markers."""
_STATE = (
    "_u_m",
    "_u_change_m",
    "_marker_force_n",
    "_slip_m",
    "_skin_m",
    "_skin_change_m",
    "_local_m",
    "_local_change_m",
    "_gap_m",
    "_rest_gap_m",
    "_origin_m",
    "_move_m",
    "_quaternion",
    "_is_touching",
    "_is_placed",
    "_force_n",
    "_torque_nm",
    "_penetration_m",
    "_left_m",
)
"""Attributes of `BatchedGel` that hold a part for each gel."""


@dataclass(frozen=True)
class BatchState:
    """All gels after a step.

    Attributes:
        skin_position_m: (B, V, 3) base frame.
        force_n, torque_nm: (B, 3) of each gel on its indenter; torque about the base's origin.
        max_penetration_m: (B,) of a marker into the indenter.
        left_m: (B,) how far the last step of the iteration moved any node; infinite where a gel
            could not follow its indenter: it is left where it was.
    """

    skin_position_m: torch.Tensor
    force_n: torch.Tensor
    torque_nm: torch.Tensor
    max_penetration_m: torch.Tensor
    left_m: torch.Tensor


@dataclass(frozen=True)
class Effort:
    """What a substep may cost. With the default, a ball 1.5 mm in a pad of 4 mm and a cone or an
    edge 1.5 mm in a dome are within 6 um and 0.3 % of the force of the closely solved model; on the
    fine grid a ball and a cone to 3 mm within 6 um and 0.2 %.

    Attributes:
        outer: steps of the fixed point at most.
        newton: steps of each contact problem at most.
        tolerance_m: a gel that moves no farther is done: it is left out, and contact problems end
            early. 0 for fixed counts: the host then reads one number a frame, that of substeps.
        markers: that may touch an indenter with fixed counts, otherwise as many as do.
    """

    outer: int = 48
    newton: int = 8
    tolerance_m: float = 4.0e-6
    markers: int = 256


class BatchedGel:
    """B gels of one sensor.

    Args:
        specification: of the sensor; its camera has no part in it.
        indenters: one for all gels, or one for each.
        count: B.
        skin: whose vertices are the markers; None for the sensor's own.
        friction: (B,) coefficients; None for the sensor's.
        modulus_factor: (B,) each gel's Young's modulus over the sensor's; None for 1.
        effort: of a substep.
        grid: for `densetact2`, the fine one's table takes 0.5 GB (1.6 GB while it is computed for
            the first time, in a minute on one core), and a step some ten times as long.
        device: torch's name of the device.

    Attributes:
        device: the name that torch and Warp have for it.
        rest_position_m: (V, 3) of the skin's markers.
        field: Warp array (B,) of the indenters as kernels know them, `IndenterField`.

    Raises:
        ValueError: an argument of another length than B or that is not finite or too small, no such
            device, more gels than fit into its memory, or a gel with inertia.
    """

    def __init__(
        self,
        specification: SensorSpecification,
        indenters: Indenter | Sequence[Indenter],
        count: int,
        *,
        skin: SkinMesh | None = None,
        friction: ArrayLike | None = None,
        modulus_factor: ArrayLike | None = None,
        effort: Effort | None = None,
        grid: Grid = "default",
        device: str = "cpu",
    ) -> None:
        s = specification
        if s.solver.dynamic:
            raise ValueError("solver.dynamic is given; a batched gel has no inertia: leave it out")
        device, mesh = known_device(device), skin or skin_of(s.gel)
        expect_room(count, mesh.vertex_count, grid, device)
        own = s.contact.friction_coefficient
        self._friction = _each(friction, own, count, "friction", least=0.0)
        factor = _each(modulus_factor, 1.0, count, "modulus_factor", least=LEAST_FACTOR)
        self.count, self.device, self.effort = count, device, effort or Effort()
        material, body = material_of(s.material), body_of(s.gel)
        law = material.law
        is_fine = grid == "fine"
        spacing_m = s.solver.grid_spacing_m * (0.5 if is_fine else 1.0)
        d = discretize(body, mesh.rest_position_m, spacing_m)
        self._spacing_m = d.spacing_m
        bond = bond_of(s.gel)
        lost_bond = None if bond is None else lost_stiffness(body, d, bond, law)
        self._elastic = ElasticForces(d, law, count, device, lost_bond=lost_bond)
        self._relaxation = None
        if material.prony.shares:
            self._relaxation = Relaxation(material.prony, self._elastic, count)
        skin_m = mesh.rest_position_m
        self._rest = RestCompliance(d, kept_blocks(body, skin_m, d, law), device)
        fine = None
        if s.solver.refined and not is_fine:
            table = refine(body, skin_m, d, lambda: kept_compliance(body, skin_m, d, law), law)
            fine = stencils_of(table.skin_weight, device), table
        self._rest_m = torch.as_tensor(mesh.rest_position_m, dtype=torch.float32, device=device)
        self._all_at_rest_m = self._rest_m.expand(count, -1, 3).contiguous()
        weights = d.skin_interpolation.matrix(d.node_count)
        self._skin = Skin(self._rest_m, stencils_of(weights, device), self._rest, fine)
        self._area_m2 = torch.as_tensor(mesh.rest_area_m2, dtype=torch.float32, device=device)
        self._on_base = torch.as_tensor(mesh.on_base, device=device)
        self._node_count = d.node_count
        self._reach_m = float(np.ptp(mesh.rest_position_m, axis=0).max())
        self.rest_position_m = mesh.rest_position_m.astype(np.float32)
        self._youngs_pa, _ = small_strain_moduli_pa(law)
        self._contact_specification = s.contact
        self._factor = torch.as_tensor(factor, dtype=torch.float32, device=device)[:, None]
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
        # The device's copy points to the arrays of these.
        self._known_fields = known
        self.field: Any = wp.array(fields, dtype=kernels.IndenterField, device=self.device)
        laws = [
            contact_law(
                kernels.ContactLaw,
                replace(self._contact_specification, friction_coefficient=friction),
                self._youngs_pa,
            )
            for friction in self._friction.tolist()
        ]
        self._contact_law: Any = wp.array(laws, dtype=kernels.ContactLaw, device=self.device)
        self.reset()

    def reset(self, gels: torch.Tensor | None = None) -> None:
        """Return gels to rest, with their indenters away.

        Args:
            gels: (B,) bool, which; None for all.
        """
        before = {} if gels is None else {name: getattr(self, name) for name in _STATE}
        b, n, v = self.count, self._node_count, len(self._rest_m)

        def zeros(*shape: int) -> torch.Tensor:
            return torch.zeros(*shape, device=self.device)

        if self._relaxation is not None:
            every = torch.ones(b, dtype=torch.bool, device=self.device)
            self._relaxation.reset(every if gels is None else gels)
        self._u_m, self._u_change_m = zeros(n, 3, b), zeros(n, 3, b)
        self._marker_force_n, self._slip_m = zeros(b, v, 3), zeros(b, v, 3)
        self._skin_m = self._all_at_rest_m.clone()
        self._skin_change_m = zeros(b, v, 3)
        self._local_m, self._local_change_m = zeros(b, v, 3), zeros(b, v, 3)
        self._gap_m = torch.full((b, v), torch.inf, device=self.device)
        self._rest_gap_m = torch.full((b,), torch.inf, device=self.device)
        self._origin_m, self._move_m = zeros(b, 3), zeros(b, 3)
        self._quaternion = zeros(b, 4)
        self._is_touching = torch.zeros(b, dtype=torch.bool, device=self.device)
        self._is_placed = torch.zeros(b, dtype=torch.bool, device=self.device)
        self._force_n, self._torque_nm = zeros(b, 3), zeros(b, 3)
        self._penetration_m, self._left_m = zeros(b), zeros(b)
        if gels is None:
            memory = min(MEMORY_SHARE * self.effort.outer, MEMORY)
            self._mixing = Mixing(b, 3 * n, memory, self.device)
            self._given: tuple[torch.Tensor, ...] | None = None
            self._graph: Any = None
            return
        self._mixing.forget(gels)
        for name, value in before.items():
            rest = getattr(self, name)
            value.copy_(torch.where(_mask(name, gels, rest), rest, value))
            setattr(self, name, value)

    @on_torch_stream
    def step(
        self, position_m: FloatArray, quaternion_xyzw: FloatArray, dt_s: float = 0.04
    ) -> BatchState:
        """Move each indenter to its pose on a straight way and find the gels.

        Args:
            position_m: (B, 3) base frame.
            quaternion_xyzw: (B, 4).
            dt_s: duration; without relaxation it does not matter.
        """
        target = torch.as_tensor(position_m, dtype=torch.float32, device=self.device)
        quaternion = torch.as_tensor(quaternion_xyzw, dtype=torch.float32, device=self.device)
        quaternion = torch.nn.functional.normalize(quaternion, dim=1)
        turn = rotation_of(quaternion)
        is_new = ~self._is_placed[:, None]
        start = torch.where(is_new, target + self._reach_m * turn[:, :, 2], self._origin_m)
        start_quaternion = torch.where(is_new, quaternion, self._quaternion)
        start_turn = rotation_of(start_quaternion)
        self._origin_m.copy_(start)
        self._quaternion.copy_(start_quaternion)
        self._is_placed.fill_(True)
        # A turn moves the skin as well.
        way = (target - start).norm(dim=1) + LEVER_M * angle_between(start_turn, turn)
        # From the air, only the way after the first touch counts.
        touch = self._touch_share(start, target, turn)
        depth = torch.where(self._is_touching, -self._rest_gap_m, 0.0)
        longest = (2.0 * depth).clamp(TOUCH_SHARE * self._spacing_m, LARGEST_MOVE_M)
        moves = (way * (1.0 - touch) / longest).ceil().clamp(min=1.0)
        if not self._may_stop or int(moves.max()) > 1:
            # A gel that nothing touches in the end is at rest, whatever the way, if it does not
            # relax.
            matters = self._rest_gap(target, turn, self._is_placed) < ONSET_M
            if self._relaxation is not None:
                matters = matters | self._is_touching
            moves = torch.where(matters, moves, 1.0)
        for number in range(1, int(moves.max()) + 1):
            if self._relaxation is not None:
                self._relaxation.begin(dt_s / moves)
            share = (touch + (1.0 - touch) * number / moves).clamp(max=1.0)
            is_last = (number >= moves)[:, None]
            self._advance(
                torch.where(is_last, target, start + share[:, None] * (target - start)),
                torch.where(is_last, quaternion, between(start_quaternion, quaternion, share)),
                number <= moves,
            )
        return BatchState(
            self._skin_m.clone(),
            self._factor * self._force_n,
            self._factor * self._torque_nm,
            self._penetration_m.clone(),
            self._left_m.clone(),
        )

    def _advance(self, *given: torch.Tensor) -> None:
        """Make a substep; on a GPU with fixed counts the second one after a reset is recorded, and
        replayed from then on: nothing in it reads a value or depends on one but by its kernels."""
        # What relaxation remembers has other memory in each substep.
        if self.device == "cpu" or self._may_stop or self._relaxation is not None:
            self._substep(*given)
        elif self._given is None:
            # What is done for the first time, such as to load kernels, cannot be recorded.
            self._substep(*given)
            self._given = tuple(value.clone() for value in given)
        else:
            for kept, value in zip(self._given, given, strict=True):
                kept.copy_(value)
            if self._graph is None:
                self._graph = torch.cuda.CUDAGraph()
                stream = torch.cuda.Stream(self.device)
                with torch.cuda.device(self.device), torch.cuda.graph(self._graph, stream=stream):
                    self._recorded_substep(*self._given)
            self._graph.replay()

    @on_torch_stream
    def _recorded_substep(self, *given: torch.Tensor) -> None:
        self._substep(*given)

    def _touch_share(
        self, start_m: torch.Tensor, end_m: torch.Tensor, rotation: torch.Tensor
    ) -> torch.Tensor:
        """Return the share (B,) of a straight way before which no indenter touches the gel at rest;
        0 where one does already. Its distance is a way that touches nothing."""
        share = torch.zeros(self.count, device=self.device)
        if self._may_stop and bool(self._is_touching.all()):
            return share
        way = (end_m - start_m).norm(dim=1).clamp(min=1e-12)
        goes_on = ~self._is_touching
        for _ in range(ADVANCES):
            origin = start_m + share[:, None] * (end_m - start_m)
            clear = (self._rest_gap(origin, rotation, goes_on) - ONSET_M).clamp(min=0.0)
            share = torch.where(goes_on, (share + clear / way).clamp(max=1.0), share)
            goes_on = goes_on & (clear > 0.0) & (share < 1.0)
        return torch.where(self._is_touching, 0.0, share)

    @property
    def _may_stop(self) -> bool:
        """Whether values are read to end early; else every count is fixed."""
        return self.effort.tolerance_m > 0.0

    def _distance(
        self, position_m: torch.Tensor, origin_m: torch.Tensor, rotation: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the signed distances (B, n) of points (B, n, 3) from the indenters and their
        gradients (B, n, 3)."""
        distance = torch.empty(position_m.shape[:2], device=self.device)
        normal = torch.empty_like(position_m)
        wp.launch(
            kernels.surface,
            dim=tuple(distance.shape),
            inputs=[
                vectors(position_m),
                self.field,
                matrices(rotation.contiguous()),
                vectors(origin_m.contiguous()),
                wp.from_torch(distance),
                vectors(normal),
            ],
            device=self.device,
        )
        return distance, normal

    def _skin_distance(
        self,
        skin_m: torch.Tensor,
        origin_m: torch.Tensor,
        rotation: torch.Tensor,
        is_wanted: torch.Tensor,
    ) -> torch.Tensor:
        """Return the signed distances (B, V) of the skin (B, V, 3); infinite on the base, and of
        gels (B,) that are not wanted."""
        distance = torch.empty(skin_m.shape[:2], device=self.device)
        wp.launch(
            kernels.skin_distance,
            dim=tuple(distance.shape),
            inputs=[
                vectors(skin_m),
                wp.from_torch(is_wanted),
                wp.from_torch(self._on_base),
                self.field,
                matrices(rotation.contiguous()),
                vectors(origin_m.contiguous()),
                wp.from_torch(distance),
            ],
            device=self.device,
        )
        return distance

    def _rest_gap(
        self, origin_m: torch.Tensor, rotation: torch.Tensor, is_wanted: torch.Tensor
    ) -> torch.Tensor:
        """Return the distances (B,) of indenters at poses (B, 3), (B, 3, 3) from a gel at rest;
        infinite of those that are not wanted (B,)."""
        return self._skin_distance(self._all_at_rest_m, origin_m, rotation, is_wanted).amin(dim=1)

    def _substep(
        self, origin_m: torch.Tensor, quaternion: torch.Tensor, is_moving: torch.Tensor
    ) -> None:
        """Advance the gels that move to new poses (B, 3), (B, 4) of their indenters."""
        rotation = rotation_of(quaternion)
        rest_gap = self._rest_gap(origin_m, rotation, is_moving)
        touches = rest_gap < ONSET_M
        begins = touches & ~self._is_touching
        if not self._may_stop or bool(begins.any()):
            here = _to_local(self._skin_m, origin_m, rotation)
            self._local_m.copy_(torch.where(begins[:, None, None], here, self._local_m))
        share = self._share_of_last_move(origin_m, begins)
        in_contact = touches[:, None, None]
        # A gel that relaxes goes on moving when nothing touches it any more.
        is_loaded = touches if self._relaxation is None else torch.ones_like(touches)
        move = origin_m - self._origin_m
        unexpected_m = (move - share[:, None] * self._move_m).norm(dim=1)
        near_m = NEAR_M + torch.where(self._is_touching, unexpected_m, 0.0)
        for _ in range(TRIALS):
            markers, needed = self._markers(origin_m, rotation, share, near_m, is_moving)
            u, contact, left = self._equilibrium(
                self._u_m + share * self._u_change_m,
                markers,
                needed,
                torch.where(in_contact, self._guess(markers, share), markers.gather(self._skin_m)),
                is_loaded & is_moving,
            )
            force = torch.where(in_contact, contact.force_n, 0.0)
            u, left = torch.where(is_loaded, u, 0.0), torch.where(is_loaded, left, 0.0)
            skin = self._skin.positions(u, markers.index, force)
            gap = self._skin_distance(skin, origin_m, rotation, is_moving)
            others = gap.scatter(1, markers.index, torch.inf).amin(dim=1)
            missed = touches & is_moving & (others < -MISSED_M)
            if not self._may_stop or not bool(missed.any()):
                break
            near_m = near_m + torch.where(missed, near_m - others, 0.0)
        pose = origin_m, quaternion
        self._finish(u, skin, gap, force, markers, contact, left, rest_gap, is_moving, pose)

    def _share_of_last_move(self, origin_m: torch.Tensor, begins: torch.Tensor) -> torch.Tensor:
        """Return how much of the last substep's motion this one repeats (B,)."""
        length = self._move_m.square().sum(dim=1)
        along = ((origin_m - self._origin_m) * self._move_m).sum(dim=1)
        share = (along / length.clamp(min=1e-18)).clamp(-1.0, 2.0)
        return torch.where(begins | ~self._is_touching, 0.0, share)

    def _markers(
        self,
        origin_m: torch.Tensor,
        rotation: torch.Tensor,
        share: torch.Tensor,
        near_m: torch.Tensor,
        is_moving: torch.Tensor,
    ) -> tuple[Markers, torch.Tensor]:
        """Return the markers that are expected nearest to the indenters, the nearest first, and how
        many of them each gel needs (B,): those nearer than (B,), unless counts are fixed."""
        expected = self._skin_m + share[:, None, None] * self._skin_change_m
        distance = self._skin_distance(expected, origin_m, rotation, is_moving)
        every = torch.arange(self.count, dtype=torch.int32, device=self.device)
        count = min(self.effort.markers, distance.shape[1])
        needed = torch.full_like(every, count)
        if self._may_stop:
            needed = (distance < near_m[:, None]).sum(dim=1)
            count = rounded_up(int(needed.max()), distance.shape[1])
        index = torch.topk(distance, count, dim=1, largest=False).indices
        three = index[:, :, None].expand(-1, -1, 3)
        markers = Markers(
            index,
            self._area_m2[index],
            torch.gather(self._local_m, 1, three),
            torch.gather(self._slip_m, 1, three),
            every,
            every,
            rotation.contiguous(),
            origin_m.contiguous(),
            self.field,
            self._contact_law,
        )
        return markers, needed

    def _guess(self, markers: Markers, share: torch.Tensor) -> torch.Tensor:
        """Return where the markers may come to lie (B, K, 3): they keep their motion in the
        indenter's frame."""
        slide = share[:, None, None] * markers.gather(self._local_change_m)
        local = markers.start_position_m + slide
        guess = _to_base(local, markers.origin_m, markers.rotation)
        is_far = slide.norm(dim=2) > FAR_SLIDE_M
        if self._may_stop and not bool(is_far.any()):
            return guess
        # It is as deep as those were that it meets there.
        before = torch.gather(self._gap_m, 1, markers.index)
        apart = torch.cdist(local, markers.start_position_m).square()
        apart = torch.where(before[:, None, :].isinf(), 1.0, apart)
        near, number = torch.topk(apart, min(NEIGHBOURS, apart.shape[2]), dim=2, largest=False)
        weight = 1.0 / (near + NEIGHBOUR_M**2)
        depth = torch.gather(before[:, None, :].expand(-1, guess.shape[1], -1), 2, number)
        known = (weight * depth.nan_to_num(posinf=0.0)).sum(dim=2) / weight.sum(dim=2)
        now, normal = self._distance(guess, markers.origin_m, markers.rotation)
        moved = guess + (known - now)[:, :, None] * torch.nn.functional.normalize(normal, dim=2)
        return torch.where(is_far[:, :, None], moved, guess)

    def _equilibrium(
        self,
        u_m: torch.Tensor,
        markers: Markers,
        needed: torch.Tensor,
        guess_m: torch.Tensor,
        is_solved: torch.Tensor,
    ) -> tuple[torch.Tensor, Contact, torch.Tensor]:
        """Return displacements (N, 3, B), the contact, and how far the last step moved any node
        (B,).

        Args:
            u_m: (N, 3, B) to begin with.
            markers: that may touch.
            needed: (B,) how many of them.
            guess_m: (B, K, 3) where the markers may come to lie.
            is_solved: (B,) of which gels; with fixed counts, of all.
        """
        effort = self.effort
        whole = _untouched(guess_m)
        left = torch.zeros(self.count, device=self.device)
        gels = torch.arange(self.count, device=self.device)
        if self._may_stop:
            # Gels with about as many markers are solved together.
            gels = is_solved.nonzero()[:, 0]
            gels = gels[needed[gels].argsort(stable=True)]
        parts = self._parts(markers, needed, gels)
        result, u, force, guess = u_m.clone(), u_m, markers.gather(self._marker_force_n), guess_m
        u, force, guess = u[:, :, gels], force[gels], guess[gels]
        self._mixing.begin()
        if self._may_stop:
            self._mixing.keep(gels)
        is_done = torch.zeros_like(gels, dtype=torch.bool)
        for outer in range(effort.outer if len(gels) else 0):
            index = markers.index[gels]
            free = u - self._rest.apply(self._elastic(u, gels))
            base = self._skin.markers_at(index, free)
            steps = effort.newton * (FIRST_STEPS if outer == 0 else 1)
            contact = self._solve_contact(parts, base, force, guess, steps)
            force, guess = contact.force_n, contact.position_m
            plain = free + self._rest.apply(self._skin.load(index, force)) - u
            step = self._mixing.step(u, plain)
            largest = step.abs().amax(dim=(0, 1))
            short = (LARGEST_STEP_M / largest.clamp(min=1e-12)).clamp(max=1.0)
            # Rounding would drive a gel away that goes on after its end.
            u = u + torch.where(is_done, 0.0, short * step)
            # Mixing may take a short step where the iteration is not at its end.
            largest = torch.maximum(largest, plain.abs().amax(dim=(0, 1)))
            is_done = is_done | (largest < effort.tolerance_m)
            some_end = self._may_stop and bool(is_done.any())
            if some_end or outer == effort.outer - 1:
                result[:, :, gels], left[gels] = u, largest
                for name in Contact.__dataclass_fields__:
                    getattr(whole, name)[gels] = getattr(contact, name)
            if some_end:
                number = (~is_done).nonzero()[:, 0]
                if not len(number):
                    break
                parts = _kept_parts(parts, ~is_done)
                gels, is_done = gels[number], is_done[number]
                u, force, guess = u[:, :, number], force[number], guess[number]
                self._mixing.keep(number)
        return result, whole, left

    def _parts(
        self, markers: Markers, needed: torch.Tensor, gels: torch.Tensor
    ) -> list[tuple[Markers, torch.Tensor]]:
        """Return the markers of gels that are solved together, with their compliances."""
        parts = []
        together = TOGETHER[torch.device(self.device).type]
        for some in gels.split(together) if len(gels) else ():
            count = markers.index.shape[1]
            if self._may_stop:
                count = rounded_up(int(needed[some].max()), count)
            part = replace(markers.part(some, count), place=markers.place[: len(some)])
            node_limit = None if self._may_stop else MOST_NODES
            parts.append((part, self._skin.compliance(part.index, node_limit)))
        return parts

    def _solve_contact(
        self,
        parts: Sequence[tuple[Markers, torch.Tensor]],
        base_m: torch.Tensor,
        force_n: torch.Tensor,
        guess_m: torch.Tensor,
        newton_steps: int,
    ) -> Contact:
        """Return the contact of gels that are linear, part by part."""
        whole = _untouched(guess_m)
        first = 0
        for markers, compliance in parts:
            length, count = markers.index.shape
            here = slice(first, first + length), slice(count)
            part = solve_contact(
                markers,
                compliance,
                base_m=base_m[here],
                force_n=force_n[here],
                guess_m=guess_m[here],
                newton_steps=newton_steps,
                tolerance_m=INNER_SHARE * self.effort.tolerance_m,
            )
            for name in Contact.__dataclass_fields__:
                getattr(whole, name)[here] = getattr(part, name)
            first += length
        return whole

    def _finish(
        self,
        u: torch.Tensor,
        skin: torch.Tensor,
        gap: torch.Tensor,
        force: torch.Tensor,
        markers: Markers,
        contact: Contact,
        left_m: torch.Tensor,
        rest_gap_m: torch.Tensor,
        is_moving: torch.Tensor,
        pose: tuple[torch.Tensor, torch.Tensor],
    ) -> None:
        """Remember a substep of the gels that moved; those that nothing touches are at rest, those
        that diverged stay as they were."""
        three = markers.index[:, :, None].expand(-1, -1, 3)
        zeros = torch.zeros_like(self._skin_m)
        touches = rest_gap_m < ONSET_M
        in_contact = touches[:, None, None]
        torque = torch.linalg.cross(markers.gather(skin), force).sum(dim=1)
        deepest = (-gap.amin(dim=1)).clamp(min=0.0)
        # A gel that comes into contact or leaves it has no motion to go on with.
        keeps = self._is_touching & touches
        new = {
            "_u_change_m": torch.where(keeps, u - self._u_m, 0.0),
            "_move_m": pose[0] - self._origin_m,
            "_u_m": u,
            "_marker_force_n": zeros.scatter(1, three, force),
            "_slip_m": torch.where(in_contact, zeros.scatter(1, three, contact.slip_m), 0.0),
            "_gap_m": gap,
            "_rest_gap_m": rest_gap_m,
            "_origin_m": pose[0],
            "_quaternion": pose[1],
            "_force_n": -force.sum(dim=1),
            "_torque_nm": -torque,
            "_penetration_m": torch.where(touches, deepest, 0.0),
            "_left_m": left_m,
            "_is_touching": touches,
        }
        is_finite = u.isfinite().all(dim=1).all(dim=0) & skin.isfinite().all(dim=2).all(dim=1)
        diverged, is_moving = is_moving & ~is_finite, is_moving & is_finite
        if self._relaxation is not None:
            self._relaxation.finish(u, is_moving)
        wp.launch(
            kernels.remember_skin,
            dim=tuple(gap.shape),
            inputs=[
                vectors(skin),
                wp.from_torch(is_moving),
                wp.from_torch(keeps),
                matrices(markers.rotation),
                vectors(markers.origin_m),
                vectors(self._skin_m),
                vectors(self._skin_change_m),
                vectors(self._local_m),
                vectors(self._local_change_m),
            ],
            device=self.device,
        )
        if not self._may_stop or not bool(is_moving.all()):
            for name, value in new.items():
                before = getattr(self, name)
                new[name] = torch.where(_mask(name, is_moving, before), value, before)
        # A graph knows the memory that the state has.
        for name, value in new.items():
            getattr(self, name).copy_(value)
        self._left_m.masked_fill_(diverged, torch.inf)


def _untouched(position_m: torch.Tensor) -> Contact:
    """Return the contact of markers at (B, K, 3) that nothing touches."""
    return Contact(
        torch.zeros_like(position_m),
        position_m.clone(),
        position_m.new_full(position_m.shape[:2], torch.inf),
        torch.zeros_like(position_m),
    )


def _kept_parts(
    parts: Sequence[tuple[Markers, torch.Tensor]], is_kept: torch.Tensor
) -> list[tuple[Markers, torch.Tensor]]:
    """Return the parts with only those gels that are kept (b,)."""
    kept = []
    each = is_kept.split([len(markers.index) for markers, _ in parts])
    for (markers, compliance), keep in zip(parts, each, strict=True):
        number = keep.nonzero()[:, 0]
        if len(number) == len(keep):
            kept.append((markers, compliance))
        elif len(number):
            kept.append((markers.part(number, markers.index.shape[1]), compliance))
    return kept


def _mask(name: str, gels: torch.Tensor, like: torch.Tensor) -> torch.Tensor:
    """Return a mask (B,) of gels with as many axes as a part of the state."""
    # The grid's arrays have the gels last.
    return gels if name.startswith("_u") else gels.view(-1, *(1,) * (like.dim() - 1))


def _each(
    values: ArrayLike | None, default: float, count: int, name: str, *, least: float
) -> FloatArray:
    """Return one value for each gel.

    Raises:
        ValueError: another number of them, or one that is not finite or too small.
    """
    result = np.full(count, default) if values is None else np.asarray(values, dtype=float)
    if result.shape != (count,):
        raise ValueError(f"{name} has the shape {result.shape}, expected ({count},)")
    if len(bad := result[~(np.isfinite(result) & (result >= least))]):
        raise ValueError(f"{name} holds {bad[0]}, expected finite numbers from {least:g} on")
    return result


def _to_base(local_m: torch.Tensor, origin_m: torch.Tensor, rotation: torch.Tensor) -> torch.Tensor:
    """Return points (B, n, 3) of the indenters' frames in the base frame."""
    return origin_m[:, None] + torch.bmm(local_m, rotation.transpose(1, 2))


def _to_local(
    position_m: torch.Tensor, origin_m: torch.Tensor, rotation: torch.Tensor
) -> torch.Tensor:
    """Return points (B, n, 3) of the base frame in the indenters' frames."""
    return torch.bmm(position_m - origin_m[:, None], rotation)


def rotation_of(quaternion_xyzw: torch.Tensor) -> torch.Tensor:
    """Return the rotations (B, 3, 3) of quaternions (B, 4)."""
    x, y, z, w = (quaternion_xyzw / quaternion_xyzw.norm(dim=1, keepdim=True)).unbind(dim=1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)


def angle_between(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Return the angles (B,) between rotations (B, 3, 3), rad."""
    trace = (first * second).sum(dim=(1, 2))
    return ((trace - 1.0) / 2.0).clamp(-1.0, 1.0).arccos()


def between(start: torch.Tensor, end: torch.Tensor, share: torch.Tensor) -> torch.Tensor:
    """Return the quaternions (B, 4) at shares (B,) of the shorter turns between unit ones."""
    is_opposite = (start * end).sum(dim=1, keepdim=True) < 0.0
    end = torch.where(is_opposite, -end, end)
    return torch.nn.functional.normalize(start + share[:, None] * (end - start), dim=1)
