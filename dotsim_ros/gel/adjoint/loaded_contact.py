# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The contact at the end of a substep as the adjoint sees it, and the adjoint's linear solve."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dotsim_ros.gel.adjoint.differentiable_contact import MarkerContact
from dotsim_ros.gel.adjoint.equilibrium import (
    EXACT,
    EquilibriumLinearisation,
    contact_on_nodes,
    contact_response_matrix,
    fine_part,
)
from dotsim_ros.gel.adjoint.gradient import LossGradient
from dotsim_ros.gel.adjoint.recorder import ContactRecord, Substep
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.implicit.refinement import Refinement
from dotsim_ros.io.arrays import FloatArray, IndexArray

TURNS = 40
TURN_TOLERANCE = 1.0e-5
"""What follows from the gel's turns is found step by step, to this share of it."""
TURNING_STEP_M = 1.0e-5
"""Of the differences by which it varies."""


class LoadedContact:
    """The contact at the end of a substep, its derivatives, and the adjoint's solve with them."""

    def __init__(
        self,
        gel: ImplicitGel,
        substep: Substep,
        record: ContactRecord | None,
        loss: LossGradient,
        by_memory: FloatArray,
    ) -> None:
        self.gel, self.loss, self.displacement_m = gel, loss, substep.displacement_m
        self.turn = None if gel.turning is None else gel.turning.exactly_at(self.displacement_m)
        self.marker = np.zeros(0, dtype=np.int32)
        self.marker_contact: MarkerContact | None = None
        self.by_slip = np.zeros((0, 3))
        if record is None or len(record.marker) == 0:
            return
        self.marker = record.marker
        self.position_m = substep.skin_position_m[record.marker]
        self.marker_contact = MarkerContact(
            gel.contact,
            record.area_m2,
            self.position_m,
            record.pose,
            record.memory_m,
        )
        self.by_slip = by_memory[record.marker]

    def add_to(self, by_skin: FloatArray) -> FloatArray:
        """Add the derivatives by the markers' positions through the torque and the slip."""
        if self.marker_contact is None:
            return by_skin
        force = self.marker_contact.force_n
        adjoint = self.marker_contact.adjoint(np.zeros_like(force), self.by_slip)
        result = by_skin.copy()
        result[self.marker] += adjoint.position - np.cross(force, self.loss.torque)
        return result

    def solve(
        self, forces: Callable[[FloatArray], FloatArray], by_node: FloatArray, by_skin: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the virtual displacement (N, 3), and the derivatives by the forces (A, 3) and by
        the positions of the skin (V, 3) once all follows from equilibrium."""
        gel = self.gel
        right = by_node + gel.skin_weight.T @ by_skin
        rest = gel.compliance_at_rest
        if self.marker_contact is None:
            nowhere = np.zeros(0, dtype=np.int32), np.zeros((0, 0))
            linear = EquilibriumLinearisation(forces, self.displacement_m, rest, *nowhere)
            return linear.solve(right.ravel(), EXACT).reshape(-1, 3), np.zeros((0, 3)), by_skin
        own = self.marker_contact.stiffness()
        fine = None
        if gel.refinement is not None and self.turn is not None:
            fine = fine_part(gel.refinement, self.marker)
            fine = fine.turned(self.turn[fine.node])
        response = contact_response_matrix(own, fine, np.arange(len(own)))
        weight = gel.skin_weight[self.marker]
        node = np.unique(weight.indices).astype(np.int32)
        by_force = -self.loss.force - np.cross(self.loss.torque, self.position_m)
        if gel.refinement is not None:
            by_force = by_force + self.added_displacement_adjoint(by_skin)
        # With phi = (1 - B H^T)^-1 (by_force + S lambda): H^T phi = response^T (...)
        pulled = (response.T @ by_force.ravel()).reshape(-1, 3)
        right = right + weight.T @ pulled
        loaded = contact_on_nodes(response, weight, node)
        linear = EquilibriumLinearisation(forces, self.displacement_m, rest, node, loaded.T)
        by_turn = self._by_turn(by_skin) if fine is not None else np.zeros_like(right)
        # What follows from the turns of the gel, by nodes and by forces, from one to the next.
        for_node, for_force = by_turn, np.zeros_like(by_force)
        for _ in range(TURNS):
            total = by_force + for_force
            pulled = (response.T @ for_force.ravel()).reshape(-1, 3)
            given = right + for_node + weight.T @ pulled
            virtual = linear.solve(given.ravel(), EXACT).reshape(-1, 3)
            total = total + weight @ virtual
            pulled = (response.T @ total.ravel()).reshape(-1, 3)
            if fine is None:
                break
            on_skin = np.zeros_like(by_skin)
            on_skin[self.marker] = pulled
            by_node, for_force = self._turned_by(virtual)
            before, for_node = for_node, by_turn + self._by_turn(on_skin) + by_node
            if np.abs(for_node - before).max() <= TURN_TOLERANCE * np.abs(for_node).max():
                break
        by_position = by_skin.copy()
        by_position[self.marker] += pulled
        if fine is not None:
            total = total + fine.displacement(pulled)
        return virtual, total, by_position

    def _by_turn(self, by_position: FloatArray) -> FloatArray:
        """Return the derivatives (N, 3) by the displacements through the turns of the gel, from
        those by the skin's positions (V, 3)."""
        refinement, load = self.gel.refinement, self._load()
        assert refinement is not None
        given = refinement.skin_weight.T @ by_position
        if not given.any():
            return np.zeros_like(self.displacement_m)
        scale = np.linalg.norm(load) / np.linalg.norm(given)
        # The resistance is a quadratic form of the loads.
        above, below = (
            self.resistance(refinement, load + sign * scale * given) for sign in (1.0, -1.0)
        )
        result: FloatArray = (above - below) / (2.0 * scale)
        return result

    def _turned_by(self, virtual_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how the resistance (N, 3) to turning, and what the refinement adds to the markers
        in contact (A, 3), vary along virtual displacements (N, 3)."""
        refinement, turning, load = self.gel.refinement, self.gel.turning, self._load()
        assert refinement is not None
        assert turning is not None
        loaded = _loaded(load)
        step = TURNING_STEP_M / max(np.abs(virtual_m).max(), np.finfo(float).tiny)
        found = []
        for sign in (1.0, -1.0):
            at_m = self.displacement_m + sign * step * virtual_m
            added = refinement.displacement(loaded, load[loaded], turning.exactly_at(at_m))
            on_marker = refinement.skin_weight[self.marker] @ added
            found.append((self.resistance(refinement, load, at_m), on_marker))
        (node, marker), (node_before, marker_before) = found
        return (node - node_before) / (2.0 * step), (marker - marker_before) / (2.0 * step)

    def _load(self) -> FloatArray:
        """Return the forces (F, 3) on the refinement's nodes."""
        assert self.gel.refinement is not None
        assert self.marker_contact is not None
        load: FloatArray = (
            self.gel.refinement.skin_weight[self.marker].T @ self.marker_contact.force_n
        )
        return load

    def resistance(
        self,
        refinement: Refinement,
        load_n: FloatArray | None = None,
        at_m: FloatArray | None = None,
    ) -> FloatArray:
        """Return the forces (N, 3) by which a refinement resists to be turned: under the contact's
        own or other forces (F, 3) on its nodes, at the own or other displacements (N, 3)."""
        assert self.gel.turning is not None
        load = self._load() if load_n is None else load_n
        node = _loaded(load)
        return self.gel.turning.resistance(
            self.displacement_m if at_m is None else at_m,
            node,
            load[node],
            lambda force_n: refinement.displacement(node, force_n)[node],
        )

    def added_displacement(self, refinement: Refinement, force_n: FloatArray) -> FloatArray:
        """Return B f (V, 3), a refinement's displacement of the skin under forces (A, 3)."""
        nodal = refinement.skin_weight[self.marker].T @ force_n
        loaded = _loaded(nodal)
        moved: FloatArray = refinement.skin_weight @ refinement.displacement(
            loaded, nodal[loaded], self.turn
        )
        return moved

    def added_displacement_adjoint(self, by_skin: FloatArray) -> FloatArray:
        """Return B^T (A, 3) of derivatives (V, 3) by the skin."""
        refinement = self.gel.refinement
        assert refinement is not None
        nodal = refinement.skin_weight.T @ by_skin
        loaded = _loaded(nodal)
        added = refinement.displacement(loaded, nodal[loaded], self.turn)
        result: FloatArray = refinement.skin_weight[self.marker] @ added
        return result


def _loaded(force_n: FloatArray) -> IndexArray:
    """Return the nodes (n,) under forces (F, 3)."""
    return np.flatnonzero(np.any(force_n, axis=1)).astype(np.int32)
