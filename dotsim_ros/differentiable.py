# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Skin and wrench of a trajectory, differentiable by torch. Entry: `press`.

The gel is solved to rounding and differentiated by its adjoint, friction's history included
(`gel.adjoint`), so that a frame takes about ten times as long as one of `TactileSensor`. Without
torch, `gel.adjoint.backward.trajectory_gradient` gives the same derivatives of NumPy arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch

from dotsim_ros.gel.adjoint.backward import trajectory_gradient
from dotsim_ros.gel.adjoint.gradient import Gradient, LossGradient
from dotsim_ros.gel.adjoint.recorder import Recorder
from dotsim_ros.gel.adjoint.refinement_rate import poisson_rate
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.make import law_of, make_gel_batch
from dotsim_ros.gel.material import ElasticLaw
from dotsim_ros.gel.values import GelValues, specification_with, values_of
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.specification import SensorSpecification

PARAMETERS = (
    "youngs_modulus_pa",
    "poisson_ratio",
    "friction",
    "contact_stiffness",
    "c20_ratio",
    "c30_ratio",
)
"""Fields of `gel.values.GelValues` by which there are derivatives."""
DIFFERENCE = 1.0e-3
"""Relative step of the elastic law's derivatives, which are exact to rounding."""


class Touch(NamedTuple):
    """A trajectory of T frames: the skin (T, V, 3), base frame, and the wrench of the gel on the
    indenter, (T, 3) each, torque about the base's origin; double precision."""

    skin_position_m: torch.Tensor
    force_n: torch.Tensor
    torque_nm: torch.Tensor


def press(
    sensor: SensorSpecification,
    indenter: Indenter,
    poses: Sequence[Pose],
    *,
    dt_s: float = 0.04,
    pose_twist: torch.Tensor | None = None,
    **values: torch.Tensor,
) -> Touch:
    """Return skin and wrench while an indenter goes through poses, with derivatives.

    Args:
        sensor: the gel; what `values` gives takes the place of its own.
        indenter: the rigid shape.
        poses: one a frame, base frame; the first one in the air.
        dt_s: between frames.
        pose_twist: (T, 6) a small translation (m) and rotation (rad) of each pose about the base's
            origin, along its axes; there are derivatives by it where it is zero. None for none.
        values: scalars by names of `PARAMETERS`.

    Raises:
        TypeError: another name.
        ValueError: a value that the sensor cannot have, a twist of another shape or that is not
            zero, or a gel that has come off its core.
        NoEquilibriumError: a frame did not settle.
    """
    unknown = sorted(set(values) - set(PARAMETERS))
    if unknown:
        raise TypeError(
            f"press() has no parameter {unknown[0]!r}, expected some of {', '.join(PARAMETERS)}"
        )
    if pose_twist is None:
        pose_twist = torch.zeros(len(poses), 6, dtype=torch.float64)
    if pose_twist.shape != (len(poses), 6) or bool(pose_twist.any()):
        raise ValueError(
            f"pose_twist has the shape {tuple(pose_twist.shape)}, expected zeros of shape "
            f"({len(poses)}, 6): move the poses, and take derivatives from there"
        )
    names = tuple(values)
    tensors = [torch.as_tensor(values[name]) for name in names]
    case = _Case(sensor, indenter, list(poses), dt_s, names)
    return Touch(*_Press.apply(case, pose_twist, *tensors))


class _Case:
    """What `press` got that has no derivatives, and how the gel went through it."""

    def __init__(
        self,
        sensor: SensorSpecification,
        indenter: Indenter,
        poses: list[Pose],
        dt_s: float,
        names: tuple[str, ...],
    ) -> None:
        self.sensor, self.indenter, self.poses = sensor, indenter, poses
        self.dt_s, self.names = dt_s, names

    def run(self, values: Sequence[float]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return skin, forces and torques of all frames."""
        given: dict[str, Any] = dict(zip(self.names, values, strict=True))
        self.values: GelValues = replace(values_of(self.sensor), **given)
        self.gel: ImplicitGel = make_gel_batch(
            specification_with(self.sensor, self.values),
            indenter=self.indenter,
            environment_count=1,
        )
        self.recorder = Recorder(self.gel)
        states = [self.recorder.step([pose], self.dt_s)[0] for pose in self.poses]
        return (
            np.stack([state.skin_position_m for state in states]),
            np.stack([state.wrench.force_n for state in states]),
            np.stack([state.wrench.torque_nm for state in states]),
        )

    def gradient(self, losses: Sequence[LossGradient]) -> Gradient:
        """Return the derivatives of a loss by everything."""
        rate = None
        if "poisson_ratio" in self.names and self.gel.refinement is not None:
            rate = poisson_rate(self.gel)
        trajectory = self.recorder.trajectories[0]
        return trajectory_gradient(self.gel, trajectory, losses, by_poisson=rate)

    def by_value(self, gradient: Gradient, name: str) -> float:
        """Return the derivative by a value."""
        if name == "friction":
            return gradient.friction_coefficient
        if name == "contact_stiffness":
            return gradient.contact_stiffness
        value = getattr(self.values, name)
        step = DIFFERENCE * (0.5 - value if name == "poisson_ratio" else abs(value) or 1.0)

        def law_at(moved: float) -> ElasticLaw:
            changed: dict[str, Any] = {name: moved}
            values = replace(self.values, **changed)
            return law_of(specification_with(self.sensor, values).material)

        return gradient.along(law_at, value, step)

    def by_pose(self, gradient: Gradient) -> FloatArray:
        """Return the derivatives (T, 6) by the twist of each pose: those of a substep belong to the
        poses before and after it, by the share of the way between them."""
        trajectory = self.recorder.trajectories[0]
        result = np.zeros((len(self.poses), 6))
        first = 0
        for frame, end in enumerate(trajectory.step_end):
            for number in range(first, end):
                contact = trajectory.substeps[number].contact
                share = 1.0
                if frame > 0 and contact is not None:
                    start_m = self.poses[frame - 1].position_m
                    way_m = np.linalg.norm(self.poses[frame].position_m - start_m)
                    if way_m > 0.0:
                        done_m = np.linalg.norm(contact.pose.position_m - start_m)
                        share = min(1.0, float(done_m / way_m))
                twist = gradient.substep_twist[number]
                result[frame] += share * twist
                if frame > 0:
                    result[frame - 1] += (1.0 - share) * twist
            first = end
        return result


class _Press(torch.autograd.Function):
    """`press` as torch sees it."""

    @staticmethod
    def forward(
        ctx: Any, case: _Case, pose_twist: torch.Tensor, *values: torch.Tensor
    ) -> tuple[torch.Tensor, ...]:
        ctx.case = case
        ctx.like = (pose_twist, *values)
        return tuple(torch.as_tensor(found) for found in case.run([float(v) for v in values]))

    @staticmethod
    def backward(ctx: Any, *by_output: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        skin, force, torque = (found.numpy() for found in by_output)
        losses = [LossGradient(*frame) for frame in zip(skin, force, torque, strict=True)]
        case: _Case = ctx.case
        gradient = case.gradient(losses)
        found: list[Any] = [case.by_pose(gradient)]
        found += [case.by_value(gradient, name) for name in case.names]
        return None, *(
            torch.as_tensor(value, dtype=like.dtype).reshape(like.shape)
            for value, like in zip(found, ctx.like, strict=True)
        )
