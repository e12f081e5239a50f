# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gel of given parameters at the poses of a press: the model that is fitted.

Young's modulus is not an argument of a solve: in a quasi-static press by a rigid indenter, with a
contact as stiff as the gel, the skin does not depend on it and the force is proportional to it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from dotsim_ros.data.data_set import DataSet
from dotsim_ros.data.plausibility import check_same_shape
from dotsim_ros.data.presses import Press
from dotsim_ros.gel.body import Body, Dome, Pad
from dotsim_ros.gel.discretization import discretize
from dotsim_ros.gel.elasticity import ElasticBody
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.implicit.refinement import Refinement, refine
from dotsim_ros.gel.implicit.tangent import inverse_at_rest
from dotsim_ros.gel.make import body_of, bond_of, material_of, skin_of
from dotsim_ros.gel.material import NeoHookean, PronySeries
from dotsim_ros.gel.reshape import ReshapedDome, ReshapedPad
from dotsim_ros.gel.values import GEL_PARAMETERS, GelValues, specification_with, values_of
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose, quaternion_product
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import Float32Array, FloatArray
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.follow import SimulatedPress, follow

REFERENCE_MODULUS_PA = 3.0e5
"""Young's modulus that everything is solved with."""

TOLERANCE_M = 1.0e-6
"""Tolerance of the solves: the differences between two of them move the skin by some 10 um."""

ITERATIONS = 40

TABLE_SPACING = 0.5
"""Distance between Poisson's ratios that have a table of the refinement, in log(1/2 - nu)."""

LARGEST_TABLE_COORDINATE = -1.0
"""No table above nu = 0.13 or below nu = 0.4997."""
SMALLEST_TABLE_COORDINATE = -8.0

SAME_FACE_M = 20.0e-6
"""Faces closer than this are at one height: a bent one's nearest vertex is lower by some um."""

KEPT_GELS = 4
KEPT_TABLES = 4


def check_is_quasi_static(specification: SensorSpecification) -> None:
    """Refuse a solver whose force is not proportional to Young's modulus.

    Raises:
        ValueError: the solver is explicit or dynamic.
    """
    solver = specification.solver
    if solver.method != "implicit" or solver.dynamic:
        raise ValueError(
            f"{specification.name}: solver.method is {solver.method!r} and solver.dynamic "
            f"{str(solver.dynamic).lower()}, expected a quasi-static implicit gel: set "
            "solver.method to 'implicit' and solver.dynamic to false"
        )


def offset_pose(pose: Pose, offset: FloatArray) -> Pose:
    """Return a pose moved by (6,): metres along the indenter's axes, radians about its origin."""
    turn = np.array([*(0.5 * offset[3:]), 1.0])
    return Pose(pose.apply(offset[:3]), quaternion_product(pose.quaternion_xyzw, turn))


def gel_key(values: GelValues) -> tuple[float | tuple[float, ...], ...]:
    """Return what a gel is recreated for, which takes as long as some presses; its contact, its
    relaxation and its indenter can be changed."""
    return tuple(getattr(values, p.field) for p in GEL_PARAMETERS.values() if p.is_elastic)


def _face_height_m(body: Body, skin: SkinMesh) -> float:
    """Return the height of a pad's face in its middle as the skin has it; 0 for another body."""
    if not isinstance(body, Pad):
        return 0.0
    own, seen = body.size_m[2], float(skin.rest_position_m[:, 2].max())
    # Vertices need not lie in the very middle of a bent face, nor be written in full.
    return own if abs(seen - own) < SAME_FACE_M else seen


def raised_m(body: Body, skin: SkinMesh, thickness_m: float) -> FloatArray:
    """Return how far (3,) the base of a gel, of a thickness that may be another than the body's,
    lies above 0, with its face where the data's skin has it; zeros for a body that is not a pad."""
    if not isinstance(body, Pad):
        return np.zeros(3)
    return np.array([0.0, 0.0, _face_height_m(body, skin) - thickness_m])


def base_in_data_m(sensor: SensorSpecification, data_set: DataSet) -> FloatArray:
    """Return where (3,) the base of a sensor lies in the base frame of a data set.

    The file of a pad that was found thinner has its face, and its camera, lower than its data.

    Raises:
        ValueError: the skin of the data set is not that of the sensor.
    """
    if sensor.gel.shape == "dome" or not data_set.has_skin_mesh:
        return np.zeros(3)
    skin = data_set.skin_mesh()
    check_same_shape(skin, skin_of(sensor.gel), data=str(data_set.directory), sensor=sensor.name)
    return raised_m(body_of(sensor.gel), skin, values_of(sensor).thickness_m)


def seen_from(press: Press, base_m: FloatArray) -> Press:
    """Return a press with its poses (no skin) seen from a base at `base_m`."""
    if not base_m.any():
        return press
    poses = [Pose(pose.position_m - base_m, pose.quaternion_xyzw) for pose in press.poses]
    return replace(press, poses=poses)


def tables_of(poisson_ratio: float) -> tuple[tuple[int, float], ...]:
    """Return the numbers of the tables of the refinement at a Poisson's ratio, with their shares:
    linear between the two next to it."""
    place = float(
        np.clip(np.log(0.5 - poisson_ratio), SMALLEST_TABLE_COORDINATE, LARGEST_TABLE_COORDINATE)
        / TABLE_SPACING
    )
    below = int(np.floor(place))
    share = place - below
    if share < 1e-9:
        return ((below, 1.0),)
    return (below, 1.0 - share), (below + 1, share)


class GelSimulator:
    """Simulates presses of one sensor; keeps the gels of the last parameters.

    The refinement's table takes half a minute to compute for a Poisson's ratio. Fits use tables at
    few ratios, `TABLE_SPACING` apart, and interpolate between them, so that the answer is smooth in
    nu; a changed thickness keeps the table of the sensor's own.

    The free surface of a gel of another thickness stays where that of the skin is, since that is
    where presses are measured from: a dome's core grows, and a pad's base comes up. So a pad whose
    thickness was fitted meets the presses of its data set where they were measured, although in its
    own file its base is at 0 and its face at the thickness that was found.

    Args:
        specification: the sensor; its solver must be implicit and quasi-static.
        skin: the skin's markers, with the face of a pad where the poses have it.
        progress: called with the finished share of each table that is computed.
        tolerance_m: of the solves.

    Raises:
        ValueError: a solver that force is not proportional to Young's modulus for.
    """

    def __init__(
        self,
        specification: SensorSpecification,
        skin: SkinMesh,
        *,
        progress: Callable[[float], None] | None = None,
        tolerance_m: float = TOLERANCE_M,
    ) -> None:
        check_is_quasi_static(specification)
        solver = specification.solver
        self.specification, self.skin = specification, skin
        self._refined, self._progress = solver.refined, progress
        self._solver = replace(
            solver, refined=False, tolerance_m=tolerance_m, iterations=ITERATIONS
        )
        self._body = body_of(specification.gel)
        self._face_m = _face_height_m(self._body, skin)
        self._gels: OrderedDict[tuple[float | tuple[float, ...], ...], ImplicitGel] = OrderedDict()
        self._tables: OrderedDict[int, Refinement] = OrderedDict()

    def press(
        self,
        values: GelValues,
        indenter: Indenter,
        poses: Sequence[Pose],
        stamp_s: FloatArray,
        offset: FloatArray | None = None,
        *,
        relaxation: PronySeries | None = None,
    ) -> SimulatedPress:
        """Return the skin and the force at the poses, one after the other from rest.

        Args:
            values: the gel's parameters.
            indenter, poses, stamp_s: what presses, F times.
            offset: (6,) error of all poses, as `offset_pose`.
            relaxation: of the gel; None for the sensor's own.

        Raises:
            SolveError: a pose presses too deep, or the gel has no equilibrium that can be found.
        """
        gel = self.gel(values, indenter, relaxation)
        moved = list(poses) if offset is None else [offset_pose(pose, offset) for pose in poses]
        base_m = raised_m(self._body, self.skin, values.thickness_m)
        if base_m.any():
            moved = [Pose(pose.position_m - base_m, pose.quaternion_xyzw) for pose in moved]
        found = follow(lambda pose, dt_s: gel.step([pose], dt_s)[0], moved, stamp_s)
        scale = values.youngs_modulus_pa / REFERENCE_MODULUS_PA
        skin_m = found.skin_position_m + base_m if base_m.any() else found.skin_position_m
        return replace(found, skin_position_m=skin_m, force_n=scale * found.force_n)

    def prepare(self, values: GelValues) -> None:
        """Compute the tables that the values need, and keep them on disk."""
        if self._refined:
            self._refinement(values.poisson_ratio)

    def prepare_table(self, number: int) -> None:
        """Compute a table of `tables_of`, and keep it on disk."""
        if self._refined:
            self._table(number)

    def gel(
        self, values: GelValues, indenter: Indenter, relaxation: PronySeries | None = None
    ) -> ImplicitGel:
        """Return the gel that `press` steps, at rest; its Young's modulus is
        `REFERENCE_MODULUS_PA`, and the base of a pad of another thickness is at 0."""
        v = values
        specification = specification_with(
            self.specification, replace(v, youngs_modulus_pa=REFERENCE_MODULUS_PA)
        )
        if relaxation is not None:
            material = replace(
                specification.material,
                prony_shares=relaxation.shares,
                prony_times_s=relaxation.times_s,
            )
            specification = replace(specification, material=material)
        key = gel_key(v)
        gel = self._gels.pop(key, None)
        if gel is None:
            shape = self._reshaped(specification)
            gel = ImplicitGel(
                shape,
                self._skin_on(shape),
                material_of(specification.material),
                contact=specification.contact,
                solver=self._solver,
                indenter=indenter,
                bond=bond_of(specification.gel),
            )
            if self._refined:
                gel.refinement = self._refinement(v.poisson_ratio)
        self._gels[key] = gel
        while len(self._gels) > KEPT_GELS:
            self._gels.popitem(last=False)
        gel.contact_specification = specification.contact
        gel.set_relaxation(material_of(specification.material).prony)
        gel.set_indenter(indenter)
        return gel

    def _reshaped(self, specification: SensorSpecification) -> Body:
        """Return the shape as one that follows smoothly from the sensor's own."""
        shape, own = body_of(specification.gel), self._body
        if isinstance(shape, Dome) and isinstance(own, Dome) and shape != own:
            return ReshapedDome(shape.outer_radius_m, shape.core_radius_m, own)
        if isinstance(shape, Pad) and isinstance(own, Pad) and shape != own:
            return ReshapedPad(shape.size_m, own, curvature_per_m=own.curvature_per_m)
        return shape

    def _skin_on(self, shape: Body) -> SkinMesh:
        """Return the skin on a shape whose base is at 0."""
        own = self._own_skin
        if not isinstance(shape, ReshapedPad):
            return own
        position_m, _, _ = shape.from_reference(own.rest_position_m)
        return replace(own, rest_position_m=position_m)

    @cached_property
    def _own_skin(self) -> SkinMesh:
        """The skin on the sensor's own shape."""
        if not isinstance(self._body, Pad) or self._face_m == self._body.size_m[2]:
            return self.skin
        stretch = np.array([1.0, 1.0, self._body.size_m[2] / self._face_m])
        return replace(self.skin, rest_position_m=stretch * self.skin.rest_position_m)

    def _refinement(self, poisson_ratio: float) -> Refinement:
        """Return the table at a Poisson's ratio."""
        (first, weight), *others = (
            (self._table(number), share) for number, share in tables_of(poisson_ratio)
        )
        if not others:
            return first
        block = weight * first.block + sum(share * table.block for table, share in others)
        return Refinement(first.skin_weight, first.indptr, first.index, block.astype(np.float32))

    def _table(self, number: int) -> Refinement:
        table = self._tables.pop(number, None)
        if table is None:
            poisson_ratio = 0.5 - float(np.exp(number * TABLE_SPACING))
            law = NeoHookean(REFERENCE_MODULUS_PA, poisson_ratio)
            rest_m = self._own_skin.rest_position_m
            coarse = discretize(self._body, rest_m, self._solver.grid_spacing_m)

            def compliance() -> Float32Array:
                return inverse_at_rest(ElasticBody(coarse, law, dtype=np.float32))

            table = refine(self._body, rest_m, coarse, compliance, law, progress=self._progress)
        self._tables[number] = table
        while len(self._tables) > KEPT_TABLES:
            self._tables.popitem(last=False)
        return table
