# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which force holds at which pose, by their stamps. Needs no ROS."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from threading import Lock

import numpy as np

from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import value_text
from dotsim_ros.nodes.common.ingest import Fault, RefusedInputError
from dotsim_ros.nodes.tactile_sim.motion import (
    NANOSECONDS_PER_SECOND,
    MotionOrder,
    after_last,
)

ABOUT_ZERO_N = 0.05
"""A gauge at rest shows forces of either sign up to here; below minus this the sign is wrong."""
LARGEST_N = 1000.0
HELD_COUNT = 10_000
"""Poses, or forces, that wait for the others of their time."""


@dataclass(frozen=True)
class ForceOrder:
    """A force that the gel is to give on the indenter.

    Attributes:
        force_n: (3,).
        stamp_ns: its time.
        is_own: along the indenter's axes; else along those of the base frame.
    """

    force_n: FloatArray
    stamp_ns: int
    is_own: bool

    def normal_n(self, pose: Pose) -> float:
        """Return its share along the +z axis of an indenter at a pose, 0 for noise about zero.

        Raises:
            RefusedInputError: it pulls.
        """
        normal_n = float(self.force_n[2] if self.is_own else self.force_n @ pose.rotation()[:, 2])
        if normal_n < -ABOUT_ZERO_N:
            raise RefusedInputError(
                Fault.NUMBERS,
                f"the normal force is {normal_n:.3f} N along the indenter's z axis, expected 0 or "
                "more: the gel pushes the indenter away, along its +z; turn the sign, or the frame",
            )
        return max(normal_n, 0.0)


def checked_force(
    force_n: FloatArray, stamp_ns: int, frame_id: str, *, base_frame: str, indenter_frame: str
) -> ForceOrder:
    """Return a force (3,) that makes sense by itself.

    Raises:
        RefusedInputError: another frame, or a force that is none of a gel's.
    """
    if frame_id not in (base_frame, indenter_frame):
        raise RefusedInputError(
            Fault.FRAME,
            f"frame_id of the force is {value_text(frame_id)}, expected {base_frame!r} or "
            f"{indenter_frame!r}",
        )
    if np.abs(force_n).max() > LARGEST_N:
        raise RefusedInputError(
            Fault.NUMBERS,
            f"the force is {force_n.tolist()} N, expected at most {LARGEST_N:g} N; is it in grams "
            "or millinewtons?",
        )
    return ForceOrder(force_n, stamp_ns, frame_id == indenter_frame)


Time = tuple[int, int]
"""How often time had begun again on a topic, and a stamp (ns)."""


class ForcePairing:
    """Holds forces and poses until it is known which of them belong together.

    At a pose the newest force counts that is not stamped after it, which is known once a force of
    the same stamp or a later one has come, in whatever order the messages arrive. So the same
    messages always give the same pairs.

    Args:
        maximum_step_s: stamps of forces that go back further begin again, as those of poses do.

    Attributes:
        normal_n: normal force that is asked for; 0 before the first.
    """

    def __init__(self, *, maximum_step_s: float) -> None:
        self.maximum_step_s = maximum_step_s
        self._lock = Lock()
        self.forget()

    def forget(self) -> None:
        """Begin again: nothing is held, and the next stamps may be any."""
        with self._lock:
            self._motions: deque[tuple[Time, MotionOrder]] = deque()
            self._forces: deque[tuple[Time, ForceOrder]] = deque(maxlen=HELD_COUNT)
            self._motion_epoch = self._force_epoch = 0
            self._last_force_ns: int | None = None
            self._valid: ForceOrder | None = None
            self.normal_n = 0.0

    def stamp_of_now(self, now_ns: int) -> int:
        """Return the stamp of a force that is meant for now: see `MotionGate.stamp_of_now`."""
        with self._lock:
            return after_last(now_ns, self._last_force_ns, maximum_step_s=self.maximum_step_s)

    def put_force(self, force: ForceOrder) -> None:
        """Take a force.

        Raises:
            RefusedInputError: its stamp is not after the last one's.
        """
        with self._lock:
            if self._last_force_ns is not None:
                step_s = (force.stamp_ns - self._last_force_ns) / NANOSECONDS_PER_SECOND
                if step_s < -self.maximum_step_s:
                    self._force_epoch += 1
                elif step_s <= 0.0:
                    raise RefusedInputError(
                        Fault.ORDER,
                        f"the force is stamped {-step_s:.6f} s before the last one, expected after "
                        "it"
                        if step_s
                        else "the force has the stamp of the last one, expected a later one: stamp "
                        "each",
                    )
            self._last_force_ns = force.stamp_ns
            self._forces.append(((self._force_epoch, force.stamp_ns), force))

    def put_motion(self, motion: MotionOrder) -> None:
        """Take a motion, to be paired.

        Raises:
            RefusedInputError: too many wait for a force already.
        """
        with self._lock:
            if motion.new_start is Fault.RESTART:
                self._motion_epoch += 1
            if len(self._motions) >= HELD_COUNT:
                raise RefusedInputError(
                    Fault.ORDER,
                    f"{HELD_COUNT} poses wait for a force of their time or later: send forces on "
                    "indenter/wrench, stamped by the clock of the poses",
                )
            self._motions.append(((self._motion_epoch, motion.stamp_ns), motion))

    def next_pair(self) -> MotionOrder | None:
        """Return the next motion whose force is known, which holds from now on; None where there is
        none."""
        with self._lock:
            if not self._motions:
                return None
            due, motion = self._motions[0]
            if not self._forces or self._forces[-1][0] < due:
                return None
            while self._forces and self._forces[0][0] <= due:
                _, self._valid = self._forces.popleft()
            self._motions.popleft()
            return motion

    def take_newest(self) -> None:
        """Let the newest force hold from now on, whatever its stamp."""
        with self._lock:
            if self._forces:
                _, self._valid = self._forces[-1]
                self._forces.clear()

    def weigh(self, pose: Pose) -> None:
        """Let `normal_n` be that of the force that holds, on an indenter at a pose.

        Raises:
            RefusedInputError: the force pulls; it is left out, and `normal_n` stays.
        """
        with self._lock:
            if self._valid is None:
                return
            try:
                self.normal_n = self._valid.normal_n(pose)
            except RefusedInputError:
                self._valid = None
                raise

    def waiting(self) -> tuple[int, int] | None:
        """Return how many poses wait for a force, and the stamp of the first; None for none."""
        with self._lock:
            if not self._motions:
                return None
            return len(self._motions), self._motions[0][1].stamp_ns
