# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The equilibrium of a gel and a soft layer that is pressed onto it: one minimum of one energy.

Both bodies' elastic energies and that of their contact are minimised together, by Newton's method
with a line search. The bodies meet in the contact alone: each keeps the factored stiffness of its
own grid, and a small dense matrix, the compliance of both at the markers in contact, couples them
(Woodbury's formula). Without friction; quasi-static.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.linalg import LinAlgError
from scipy import linalg, sparse

from dotsim_ros.gel.elasticity import ElasticBody
from dotsim_ros.gel.implicit.block_solver import BlockCholesky
from dotsim_ros.gel.implicit.contact import REFERENCE_SPACING_M
from dotsim_ros.geometry.pose import Pose, Wrench
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray, IndexArray
from dotsim_ros.io.cores import single_threaded
from studies.tumour.pair.layer import SoftLayer
from studies.tumour.pair.touch import Touch, near_top, touch

REACH_M = 2.0e-3
"""Markers closer to the layer's top than this are candidates for contact in a step..."""
LARGEST_STEP_M = 1.0e-3
"""...in which the layer moves no farther than this."""
LEAST_STIFFNESS = 1.0e-6
"""Of the contact's own, below which a marker does not touch."""
ARMIJO = 1.0e-4
SHORTEST = 1.0e-4
"""Share of Newton's step below which a search has failed."""
SOLID = (1.0, 0.5, 0.0)
"""Shares of the present stiffness in what is factored, the rest being that without load: the next
one is taken where a strained body is not stable by itself."""


class PairError(ValueError):
    """No equilibrium of gel and layer was found."""


@dataclass(frozen=True)
class PairSettings:
    """Effort of a solve.

    Attributes:
        contact_stiffness: of the contact, in units of the layer's Young's modulus over 1.2 mm.
        tolerance_m: a step that moves no node farther is the last.
        iterations: at most, for each step of the layer.
        fresh: the stiffness is assembled again while a step moves a node farther than this, m.
    """

    contact_stiffness: float = 120.0
    tolerance_m: float = 10.0e-6
    iterations: int = 40
    fresh: float = 0.1e-3


@dataclass(frozen=True)
class PairState:
    """Gel and layer at equilibrium.

    Attributes:
        pose: of the layer's frame in the gel's base frame; None where nothing touches yet.
        gel_m: (N, 3) displacements of the gel's nodes, base frame.
        layer_m: (M, 3) of the layer's, layer's frame.
        skin_position_m: (V, 3) the gel's markers, base frame.
        wrench: of the gel on the layer, about the base frame's origin.
        max_penetration_m: of a marker below the layer's top.
        touching: markers in contact.
        iterations: of Newton's method, all steps together.
    """

    pose: Pose | None
    gel_m: FloatArray
    layer_m: FloatArray
    skin_position_m: FloatArray
    wrench: Wrench = field(default_factory=Wrench)
    max_penetration_m: float = 0.0
    touching: int = 0
    iterations: int = 0


class _Stiffness:
    """The factored stiffness of one body, recreated when asked to."""

    def __init__(self, body: ElasticBody) -> None:
        self._body = body
        nothing = np.zeros((body.discretization.node_count, 3))
        self._unloaded = body.stiffness(nothing, 0)
        self._at_rest = self._factored(self._unloaded)
        self.factor = self._at_rest

    def _factored(self, matrix: sparse.csr_matrix) -> BlockCholesky:
        return BlockCholesky(matrix, self._body.discretization.node_cell)

    def refresh(self, displacement_m: FloatArray) -> None:
        present = self._body.stiffness(displacement_m, 0)
        for share in SOLID:
            if share == 0.0:
                break
            try:
                self.factor = self._factored(share * present + (1.0 - share) * self._unloaded)
            except LinAlgError:
                continue
            return
        self.factor = self._at_rest

    def rest(self) -> None:
        self.factor = self._at_rest


class GelAndLayer:
    """A gel that soft layers are pressed onto.

    Args:
        gel: elastic body of the gel, base frame, discretised with the skin's markers.
        skin: those markers.
        settings: effort.
    """

    def __init__(
        self, gel: ElasticBody, skin: SkinMesh, settings: PairSettings | None = None
    ) -> None:
        self.gel, self.skin = gel, skin
        self.settings = settings or PairSettings()
        count = gel.discretization.node_count
        self._weights = gel.discretization.skin_interpolation.matrix(count)
        self._gel_stiffness = _Stiffness(gel)
        self._layer: SoftLayer | None = None

    @single_threaded()
    def put(self, layer: SoftLayer) -> PairState:
        """Take a layer, and return both at rest, apart."""
        self._layer = layer
        self._layer_stiffness = _Stiffness(layer.body)
        self._gel_stiffness.rest()
        s = self.settings
        self._contact_pa_m = (
            s.contact_stiffness * layer.specification.youngs_modulus_pa / REFERENCE_SPACING_M
        )
        return PairState(
            None,
            np.zeros((self.gel.discretization.node_count, 3)),
            np.zeros((layer.node_count, 3)),
            self.skin.rest_position_m.copy(),
        )

    @single_threaded()
    def press(self, start: PairState, pose: Pose) -> PairState:
        """Return the equilibrium with the layer's frame at a pose, from a state close to it.

        Args:
            start: of this layer.
            pose: of the layer's frame in the base frame, at most 1 mm from that of the state.

        Raises:
            PairError: no layer was put, it moved too far, the gel reaches over its rim, or Newton's
                method found no equilibrium.
        """
        layer = self._layer
        if layer is None:
            raise PairError("no layer was put onto the gel; call put() first")
        if start.pose is not None:
            moved = float(np.linalg.norm(pose.position_m - start.pose.position_m))
            if moved > LARGEST_STEP_M * (1.0 + 1e-9):
                raise PairError(
                    f"the layer moved by {moved} m, expected {LARGEST_STEP_M} m at most; press in "
                    "smaller steps"
                )
        s, gel_m, layer_m = self.settings, start.gel_m, start.layer_m
        markers = self._markers(layer, start.skin_position_m, pose)
        here = markers.touch(gel_m, layer_m, markers.local(gel_m)[:, :2])
        size = np.inf
        for iteration in range(1, s.iterations + 1):
            if size > s.fresh:
                self._layer_stiffness.refresh(layer_m)
                if iteration == 1:
                    self._gel_stiffness.refresh(gel_m)
            gel_energy, gel_r = self.gel.force_in(0, gel_m)
            layer_energy, layer_r = layer.body.force_in(0, layer_m)
            energy = gel_energy + layer_energy + here.energy_j
            gel_r = gel_r - markers.weights.T @ markers.force_n(here)
            layer_r = layer_r + here.layer_force_n()
            step_gel, step_layer = self._newton_step(gel_r, layer_r, here, markers)
            size = max(float(np.abs(step_gel).max()), float(np.abs(step_layer).max()))
            descent = float(np.vdot(gel_r, step_gel) + np.vdot(layer_r, step_layer))
            share = min(1.0, LARGEST_STEP_M / size)
            while True:
                tried_gel, tried_layer = gel_m + share * step_gel, layer_m + share * step_layer
                tried = markers.touch(tried_gel, tried_layer, here.parameters_m)
                total = tried.energy_j + sum(
                    body.force_in(0, moved)[0]
                    for body, moved in ((self.gel, tried_gel), (layer.body, tried_layer))
                )
                if total <= energy + ARMIJO * share * descent or size < s.tolerance_m:
                    break
                share *= 0.5
                if share < SHORTEST:
                    raise PairError(
                        f"no step of iteration {iteration} lowers the energy of gel and layer; "
                        "press less deep or in smaller steps"
                    )
            gel_m, layer_m, here = tried_gel, tried_layer, tried
            if size < s.tolerance_m:
                skin = self.skin.rest_position_m + self._weights @ gel_m
                # The layer's reaction to what presses each marker outwards.
                force = -markers.force_n(here)
                torque = np.cross(skin[markers.number], force).sum(axis=0)
                return PairState(
                    pose,
                    gel_m,
                    layer_m,
                    skin,
                    Wrench(force.sum(axis=0), torque),
                    float(max(0.0, -here.gap_m.min(initial=0.0))),
                    int(np.count_nonzero(here.force_n)),
                    start.iterations + iteration,
                )
        raise PairError(
            f"gel and layer have not come to rest within {s.iterations} iterations, the last of "
            f"which moved them by {size} m; press less deep or in smaller steps"
        )

    def _markers(self, layer: SoftLayer, skin_m: FloatArray, pose: Pose) -> _Markers:
        """Return the markers that may touch a layer, of a skin (V, 3) close to the solution."""
        number, beside = near_top(layer, _into(pose, skin_m), REACH_M)
        beside &= ~self.skin.on_base
        if np.any(_into(pose, skin_m)[beside, 2] < layer.specification.thickness_m):
            raise PairError(
                f"the gel reaches over the rim of the layer of {layer.specification.side_m} m; "
                "take a wider layer"
            )
        return _Markers(
            layer,
            pose,
            number,
            self._weights[number],
            self.skin.rest_position_m[number],
            self.skin.rest_area_m2[number],
            self._contact_pa_m,
        )

    def _newton_step(
        self, gel_r: FloatArray, layer_r: FloatArray, here: Touch, markers: _Markers
    ) -> tuple[FloatArray, FloatArray]:
        """Return the steps of both bodies from the energy's gradients by their displacements."""
        gel, layer = self._gel_stiffness.factor, self._layer_stiffness.factor
        stiff = here.stiffness_n_m
        touching = np.flatnonzero(stiff > LEAST_STIFFNESS * stiff.max(initial=0.0))
        normal = here.normal[touching]
        on_gel = _along(markers.weights[touching], normal @ markers.pose.rotation().T)
        on_layer = _along(here.layer_weight[touching], -normal)
        # The first column is the step without contact, the others what the contact forces add.
        gel_columns = gel.solve(np.column_stack([-gel_r.ravel(), on_gel.T.toarray()]))
        layer_columns = layer.solve(np.column_stack([-layer_r.ravel(), on_layer.T.toarray()]))
        coupled = on_gel @ gel_columns + on_layer @ layer_columns
        free, compliance = coupled[:, 0], coupled[:, 1:]
        compliance[np.diag_indices_from(compliance)] += 1.0 / stiff[touching]
        pressed = linalg.solve(compliance, free, assume_a="pos") if len(touching) else free
        combined = np.concatenate([[1.0], -pressed])
        return (gel_columns @ combined).reshape(-1, 3), (layer_columns @ combined).reshape(-1, 3)


@dataclass(frozen=True)
class _Markers:
    """C markers of the gel that may touch a layer whose frame lies at a pose.

    Attributes:
        layer, pose: which.
        number: (C,) theirs in the skin.
        weights: (C, N) of the gel's nodes.
        rest_m: (C, 3) at rest, base frame.
        area_m2: (C,) of the skin that each stands for.
        stiffness_pa_m: of the contact, pressure over depth.
    """

    layer: SoftLayer
    pose: Pose
    number: IndexArray
    weights: sparse.csr_matrix
    rest_m: FloatArray
    area_m2: FloatArray
    stiffness_pa_m: float

    def local(self, gel_m: FloatArray) -> FloatArray:
        """Return where they are (C, 3) in the layer's frame."""
        return _into(self.pose, self.rest_m + self.weights @ gel_m)

    def touch(self, gel_m: FloatArray, layer_m: FloatArray, start_m: FloatArray) -> Touch:
        """Return their contact; the search for the nearest points begins at (C, 2)."""
        marker = self.local(gel_m)
        return touch(self.layer, layer_m, marker, self.area_m2, self.stiffness_pa_m, start_m)

    def force_n(self, here: Touch) -> FloatArray:
        """Return the forces on them (C, 3), base frame."""
        return np.asarray(here.force_n[:, None] * (here.normal @ self.pose.rotation().T))


def _into(pose: Pose, points_m: FloatArray) -> FloatArray:
    """Return points (..., 3) of the base frame in the frame at a pose."""
    return np.asarray((points_m - pose.position_m) @ pose.rotation())


def _along(weights: sparse.csr_matrix, direction: FloatArray) -> sparse.csr_matrix:
    """Return the (m, 3 N) derivatives of displacements (m,) along directions (m, 3), of weights
    (m, N), by the nodes' displacements."""
    rows = weights.tocoo()
    column = (3 * rows.col[:, None] + np.arange(3)).ravel()
    value = (rows.data[:, None] * direction[rows.row]).ravel()
    shape = (weights.shape[0], 3 * weights.shape[1])
    return sparse.csr_matrix((value, (np.repeat(rows.row, 3), column)), shape=shape)
