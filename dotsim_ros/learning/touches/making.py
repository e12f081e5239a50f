# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Touches: what is drawn for each, the gel's answer, and what the camera sees of it.

A touch depends on the plan, the seed and its number alone, so that any worker makes the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from dotsim_ros.effects.effect import (
    Active,
    GelTerm,
    ImageFilter,
    gel_with,
    image_filters,
    seen_through,
)
from dotsim_ros.effects.library import load_effects
from dotsim_ros.gel.body import Body
from dotsim_ros.gel.make import GelFrame, body_of, skin_of
from dotsim_ros.gel.material import PronySeries
from dotsim_ros.gel.rest_depth import RestDepth
from dotsim_ros.gel.values import GEL_PARAMETERS, GelValues, values_of
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose, Wrench
from dotsim_ros.io.arrays import Float32Array, FloatArray, ImageArray
from dotsim_ros.learning.touches.motions import MotionMaker
from dotsim_ros.learning.touches.plan import GRASP, TouchPlan
from dotsim_ros.optics.noise import with_noise
from dotsim_ros.optics.picture import change_image
from dotsim_ros.sensor import Frame, TactileSensor
from dotsim_ros.twin.follow import SolveError
from dotsim_ros.twin.simulator import REFERENCE_MODULUS_PA, GelSimulator, raised_m

ATTEMPTS = 20
"""Draws of a touch until the gel takes one."""
TOLERANCE_M = 30.0e-6
"""Of the gel's solver, if the sensor's own is not larger: forces are within 2 % and markers within
20 um of a closely solved touch, against 0.5 % and 10 um for a third of it, whose gel takes a fifth
to two fifths longer. A slide of an edge has more than one answer, whatever the tolerance."""
CONTACT_M = 20.0e-6
"""Skin that is nearer to the indenter touches it: triangles of the skin cut corners by less."""
LEAST_FORCE_N = 1.0e-3
GEL, TOUCH = 0, 1
"""What numbers are drawn for: all touches of one gel, or one."""
WITH_FLOW = ("motion_blur", "rolling_shutter")
"""Effects that need to know how the image moves."""


@dataclass(frozen=True)
class Solved:
    """What the gel answers in the F frames of a touch.

    Attributes:
        poses: of the indenter, base frame.
        skin_position_m: (F, V, 3) base frame.
        wrenches: of the gel on the indenter, about the base frame's origin.
        slip_share: (F,) share of the pressure that is borne by skin that slips.
        converged: whether the solver met its tolerance in every frame.
    """

    poses: Sequence[Pose]
    skin_position_m: FloatArray
    wrenches: Sequence[Wrench]
    slip_share: FloatArray
    converged: bool


@dataclass(frozen=True)
class Side:
    """One sensor's part in a touch.

    Attributes:
        solved: what the gel answered.
        arrays: (F, ...) by names of `plan.CONTENTS`, those that the plan names.
        images: (F, H, W, 3).
        idle_image: (H, W, 3) as the camera shows it, without noise.
        depth_m: (H, W) of the strongest frame, NaN where no skin is seen.
        strongest: the frame of the largest normal force.
    """

    solved: Solved
    arrays: Mapping[str, np.ndarray[Any, Any]]
    images: ImageArray
    idle_image: ImageArray
    depth_m: Float32Array
    strongest: int


@dataclass(frozen=True)
class Touch:
    """One touch of the data set.

    Attributes:
        number: in the data set.
        kind: of `plan.KINDS`.
        indenter: that pressed.
        constants: what was drawn, and whether the gel's solver converged (1) or not, by name.
        sides: of one sensor, or of both of a grasp.
    """

    number: int
    kind: str
    indenter: Indenter
    constants: Mapping[str, float]
    sides: tuple[Side, ...]

    @property
    def task(self) -> str:
        """What is done, in words."""
        return f"{self.kind} {self.indenter.name}"


class TouchMaker:
    """Makes the touches of a plan.

    Args:
        plan: what is touched.
        seed: of all draws.
        field_width_px: most columns of depth, normals and contact, which are those of every n-th
            pixel of the image.
    """

    def __init__(self, plan: TouchPlan, seed: int, field_width_px: int) -> None:
        self._plan, self._seed = plan, seed
        sensor = plan.sensor
        self._skin = skin_of(sensor.gel)
        tolerance_m = max(TOLERANCE_M, sensor.solver.tolerance_m)
        self._gels = GelSimulator(sensor, self._skin, tolerance_m=tolerance_m)
        # It gives images alone: of its gel nothing is asked.
        seen = replace(
            sensor,
            solver=replace(sensor.solver, refined=False),
            noise=replace(sensor.noise, deviation_levels=0.0),
        )
        self._view = TactileSensor(seen, indenter=plan.indenters[0])
        if plan.image_px != (sensor.camera.width, sensor.camera.height):
            self._view.set_view(size_px=plan.image_px)
        self._step = -(-plan.image_px[0] // field_width_px)
        self._rays = self._view.camera.rays()[0][:: self._step, :: self._step]
        self._body: Body = body_of(sensor.gel)
        # Their hooks cannot be sent to a worker, their names can.
        self._effects = load_effects()
        self._motions = cache(self._motion_maker)

    def _motion_maker(self, number: int) -> MotionMaker:
        indenter = self._plan.indenters[number]
        depth = RestDepth(self._body, indenter)
        return MotionMaker(self._plan.sensor.gel, indenter, depth, self._plan.frames)

    def touch(self, number: int) -> Touch:
        """Return a touch.

        Raises:
            ValueError: the gel takes no touch that was drawn.
        """
        reason: object = "it presses nothing"
        for attempt in range(ATTEMPTS):
            try:
                made = self._attempt(number, attempt)
            except SolveError as error:
                reason = error
                continue
            if made is not None:
                return made
        raise ValueError(
            f"touch {number}: the gel took none of {ATTEMPTS} that were drawn ({reason}); make the "
            "range of pose.depth smaller"
        )

    def _attempt(self, number: int, attempt: int) -> Touch | None:
        plan = self._plan
        random = np.random.default_rng([self._seed, TOUCH, number, attempt])
        of_gel = np.random.default_rng([self._seed, GEL, number // plan.touches_a_gel])
        kinds = list(plan.touches)
        weights = np.array([plan.touches[kind] for kind in kinds])
        kind = kinds[int(random.choice(len(kinds), p=weights / weights.sum()))]
        chosen = int(random.integers(len(plan.indenters)))
        indenter = plan.indenters[chosen]
        drawn = {name: each.draw(random) for name, each in plan.pose.items()}
        motion = self._motions(chosen)
        poses = motion.poses(kind, drawn, random)
        constants = {f"pose.{name}": value for name, value in drawn.items()}
        values = self._drawn_values(random, of_gel, constants)
        active = self._drawn_effects(random, of_gel, constants)
        noise = plan.noise["deviation"].draw(random)
        constants["noise.deviation"] = noise
        own = plan.sensor.material
        term = gel_with(active, GelTerm(values, own.prony_shares, own.prony_times_s), None)
        ways = [poses, motion.opposite(poses)] if kind == GRASP else [poses]
        solved = [self._solved(term, indenter, way) for way in ways]
        if any(
            max(float(np.linalg.norm(w.force_n)) for w in s.wrenches) < LEAST_FORCE_N
            for s in solved
        ):
            return None
        constants["converged"] = float(all(one.converged for one in solved))
        sides = tuple(
            self._seen(one, indenter, active, noise, [self._seed, number, side])
            for side, one in enumerate(solved)
        )
        return Touch(number, kind, indenter, constants, sides)

    def _drawn_values(
        self,
        random: np.random.Generator,
        of_gel: np.random.Generator,
        constants: dict[str, float],
    ) -> GelValues:
        values = values_of(self._plan.sensor)
        drawn: dict[str, Any] = {}
        for name, each in self._plan.gel.items():
            source = of_gel if GEL_PARAMETERS[name].is_elastic else random
            drawn[name] = each.draw(source, float(getattr(values, name)))
        constants |= {f"gel.{name}": value for name, value in drawn.items()}
        return replace(values, **drawn)

    def _drawn_effects(
        self,
        random: np.random.Generator,
        of_gel: np.random.Generator,
        constants: dict[str, float],
    ) -> list[Active]:
        active = []
        for called, ranges in self._plan.effects.items():
            effect = self._effects[called]
            source = random if effect.gel is None else of_gel
            drawn = {name: one.draw(source) for name, one in ranges.items()}
            constants |= {f"{called}.{name}": value for name, value in drawn.items()}
            absent = {p.name: p.none for p in effect.parameters if p.none is not None}
            active.append(Active(effect, effect.checked({**absent, **drawn})))
        return active

    def _solved(self, term: GelTerm, indenter: Indenter, poses: Sequence[Pose]) -> Solved:
        relaxation = PronySeries(term.prony_shares, term.prony_times_s)
        gel = self._gels.gel(term.values, indenter, relaxation)
        base_m = raised_m(self._body, self._skin, term.values.thickness_m)
        scale = term.values.youngs_modulus_pa / REFERENCE_MODULUS_PA
        states = []
        # It begins in the air, which an object's other side does not reach along its axis.
        gel.place(0, Pose(poses[0].position_m - base_m, poses[0].quaternion_xyzw))
        for pose in poses:
            placed = Pose(pose.position_m - base_m, pose.quaternion_xyzw)
            try:
                (state,) = gel.step([placed], 1.0 / self._plan.rate_hz)
            except (ValueError, RuntimeError, np.linalg.LinAlgError) as error:
                raise SolveError(str(error)) from error
            if not np.all(np.isfinite(state.skin_position_m)):
                raise SolveError("the skin is not finite")
            states.append(state)
        wrenches = []
        for state in states:
            force = scale * state.wrench.force_n
            wrenches.append(Wrench(force, scale * state.wrench.torque_nm + np.cross(base_m, force)))
        return Solved(
            list(poses),
            np.stack([state.skin_position_m for state in states]) + base_m,
            wrenches,
            np.array([state.slip_share for state in states]),
            all(state.converged for state in states),
        )

    def _seen(
        self,
        solved: Solved,
        indenter: Indenter,
        active: Sequence[Active],
        noise_levels: float,
        seed: Sequence[int],
    ) -> Side:
        """Return what the camera sees of a touch."""
        plan, view, step = self._plan, self._view, self._step
        shown = image_filters(active)
        idle = self._through(image_filters(active), self._idle_frame(), None)
        frames, images, before = [], [], None
        for index, (pose, skin, wrench) in enumerate(
            zip(solved.poses, solved.skin_position_m, solved.wrenches, strict=True)
        ):
            gel = GelFrame(skin, wrench, 0.0, True, {}, time_s=index / plan.rate_hz)
            frame = view.see(gel, pose)
            flow = self._flow(before, skin, active)
            image = self._through(shown, frame, flow)
            images.append(
                with_noise(
                    image,
                    noise_levels,
                    [*seed, index],
                    channel_count=plan.sensor.camera.channel_count,
                )
            )
            frames.append(frame)
            before = skin
        strongest = int(np.argmax([np.linalg.norm(w.force_n) for w in solved.wrenches]))
        # One array, which is sent once.
        stacked = np.stack(images)
        made = self._arrays(solved, indenter, frames)
        arrays = {name: made[name] for name in plan.contents if name in made}
        if "difference" in plan.contents:
            arrays["difference"] = np.stack([change_image(one, idle, gain=1.0) for one in images])
        if "image" in plan.contents:
            arrays["image"] = stacked
        return Side(
            solved,
            arrays,
            stacked,
            idle,
            frames[strongest].depth_m[::step, ::step],
            strongest,
        )

    @cache  # noqa: B019 - a maker lives as long as its process
    def _idle_frame(self) -> Frame:
        rest = self._skin.rest_position_m
        return self._view.see(GelFrame(rest, Wrench(), 0.0, True, {}), None)

    def _flow(
        self, before_m: FloatArray | None, skin_m: FloatArray, active: Sequence[Active]
    ) -> FloatArray | None:
        """Return how fast the image moves (H, W, 2), px/s; None where no effect asks or it is not
        known."""
        if before_m is None or not any(one.effect.name in WITH_FLOW for one in active):
            return None
        return self._view.image_motion_px(before_m, skin_m) * self._plan.rate_hz

    def _through(self, shown: ImageFilter, frame: Frame, flow: FloatArray | None) -> ImageArray:
        """Return the image that effects make of a frame's."""
        return seen_through(
            shown,
            self._view.camera,
            stamp_s=frame.time_s,
            session_s=frame.time_s,
            image=frame.image,
            idle=frame.idle_image,
            depth_m=frame.depth_m,
            normal=frame.normal,
            flow_px_s=flow,
        )

    def _arrays(
        self, solved: Solved, indenter: Indenter, frames: Sequence[Frame]
    ) -> dict[str, np.ndarray[Any, Any]]:
        """Return what frames hold next to images, 0 where no skin is seen."""
        step, view = self._step, self._view
        depth = np.stack([frame.depth_m[::step, ::step] for frame in frames])
        normal = np.stack([frame.normal[::step, ::step] for frame in frames])
        moved = solved.skin_position_m - self._skin.rest_position_m
        contact = []
        for pose, far in zip(solved.poses, depth, strict=True):
            points = view.camera.pose.apply(np.nan_to_num(far)[..., None] * self._rays)
            distance = indenter.distance_from(points.reshape(-1, 3), pose).reshape(far.shape)
            contact.append(np.isfinite(far) & (distance < CONTACT_M))
        wrench = [np.concatenate([w.force_n, w.torque_nm]) for w in solved.wrenches]
        poses = [np.concatenate([p.position_m, p.quaternion_xyzw]) for p in solved.poses]
        found: dict[str, Any] = {
            "depth": np.nan_to_num(depth),
            "normal": np.nan_to_num(normal),
            "skin": moved,
            "wrench": np.stack(wrench),
            "pose": np.stack(poses),
            "slip": solved.slip_share,
        }
        if view.markers is not None:
            markers = [view.markers.position_m(skin) for skin in solved.skin_position_m]
            found["markers"] = np.stack(markers) - view.markers.rest_m
        arrays = {name: np.asarray(values, dtype=np.float32) for name, values in found.items()}
        return {**arrays, "contact": np.stack(contact)}
