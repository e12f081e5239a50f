# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One sensor under a stream of motions: new starts, refusals, and the last valid frame.

Needs no ROS.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dotsim_ros.arrays import FloatArray, ImageArray
from dotsim_ros.effects.live import LiveEffects
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import vertex_normals
from dotsim_ros.nodes.common.ingest import Fault, RefusedInputError
from dotsim_ros.nodes.tactile_sim.motion import NANOSECONDS_PER_SECOND, MotionOrder
from dotsim_ros.nodes.tactile_sim.pursuit import pursue
from dotsim_ros.sensor import GelFailureError

if TYPE_CHECKING:
    from dotsim_ros.effects.effect import Active
    from dotsim_ros.gel.make import GelFrame
    from dotsim_ros.geometry.camera import Camera
    from dotsim_ros.geometry.indenter import Indenter
    from dotsim_ros.nodes.tactile_sim.force_drive import ForceDrive
    from dotsim_ros.sensor import Frame, TactileSensor
    from dotsim_ros.specification import SolverSpecification

WARM_UP_DEPTH_M = 0.0005


class SensorMoment:
    """The gel under an indenter, and what the camera sees of it, rendered on demand.

    Args:
        sensor: which sees.
        gel: what it sees.
        pose: of the indenter.
        camera: what effects make of a frame's image; None for nothing.
    """

    def __init__(
        self,
        sensor: TactileSensor,
        gel: GelFrame,
        pose: Pose | None,
        camera: Callable[[Frame], ImageArray] | None = None,
    ) -> None:
        self._sensor, self.gel, self.pose, self._camera = sensor, gel, pose, camera
        self._frame: Frame | None = None
        self._seen_by: Camera | None = None

    def render(self) -> Frame:
        """Return the whole frame; it is rendered the first time, and when the sensor's camera has
        become another."""
        if self._frame is None or self._seen_by is not self._sensor.camera:
            frame = self._sensor.see(self.gel, self.pose)
            self._seen_by = self._sensor.camera
            if self._camera is not None:
                begun_s = time.perf_counter()
                image = self._camera(frame)
                spent_s = time.perf_counter() - begun_s
                frame = replace(
                    frame, image=image, timings_s={**frame.timings_s, "effects": spent_s}
                )
            self._frame = frame
        return self._frame

    def skin_normal(self) -> FloatArray:
        """Return (V, 3) unit normals of the skin, out of the gel, base frame."""
        if self._frame is not None:
            return self._frame.skin_normal
        return vertex_normals(self.gel.skin_position_m, self._sensor.skin.triangles)

    @property
    def timings_s(self) -> dict[str, float]:
        """Seconds spent so far, by part."""
        return self.gel.timings_s if self._frame is None else self._frame.timings_s


class SensorSession:
    """Runs a sensor; after anything that breaks the motion it continues as a fresh one would.

    Args:
        sensor: the sensor, at rest.
        first_dt_s: the time step of a motion that nothing leads to.
        limit_m: how far the indenter may move in contact in one frame; a longer motion takes
            several frames. Infinite for none.
        effects: at work between the commanded pose and what is measured; the sensor's gel has them.
        drive: where to press for a force, in place of the depth that a pose has; None: the pose.

    Attributes:
        moment: the last valid one.
        behind: how many frames did not reach the newest pose.
        first_dt_s: as given; another rate of the frames is another time step.
    """

    def __init__(
        self,
        sensor: TactileSensor,
        *,
        first_dt_s: float,
        limit_m: float = np.inf,
        effects: Sequence[Active] = (),
        drive: ForceDrive | None = None,
    ) -> None:
        self._sensor = sensor
        self._drive = drive
        self.first_dt_s = first_dt_s
        self._limit_m = limit_m
        self._effects = LiveEffects(effects, sensor)
        self._commanded: Pose | None = None
        self._at: Pose | None = None
        self._is_behind = False
        self.behind = 0
        self._last_stamp_ns: int | None = None
        self._is_broken = False
        self._force_n = np.zeros(3)
        self.moment = self._pressed(None, first_dt_s)

    def warm_up(self) -> float:
        """Press once and forget it, so that no frame waits for a compiler; return the seconds.

        Raises:
            EffectError: an effect fails at a press, which it would do in the first frame.
        """
        start_s = time.monotonic()
        apex_m = self._sensor.skin.rest_position_m[:, 2].max()
        pose, step_s = Pose(np.array([0.0, 0.0, apex_m - WARM_UP_DEPTH_M])), self.first_dt_s
        frame = self._sensor.step(pose, step_s)
        moved = self._effects.moved(pose, frame.wrench.force_n, step_s)
        self._effects.answered(self._sensor.press(pose, step_s), moved)
        camera = self._effects.camera(None, step_s)
        if camera is not None:
            camera(frame)
        self.reset()
        return time.monotonic() - start_s

    def follow(self, motion: MotionOrder) -> SensorMoment:
        """Simulate a motion, or as much of it as one frame may.

        Raises:
            RefusedInputError: the gel refuses the pose or cannot be solved; the last frame stays,
                and the next motion starts from rest.
        """
        if motion.new_start is not None or self._is_broken:
            self._sensor.reset()
            self._effects.begin()
            self._forget_force()
            self._last_stamp_ns = None
            self._at = None
            self._force_n = np.zeros(3)
        step_s = self._step_s(motion.stamp_ns)
        self._last_stamp_ns = motion.stamp_ns
        return self._move(motion.pose, step_s)

    def catch_up(self, step_s: float | None = None) -> SensorMoment:
        """Go on to the newest pose, which `follow` did not reach, or the newest force; where both
        are reached, let a gel that remembers, or an effect, evolve under the held indenter.

        Args:
            step_s: time since the frame before; by default that of a motion that nothing leads to.

        Raises:
            RefusedInputError: as `follow`.
        """
        goes_on = self._is_behind or self._sensor.remembers or self._effects.act_in_time
        if self._commanded is None or self._is_broken:
            return self.moment
        is_followed = self._drive is None or self._drive.is_met(self._commanded)
        if is_followed and not goes_on:
            return self.moment
        step_s = self.first_dt_s if step_s is None else step_s
        if self._last_stamp_ns is not None:
            self._last_stamp_ns += int(step_s * NANOSECONDS_PER_SECOND)
        return self._move(self._commanded, step_s)

    def _move(self, commanded: Pose, step_s: float) -> SensorMoment:
        self._commanded, self._is_behind = commanded, False
        try:
            wanted = commanded if self._drive is None else self._drive.pose(commanded)
            pose = self._effects.moved(wanted, self._force_n, step_s)
            reached = self._within_reach(pose)
            self.moment = self._pressed(reached, step_s)
        except ValueError as error:
            self._is_broken = True
            fault = Fault.FAILURE if isinstance(error, GelFailureError) else Fault.GEL
            raise RefusedInputError(fault, str(error)) from error
        self._is_broken = False
        self._at = reached
        if self._drive is not None:
            got = wanted if reached is pose else reached
            self._drive.answer(got, self.moment.gel.wrench.force_n)
        if reached is not pose:
            self._is_behind = True
            self.behind += 1
        return self.moment

    def _pressed(self, pose: Pose | None, step_s: float) -> SensorMoment:
        before_m = None if self._at is None else self.moment.gel.skin_position_m
        gel = self._sensor.press(pose, step_s)
        self._force_n = gel.wrench.force_n
        return SensorMoment(
            self._sensor,
            self._effects.answered(gel, pose),
            pose,
            self._effects.camera(before_m, step_s),
        )

    def _within_reach(self, pose: Pose) -> Pose:
        if np.isinf(self._limit_m):
            return pose
        # Now, not when the indenter gets there: a press that is refused must not begin.
        self._sensor.check_depth(pose)
        rest_m = self._sensor.skin.rest_position_m
        start, skin_m = self._at, self.moment.gel.skin_position_m
        if start is None:
            # The sensor comes to a first pose along the indenter's axis.
            away_m = float(np.ptp(rest_m, axis=0).max()) * pose.rotation()[:, 2]
            start, skin_m = Pose(pose.position_m + away_m, pose.quaternion_xyzw), rest_m
        return pursue(
            start,
            pose,
            indenter=self._sensor.indenter,
            skin_position_m=skin_m,
            limit_m=self._limit_m,
        )

    def _step_s(self, stamp_ns: int) -> float:
        if self._last_stamp_ns is None or stamp_ns <= self._last_stamp_ns:
            return self.first_dt_s
        return (stamp_ns - self._last_stamp_ns) / NANOSECONDS_PER_SECOND

    def reset(self) -> None:
        """Bring the gel to rest, with no indenter near it; a session of effects begins anew."""
        self._effects.restart()
        self.begin_anew()

    def begin_anew(self) -> None:
        """Bring the gel to rest, with no indenter near it; the time of the session goes on."""
        self._forget_force()
        self._last_stamp_ns = None
        self._is_broken = self._is_behind = False
        self._at = self._commanded = None
        self._rest(None)

    def relax(self) -> SensorMoment:
        """Bring the gel to rest beside an indenter that does not touch it; return what is seen.

        Where it is and where it is led to stay as they are; the time of the session goes on.
        """
        self._rest(self.moment.pose)
        return self.moment

    def _rest(self, pose: Pose | None) -> None:
        """Take what a gel without memory looks like untouched, an indenter being at a pose."""
        self._sensor.reset()
        self._effects.begin()
        gel = self._sensor.press(None, self.first_dt_s)
        self._force_n = gel.wrench.force_n
        camera = self._effects.camera(None, self.first_dt_s)
        self.moment = SensorMoment(self._sensor, gel, pose, camera)
        self._sensor.reset()

    def _forget_force(self) -> None:
        if self._drive is not None:
            self._drive.forget()

    def change_indenter(self, indenter: Indenter) -> None:
        """Press with another indenter from now on, from rest.

        Raises:
            ValueError: the sensor refuses it; the one before stays.
        """
        self._sensor.set_indenter(indenter)
        self.begin_anew()

    def change_solver(
        self, solver: SolverSpecification, *, limit_m: float, largest_jump_m: float
    ) -> float:
        """Solve the next frames otherwise, from where the gel is; return how far the skin jumps.

        Args:
            solver: for the next frames.
            limit_m: how far the indenter may move in contact in one of them.
            largest_jump_m: as `TactileSensor.set_solver`.

        Raises:
            SkinJumpError: the skin would jump farther; solver and limit stay.
            ValueError: the gel cannot hand over what it remembers.
        """
        jump_m = self._sensor.set_solver(solver, largest_jump_m=largest_jump_m)
        self._limit_m = limit_m
        return jump_m

    def is_touched(self) -> bool:
        """Return whether the last frame shows a contact."""
        return bool(np.any(self.moment.gel.wrench.force_n != 0.0))
