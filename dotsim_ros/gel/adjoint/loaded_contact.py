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
from dotsim_ros.io.arrays import FloatArray


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
        fine = None if gel.refinement is None else fine_part(gel.refinement, self.marker)
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
        virtual = linear.solve(right.ravel(), EXACT).reshape(-1, 3)
        total = by_force + weight @ virtual
        pulled = (response.T @ total.ravel()).reshape(-1, 3)
        if fine is not None:
            total = total + fine.displacement(pulled)
        by_position = by_skin.copy()
        by_position[self.marker] += pulled
        return virtual, total, by_position

    def added_displacement(self, refinement: Refinement, force_n: FloatArray) -> FloatArray:
        """Return B f (V, 3), a refinement's displacement of the skin under forces (A, 3)."""
        nodal = refinement.skin_weight[self.marker].T @ force_n
        loaded = np.flatnonzero(np.any(nodal, axis=1)).astype(np.int32)
        moved: FloatArray = refinement.skin_weight @ refinement.displacement(loaded, nodal[loaded])
        return moved

    def added_displacement_adjoint(self, by_skin: FloatArray) -> FloatArray:
        """Return B^T (A, 3) of derivatives (V, 3) by the skin."""
        refinement = self.gel.refinement
        assert refinement is not None
        nodal = refinement.skin_weight.T @ by_skin
        loaded = np.flatnonzero(np.any(nodal, axis=1)).astype(np.int32)
        added = refinement.displacement(loaded, nodal[loaded])
        result: FloatArray = refinement.skin_weight[self.marker] @ added
        return result
