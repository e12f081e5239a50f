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

from dotsim_ros.gel.implicit.gel import LARGEST_SUBSTEP_M
from dotsim_ros.geometry.indenter import way_m
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import vertex_normals
from dotsim_ros.io import tracing
from dotsim_ros.io.arrays import FloatArray, ImageArray
from dotsim_ros.nodes.common.ingest import Fault, RefusedInputError
from dotsim_ros.nodes.tactile_sim.live_effects import LiveEffects
from dotsim_ros.nodes.tactile_sim.motion import NANOSECONDS_PER_SECOND, MotionOrder
from dotsim_ros.nodes.tactile_sim.pursuit import (
    TOUCH_M,
    CommandedPath,
    Move,
    clear_of_gel,
)
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
    """The gel under an indenter at a pose, and what the camera sees of it, rendered on demand; a
    `camera` returns what effects make of a frame's image."""

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
                with tracing.span("effects"):
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
            several frames, along the path of the commanded poses. Infinite for none.
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
        self._path = CommandedPath(way_m=self._way_m, depth_m=self._depth_m)
        self.behind = 0
        self._lag_m = self._largest_lag_m = 0.0
        self._ordered_ns: int | None = None
        self._last_stamp_ns: int | None = None
        self._is_broken = False
        self._force_n = np.zeros(3)
        self.moment = self._pressed(None, first_dt_s, before_m=None)

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

    def order(self, motion: MotionOrder) -> None:
        """Take the next pose that the indenter is to go to; `advance` leads it there.

        Raises:
            RefusedInputError: the pose presses too deep, and a motion that is limited must not
                begin; the last frame stays, and the next motion starts from rest.
        """
        if motion.new_start is not None or self._is_broken:
            self._sensor.reset()
            self._effects.begin()
            self._forget_motion()
        self._ordered_ns = motion.stamp_ns
        if self._drive is None and not np.isinf(self._limit_m):
            try:
                self._sensor.check_depth(motion.pose)
            except ValueError as error:
                raise self._refusal(error) from error
        self._path.add(motion.pose)

    def follow(self, motion: MotionOrder) -> SensorMoment:
        """Simulate a motion, or as much of it as one frame may.

        Raises:
            RefusedInputError: the gel refuses the pose or cannot be solved; the last frame stays,
                and the next motion starts from rest.
        """
        self.order(motion)
        return self.advance()

    def advance(self, step_s: float | None = None) -> SensorMoment:
        """Go on along the poses that were ordered, or to the newest force; where both are reached,
        let a gel that remembers, or an effect, evolve under the held indenter. Errors as `follow`.

        `step_s` is the time since the frame before, by default `first_dt_s`; where a pose has been
        ordered since, its stamp gives it.
        """
        if self._path.newest is None or self._is_broken:
            return self.moment
        if self._ordered_ns is not None:
            step_s, self._last_stamp_ns = self._step_s(self._ordered_ns), self._ordered_ns
            self._ordered_ns = None
            return self._move(step_s)
        goes_on = not self._path.is_reached or self._sensor.remembers or self._effects.act_in_time
        is_followed = self._drive is None or self._drive.is_met(self._path.newest)
        if is_followed and not goes_on:
            return self.moment
        step_s = self.first_dt_s if step_s is None else step_s
        if self._last_stamp_ns is not None:
            self._last_stamp_ns += int(step_s * NANOSECONDS_PER_SECOND)
        return self._move(step_s)

    def take_largest_lag_m(self) -> float:
        """Return how far from the newest pose the indenter was at most in a frame, since this was
        asked for last; from any thread."""
        largest_m, self._largest_lag_m = self._largest_lag_m, self._lag_m
        return largest_m

    def _move(self, step_s: float) -> SensorMoment:
        before_m = None if self._path.here is None else self.moment.gel.skin_position_m
        try:
            move = self._next_move()
            pose = self._effects.moved(move.pose, self._force_n, step_s)
            self.moment = self._pressed(pose, step_s, before_m=before_m, move=move)
        except ValueError as error:
            raise self._refusal(error) from error
        self._is_broken = False
        if self._drive is not None:
            self._drive.answer(move.pose, self.moment.gel.wrench.force_n)
        if not self._path.is_reached:
            self.behind += 1
        self._lag_m = self._path.lag_m
        self._largest_lag_m = max(self._largest_lag_m, self._lag_m)
        return self.moment

    def _next_move(self) -> Move:
        if self._drive is None:
            return self._path.advance(self._limit_m)
        # One that waits for a force above the skin may be moved across at once.
        waits = not np.isinf(self._limit_m) and not np.any(self._force_n)
        move = self._path.advance(np.inf if waits else self._limit_m)
        pose, start = self._drive.pose(move.pose), None
        if waits or move.start is not None:
            start = clear_of_gel(pose, self._sensor.rest_depth_m)
        return Move(pose, start)

    def _pressed(
        self,
        pose: Pose | None,
        step_s: float,
        *,
        before_m: FloatArray | None,
        move: Move | None = None,
    ) -> SensorMoment:
        """Return the moment after a commanded move that effects, or a force, have made one to this
        pose, `step_s` after the frame whose skin was `before_m` (V, 3)."""
        way = [pose]
        if pose is not None and move is not None:
            shift_m = pose.position_m - move.pose.position_m
            if move.start is not None:
                self._put(_shifted(move.start, shift_m), pose)
            way = [*(_shifted(leg, shift_m) for leg in move.between), pose]
        for leg in way:
            gel = self._sensor.press(leg, step_s / len(way))
        self._force_n = gel.wrench.force_n
        return SensorMoment(
            self._sensor,
            self._effects.answered(gel, pose),
            pose,
            self._effects.camera(before_m, step_s),
        )

    def _put(self, start: Pose, pose: Pose) -> None:
        """Put the indenter where the move to a pose begins. An effect may have it touch the gel
        there: then it goes on from where it is, or where that is far, comes from outside."""
        depth_m, before = self._sensor.rest_depth_m, self.moment.pose
        if depth_m(start) > -0.5 * TOUCH_M:
            indenter = self._sensor.indenter
            if before is not None and way_m(before, pose, indenter) <= LARGEST_SUBSTEP_M:
                return
            start = clear_of_gel(start, depth_m)
        self._sensor.place(start)

    def _refusal(self, error: ValueError) -> RefusedInputError:
        """Let the next motion start from rest; return why this one was not made."""
        self._is_broken = True
        fault = Fault.FAILURE if isinstance(error, GelFailureError) else Fault.GEL
        return RefusedInputError(fault, str(error))

    def _way_m(self, start: Pose, end: Pose) -> float:
        """Return how far the indenter moves from one commanded pose to another."""
        if self._drive is not None:
            # What they say along its axis is not used.
            axis, shift_m = end.rotation()[:, 2], end.position_m - start.position_m
            end = _shifted(end, -(shift_m @ axis) * axis)
        return way_m(start, end, self._sensor.indenter)

    def _depth_m(self, pose: Pose) -> float:
        # Under a force the indenter is in contact wherever it is, and equally deep.
        return 0.0 if self._drive is not None else self._sensor.rest_depth_m(pose)

    def _step_s(self, stamp_ns: int) -> float:
        if self._last_stamp_ns is None or stamp_ns <= self._last_stamp_ns:
            return self.first_dt_s
        return (stamp_ns - self._last_stamp_ns) / NANOSECONDS_PER_SECOND

    def reset(self) -> None:
        """Bring the gel to rest, with no indenter near it; a session of effects begins again."""
        self._effects.restart()
        self.restart()

    def restart(self) -> None:
        """Bring the gel to rest, with no indenter near it; the time of the session goes on."""
        self._forget_motion()
        self._rest(None)

    def relax(self) -> SensorMoment:
        """Bring the gel to rest next to an indenter that does not touch it and stays on its way;
        return what is seen. The time of the session goes on."""
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

    def _forget_motion(self) -> None:
        self._path.forget()
        self._lag_m = 0.0
        self._ordered_ns = self._last_stamp_ns = None
        self._is_broken = False
        self._force_n = np.zeros(3)
        if self._drive is not None:
            self._drive.forget()

    def change_indenter(self, indenter: Indenter) -> None:
        """Press with another indenter from now on, from rest.

        Raises:
            ValueError: the sensor refuses it; the one before stays.
        """
        self._sensor.set_indenter(indenter)
        self.restart()

    def change_solver(
        self, solver: SolverSpecification, *, limit_m: float, largest_jump_m: float
    ) -> float:
        """Solve the next frames by another solver and with another limit, from where the gel is;
        return how far the skin jumps.

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


def _shifted(pose: Pose, shift_m: FloatArray) -> Pose:
    return Pose(pose.position_m + shift_m, pose.quaternion_xyzw)
