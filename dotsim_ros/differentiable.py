# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a sensor feels and sees along a trajectory, differentiable by torch. Entries: `press` for
skin and wrench, `press_each` for many gels, `see` for the depth image and markers of a skin.

The gel is solved to rounding and differentiated by its adjoint, friction's history included
(`gel.adjoint`): a frame takes about five times as long as one of `TactileSensor`, its derivatives
less than that. Without torch, `gel.adjoint.backward.trajectory_gradient` gives the same derivatives
of NumPy arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import torch

from dotsim_ros.gel.adjoint.backward import trajectory_gradient
from dotsim_ros.gel.adjoint.gradient import Gradient, LossGradient
from dotsim_ros.gel.adjoint.recorder import GelTrajectory, Recorder
from dotsim_ros.gel.adjoint.refinement_rate import poisson_rate
from dotsim_ros.gel.adjoint.rest_points import RestPoints
from dotsim_ros.gel.body import Dome, Pad
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.implicit.refinement import Refinement
from dotsim_ros.gel.make import body_of, bond_of, law_of, make_gel_batch, skin_of
from dotsim_ros.gel.material import ElasticLaw
from dotsim_ros.gel.reshape import ReshapedDome, ReshapedPad
from dotsim_ros.gel.values import GelValues, specification_with, values_of
from dotsim_ros.geometry.camera import Camera, middle_part
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.markers import PrintedMarkers
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import SensorSpecification

PARAMETERS = (
    "youngs_modulus_pa",
    "poisson_ratio",
    "friction",
    "contact_stiffness",
    "c20_ratio",
    "c30_ratio",
    "thickness_m",
)
"""Fields of `gel.values.GelValues` by which there are derivatives."""
DIFFERENCE = 1.0e-3
"""Relative step of the elastic law's derivatives, which are exact to rounding."""
CAMERA_STEP_M = 1.0e-6
"""Of the projection's derivatives by central differences: their error is below 1e-7 of them."""


class Touch(NamedTuple):
    """A trajectory of T frames: the skin (T, V, 3), base frame, and the wrench of the gel on the
    indenter, (T, 3) each, torque about the base's origin; double precision."""

    skin_position_m: torch.Tensor
    force_n: torch.Tensor
    torque_nm: torch.Tensor


class Sight(NamedTuple):
    """What the camera sees of skins, double precision.

    Attributes:
        depth_m: (..., H, W) range, the distance along the ray; NaN where no skin is seen.
        marker_px: (..., M, 2) x and y of the printed markers, also of one beyond the image's edge;
            NaN where the camera has no image of it.
    """

    depth_m: torch.Tensor
    marker_px: torch.Tensor


def press(
    sensor: SensorSpecification,
    indenter: Indenter,
    poses: Sequence[Pose],
    *,
    dt_s: float = 0.04,
    pose_twist: torch.Tensor | None = None,
    pose_offset: torch.Tensor | None = None,
    **values: torch.Tensor | float,
) -> Touch:
    """Return skin and wrench while an indenter goes through poses, with derivatives.

    Another thickness stretches the sensor's own gel, its grid and refinement stay: a dome keeps its
    outer radius, the face of a pad moves. Where this face lies on a plane of the grid, as that of a
    pad 4 mm thick on a grid of 2 mm does, the derivative is that towards thinner.

    Args:
        sensor: the gel; what `values` gives takes the place of its own.
        indenter: the rigid shape.
        poses: one a frame, base frame; the first one in the air.
        dt_s: between frames.
        pose_twist: (T, 6) a small translation (m) and rotation (rad) of each pose about the base's
            origin, along its axes; there are derivatives by it where it is zero. None for none.
        pose_offset: (6,) the same of all poses together, along the indenter's axes and about its
            origin.
        values: scalars by names of `PARAMETERS`.

    Raises:
        TypeError: another name.
        ValueError: a value that the sensor cannot have, a twist of another shape or that is not
            zero, a thickness of a dome without a core, or a gel that has come off its core.
        NoEquilibriumError: a frame did not settle.
    """
    each = press_each(
        sensor,
        [indenter],
        [poses],
        dt_s=dt_s,
        pose_twist=_zeros(pose_twist, "pose_twist", (len(poses), 6))[None],
        pose_offset=_zeros(pose_offset, "pose_offset", (6,))[None],
        **values,
    )
    return Touch(*(found[0] for found in each))


def press_each(
    sensor: SensorSpecification,
    indenters: Sequence[Indenter],
    poses: Sequence[Sequence[Pose]],
    *,
    dt_s: float = 0.04,
    pose_twist: torch.Tensor | None = None,
    pose_offset: torch.Tensor | None = None,
    **values: torch.Tensor | float,
) -> Touch:
    """Return what `press` does for B gels, with an axis B before the others.

    Gels with the same values share what is computed from these; each is solved by itself.

    Args:
        sensor, dt_s: as for `press`, of all gels.
        indenters: of each gel.
        poses: (B, T) of each gel.
        pose_twist, pose_offset: (B, T, 6) and (B, 6).
        values: scalars for all gels, or tensors (B,).

    Raises:
        as `press`; ValueError where a number of gels or frames differs from the others.
    """
    unknown = sorted(set(values) - set(PARAMETERS))
    if unknown:
        raise TypeError(
            f"press() has no parameter {unknown[0]!r}, expected some of {', '.join(PARAMETERS)}"
        )
    if "thickness_m" in values and sensor.gel.shape == "dome" and not sensor.gel.core_radius_m:
        raise ValueError("thickness_m is given, and a dome without a core has none: leave it out")
    count = len(poses)
    # torch would round a plain number to single precision.
    tensors = {
        name: v if isinstance(v, torch.Tensor) else torch.tensor(v, dtype=torch.float64)
        for name, v in values.items()
    }
    lengths = {"indenters": len(indenters)}
    lengths |= {name: len(v) for name, v in tensors.items() if v.dim() > 0}
    if wrong := [f"{length} {name}" for name, length in lengths.items() if length != count]:
        raise ValueError(f"{', '.join(wrong)} for {count} gels, expected as many")
    frames = {len(path) for path in poses}
    if len(frames) != 1:
        raise ValueError("the gels have different numbers of poses, or none, expected as many each")
    twist = _zeros(pose_twist, "pose_twist", (count, frames.pop(), 6))
    offset = _zeros(pose_offset, "pose_offset", (count, 6))
    case = _Case(sensor, list(indenters), [list(path) for path in poses], dt_s, tuple(tensors))
    spread = [v.expand(count) for v in tensors.values()]
    return Touch(*_Press.apply(case, twist, offset, *spread))


def see(
    sensor: SensorSpecification,
    skin_position_m: torch.Tensor,
    *,
    image_size: tuple[int, int] | None = None,
) -> Sight:
    """Return what the camera sees of skins, with derivatives.

    The range at a pixel is that to the plane of the triangle seen there, and so is its derivative.
    Where this triangle gives way to its neighbour, the range has a kink, and the derivative is that
    on the triangle's side. Where the skin hides a part of itself, the range jumps: the derivatives
    leave out that such an outline moves.

    Args:
        sensor: its camera, skin and markers.
        skin_position_m: (..., V, 3) base frame, as `Touch` has it.
        image_size: width and height of the image, of the part in the middle of the camera's that
            has this shape, as for `TactileArray`; None for the camera's own.

    Raises:
        ValueError: another number of vertices than the skin's, or one that is not finite.
    """
    skin, camera = skin_of(sensor.gel), Camera.from_specification(sensor.camera)
    if image_size is not None:
        part = middle_part((camera.width, camera.height), image_size)
        camera = camera.part(*part).scaled(*image_size)
    renderer, frames = SkinRenderer(camera, skin), skin_position_m.detach().cpu().numpy()
    before = frames.shape[:-2]
    found = [renderer.render(f).triangle for f in frames.reshape(-1, *frames.shape[-2:])]
    triangle = torch.as_tensor(np.stack(found))

    origin, rotation = camera.pose.position_m, camera.pose.rotation()
    given = skin_position_m.double().cpu().reshape(-1, *frames.shape[-2:])
    place = (given - torch.tensor(origin)) @ torch.tensor(rotation)
    first, second, third = place[:, torch.as_tensor(skin.triangles).long()].unbind(2)
    normal = torch.linalg.cross(second - first, third - first)
    height = (first * normal).sum(-1)
    frame, row, column = torch.nonzero(triangle >= 0, as_tuple=True)
    number = triangle[frame, row, column].long()
    ray = torch.tensor(camera.rays()[0])[row, column]
    range_m = height[frame, number] / (ray * normal[frame, number]).sum(-1)
    nothing = torch.full(triangle.shape, torch.nan, dtype=torch.float64)
    depth_m = nothing.index_put((frame, row, column), range_m)

    marker_px = given.new_zeros(len(given), 0, 2)
    if sensor.markers.columns:
        markers = PrintedMarkers(sensor.markers, skin)
        corner = given[:, torch.as_tensor(markers.corner).long()]
        weight = torch.as_tensor(markers.weight)[..., None]
        marker_px = _projected(camera, (weight * corner).sum(2))
    return Sight(depth_m.reshape(*before, *triangle.shape[1:]), marker_px.reshape(*before, -1, 2))


def _projected(camera: Camera, point_m: torch.Tensor) -> torch.Tensor:
    """Return the images (..., 2) of points (..., 3), base frame, with derivatives."""
    point = point_m.detach().numpy()
    ahead, behind = (
        camera.project(point[..., None, :] + step * np.eye(3))
        for step in (CAMERA_STEP_M, -CAMERA_STEP_M)
    )
    # A marker without an image has no part in any derivative.
    slope = torch.as_tensor(np.nan_to_num((ahead - behind) / (2.0 * CAMERA_STEP_M)))
    motion = ((point_m - point_m.detach())[..., None] * slope).sum(-2)
    return torch.as_tensor(camera.project(point)) + motion


def _zeros(given: torch.Tensor | None, name: str, shape: tuple[int, ...]) -> torch.Tensor:
    """Return zeros by which there are derivatives.

    Raises:
        ValueError: what is given has another shape, or is not zero.
    """
    if given is None:
        return torch.zeros(shape, dtype=torch.float64)
    if given.shape != shape or bool(given.any()):
        raise ValueError(
            f"{name} has the shape {tuple(given.shape)}, expected zeros of shape {shape}: move the "
            "poses, and take derivatives from there"
        )
    return given


class _Model:
    """The gel with some values of its parameters."""

    def __init__(
        self, sensor: SensorSpecification, indenter: Indenter, given: dict[str, float]
    ) -> None:
        self.sensor, self.indenter = sensor, indenter
        changes: dict[str, Any] = given
        self.values: GelValues = replace(values_of(sensor), **changes)
        self.own_gel = self._own_gel()
        self.gel = self._stretched(self.own_gel)

    @cached_property
    def poisson_rate(self) -> Refinement | None:
        """How the gel's refinement varies with Poisson's ratio; None for a gel without one."""
        return None if self.gel.refinement is None else poisson_rate(self.own_gel)

    @cached_property
    def points(self) -> RestPoints:
        """The gel's particles, markers and bonded points."""
        return RestPoints(self.gel)

    def _own_gel(self) -> ImplicitGel:
        """Return a gel of the sensor's own thickness with the values.

        Raises:
            ValueError: a value that the sensor cannot have.
        """
        specification_with(self.sensor, self.values)
        own = replace(self.values, thickness_m=self.sensor.gel.thickness_m)
        return make_gel_batch(
            specification_with(self.sensor, own), indenter=self.indenter, environment_count=1
        )

    def _stretched(self, gel: ImplicitGel) -> ImplicitGel:
        """Return a gel that is stretched to the thickness of the values: its response is a smooth
        function of that, as it would not be on particles and a grid of its own."""
        body, thickness_m = body_of(self.sensor.gel), self.values.thickness_m
        if thickness_m == self.sensor.gel.thickness_m:
            return gel
        skin, shape = gel.skin, body
        if isinstance(body, Dome):
            core_m = body.outer_radius_m - thickness_m
            shape = ReshapedDome(body.outer_radius_m, core_m, body)
        elif isinstance(body, Pad):
            size_m = (*body.size_m[:2], thickness_m)
            shape = ReshapedPad(size_m, body, curvature_per_m=body.curvature_per_m)
            moved_m, _, _ = shape.from_reference(skin.rest_position_m)
            skin = replace(skin, rest_position_m=moved_m)
        stretched = ImplicitGel(
            shape,
            skin,
            gel.material,
            contact=gel.contact_specification,
            solver=replace(gel.solver, refined=False),
            indenter=self.indenter,
            bond=bond_of(self.sensor.gel),
        )
        stretched.refinement = gel.refinement
        return stretched

    def by_value(self, gradient: Gradient, name: str) -> float:
        """Return the derivative by a value."""
        if name == "friction":
            return gradient.friction_coefficient
        if name == "contact_stiffness":
            return gradient.contact_stiffness
        if name == "thickness_m":
            # The core of a dome is what gives way.
            by_length = gradient.geometry
            return by_length[name] if name in by_length else -by_length["core_radius_m"]
        value = getattr(self.values, name)
        step = DIFFERENCE * (0.5 - value if name == "poisson_ratio" else abs(value) or 1.0)

        def law_at(moved: float) -> ElasticLaw:
            changed: dict[str, Any] = {name: moved}
            values = replace(self.values, **changed)
            return law_of(specification_with(self.sensor, values).material)

        return gradient.along(law_at, value, step)


class _Case:
    """What `press_each` got that has no derivatives, and how the gels went through it."""

    def __init__(
        self,
        sensor: SensorSpecification,
        indenters: list[Indenter],
        poses: list[list[Pose]],
        dt_s: float,
        names: tuple[str, ...],
    ) -> None:
        self.sensor, self.indenters, self.poses = sensor, indenters, poses
        self.dt_s, self.names = dt_s, names

    def run(self, values: FloatArray) -> list[FloatArray]:
        """Return skin, forces and torques of all gels and frames, for values (B, n) by names."""
        known: dict[tuple[float, ...], _Model] = {}
        self.models: list[_Model] = []
        self.trajectories: list[GelTrajectory] = []
        skin, force, torque = [], [], []
        for indenter, poses, own in zip(self.indenters, self.poses, values.tolist(), strict=True):
            key = tuple(own)
            if key not in known:
                given = dict(zip(self.names, own, strict=True))
                known[key] = _Model(self.sensor, indenter, given)
            model = known[key]
            _set_indenter(model.gel, indenter)
            recorder = Recorder(model.gel)
            states = [recorder.step([pose], self.dt_s)[0] for pose in poses]
            self.models.append(model)
            self.trajectories.append(recorder.trajectories[0])
            skin.append([state.skin_position_m for state in states])
            force.append([state.wrench.force_n for state in states])
            torque.append([state.wrench.torque_nm for state in states])
        return [np.array(found) for found in (skin, force, torque)]

    def gradient(self, number: int, losses: Sequence[LossGradient]) -> list[Any]:
        """Return the derivatives of a loss of one gel by the twists of its poses, by their offset,
        and by each value."""
        model = self.models[number]
        rate = model.poisson_rate if "poisson_ratio" in self.names else None
        _set_indenter(model.gel, self.indenters[number])
        found = trajectory_gradient(
            model.gel,
            self.trajectories[number],
            losses,
            by_poisson=rate,
            points=model.points,
        )
        by_value = [model.by_value(found, name) for name in self.names]
        return [self.by_pose(number, found), found.indenter_offset, *by_value]

    def by_pose(self, number: int, gradient: Gradient) -> FloatArray:
        """Return the derivatives (T, 6) by the twist of each pose: those of a substep belong to the
        poses before and after it, by the share of the way between them."""
        trajectory, poses = self.trajectories[number], self.poses[number]
        result = np.zeros((len(poses), 6))
        first = 0
        for frame, end in enumerate(trajectory.step_end):
            for substep in range(first, end):
                contact = trajectory.substeps[substep].contact
                share = 1.0
                if frame > 0 and contact is not None:
                    start_m = poses[frame - 1].position_m
                    way_m = np.linalg.norm(poses[frame].position_m - start_m)
                    if way_m > 0.0:
                        done_m = np.linalg.norm(contact.pose.position_m - start_m)
                        share = min(1.0, float(done_m / way_m))
                twist = gradient.substep_twist[substep]
                result[frame] += share * twist
                if frame > 0:
                    result[frame - 1] += (1.0 - share) * twist
            first = end
        return result


def _set_indenter(gel: ImplicitGel, indenter: Indenter) -> None:
    if gel.contact.indenter is not indenter:
        gel.set_indenter(indenter)


class _Press(torch.autograd.Function):
    """`press_each` as torch sees it."""

    @staticmethod
    def forward(
        ctx: Any, case: _Case, twist: torch.Tensor, offset: torch.Tensor, *values: torch.Tensor
    ) -> tuple[torch.Tensor, ...]:
        ctx.case = case
        ctx.like = (twist, offset, *values)
        given = np.array([v.detach().double().cpu().numpy() for v in values])
        each = given.T if values else np.zeros((len(case.poses), 0))
        return tuple(torch.as_tensor(found) for found in case.run(each))

    @staticmethod
    def backward(ctx: Any, *by_output: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        case: _Case = ctx.case
        by_gel = zip(*(found.numpy() for found in by_output), strict=True)
        found = [
            case.gradient(number, [LossGradient(*frame) for frame in zip(*by, strict=True)])
            for number, by in enumerate(by_gel)
        ]
        return None, *(
            torch.as_tensor(np.array(value), dtype=like.dtype).reshape(like.shape)
            for value, like in zip(zip(*found, strict=True), ctx.like, strict=True)
        )
