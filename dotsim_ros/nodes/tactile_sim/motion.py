# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""From poses and velocities to motions that the sensor can be asked to follow. Needs no ROS."""

from __future__ import annotations

from dataclasses import dataclass
from threading import Lock

import numpy as np

from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.twist import TwistFrame, advance
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import value_text
from dotsim_ros.nodes.common.ingest import Fault, RefusedInputError

NANOSECONDS_PER_SECOND = 1_000_000_000
FARTHEST_M = 10.0
"""An indenter that is farther away is none of this sensor's."""
LARGEST_SPEED_M_S, LARGEST_RATE_RAD_S = 100.0, 1000.0
HELD_MOTIONS = 1000
"""Of one frame: a second at 1 kHz."""


@dataclass(frozen=True)
class MotionOrder:
    """A checked pose of the indenter.

    Attributes:
        pose: in the base frame.
        stamp_ns: its time.
        new_start: why what came before does not lead here, or None where it does.
        reason: the same in words.
    """

    pose: Pose
    stamp_ns: int
    new_start: Fault | None
    reason: str = ""


class MotionGate:
    """Decides whether a pose continues from the last one, starts again, or is refused.

    Args:
        base_frame: the only frame that poses may be in.
        maximum_jump_m: poses further apart are a new start.
        maximum_step_s: stamps that go back further are a new start.
    """

    def __init__(self, *, base_frame: str, maximum_jump_m: float, maximum_step_s: float) -> None:
        self._base_frame = base_frame
        self.maximum_jump_m = maximum_jump_m
        self.maximum_step_s = maximum_step_s
        self._last: MotionOrder | None = None

    def forget(self) -> None:
        """Let the next pose be a start, wherever and whenever it is."""
        self._last = None

    def stamp_of_now(self, now_ns: int) -> int:
        """Return the stamp of a pose that is meant for now: after the last one, though a simulated
        clock stands still between its ticks; where it has gone back to a new start, its own."""
        return after_last(
            now_ns,
            None if self._last is None else self._last.stamp_ns,
            maximum_step_s=self.maximum_step_s,
        )

    def check(self, pose: Pose, *, frame_id: str) -> None:
        """Refuse what is wrong whatever came before.

        Raises:
            RefusedInputError: another frame, or a place where no indenter is.
        """
        if frame_id != self._base_frame:
            raise RefusedInputError(
                Fault.FRAME,
                f"frame_id of the pose is {value_text(frame_id)}, expected {self._base_frame!r}: "
                "transform poses into the sensor's base frame, or set the parameter base_frame",
            )
        if np.abs(pose.position_m).max() > FARTHEST_M:
            raise RefusedInputError(
                Fault.NUMBERS,
                f"the indenter would be at {pose.position_m.tolist()} m, expected within "
                f"{FARTHEST_M:g} m of the sensor; is it in millimetres?",
            )

    def hear(self, pose: Pose, stamp_ns: int, *, frame_id: str) -> MotionOrder:
        """Return the motion to a pose.

        Raises:
            RefusedInputError: as `check`, or a stamp that is not after the last one. What was
                received before stays in force.
        """
        self.check(pose, frame_id=frame_id)
        self._last = MotionOrder(pose, stamp_ns, *self._new_start(pose, stamp_ns))
        return self._last

    def _new_start(self, pose: Pose, stamp_ns: int) -> tuple[Fault | None, str]:
        last = self._last
        if last is None:
            return None, ""
        step_s = (stamp_ns - last.stamp_ns) / NANOSECONDS_PER_SECOND
        if step_s < -self.maximum_step_s:
            return Fault.RESTART, (
                f"the clock of the poses went back by {-step_s:.3f} s, more than maximum_step_s, "
                f"{self.maximum_step_s:g} s: a new start from rest"
            )
        if step_s <= 0.0:
            raise RefusedInputError(
                Fault.ORDER,
                f"the pose is stamped {-step_s:.6f} s before the last one, expected after it"
                if step_s
                else "the pose has the stamp of the last one, expected a later one: stamp each",
            )
        jump_m = float(np.linalg.norm(pose.position_m - last.pose.position_m))
        if jump_m <= self.maximum_jump_m:
            return None, ""
        return Fault.JUMP, (
            f"the indenter jumped by {jump_m:.4f} m in {step_s:.3f} s, more than maximum_jump_m, "
            f"{self.maximum_jump_m:g} m: a new start from rest, not a motion through what lies "
            "between"
        )


def after_last(now_ns: int, last_ns: int | None, *, maximum_step_s: float) -> int:
    """Return the time of a message that is meant for now and comes after one that was stamped
    `last_ns`: the clock may stand still since then, or have gone back to begin again."""
    if last_ns is None or last_ns - now_ns > maximum_step_s * NANOSECONDS_PER_SECOND:
        return now_ns
    return max(now_ns, last_ns + 1)


class MotionQueue:
    """Holds the motions since the last frame, between the thread that receives and the one that
    simulates: a bounded number of them, the newest always.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._motions: list[MotionOrder] = []

    def put(self, motion: MotionOrder) -> None:
        """Add a motion; nothing before a new start counts."""
        with self._lock:
            if motion.new_start is not None:
                self._motions.clear()
            elif len(self._motions) >= HELD_MOTIONS:
                # Every second one is left out, but for the first, which may be a new start.
                del self._motions[1::2]
            self._motions.append(motion)

    def take(self) -> list[MotionOrder]:
        """Return what is held, the oldest first, once."""
        with self._lock:
            motions, self._motions = self._motions, []
        return motions


@dataclass(frozen=True)
class Velocity:
    """A velocity of the indenter's origin.

    Attributes:
        linear_m_s: (3,).
        angular_rad_s: (3,).
        along: the axes of both.

    Raises:
        ValueError: it is beyond anything that moves an indenter.
    """

    linear_m_s: FloatArray
    angular_rad_s: FloatArray
    along: TwistFrame

    def __post_init__(self) -> None:
        linear, angular = np.abs(self.linear_m_s).max(), np.abs(self.angular_rad_s).max()
        if not (linear <= LARGEST_SPEED_M_S and angular <= LARGEST_RATE_RAD_S):
            raise ValueError(
                f"the velocity is {self.linear_m_s.tolist()} m/s and "
                f"{self.angular_rad_s.tolist()} rad/s, expected at most {LARGEST_SPEED_M_S:g} and "
                f"{LARGEST_RATE_RAD_S:g}; is it in millimetres or degrees?"
            )

    def moved(self, pose: Pose, duration_s: float) -> Pose:
        """Return the pose after some time at this velocity."""
        return advance(
            pose, self.linear_m_s, self.angular_rad_s, duration_s=duration_s, along=self.along
        )


def velocity_axes(frame_id: str, *, base_frame: str, indenter_frame: str) -> TwistFrame:
    """Return the axes that a velocity's frame_id means.

    Raises:
        RefusedInputError: neither the base frame nor the indenter's.
    """
    if frame_id == base_frame:
        return TwistFrame.PARENT
    if frame_id == indenter_frame:
        return TwistFrame.OWN
    raise RefusedInputError(
        Fault.FRAME,
        f"frame_id of the velocity is {value_text(frame_id)}, expected {base_frame!r} or "
        f"{indenter_frame!r}",
    )
