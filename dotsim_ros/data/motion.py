# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Motions of an indenter: poses at times, sampled at any rate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from dotsim_ros.geometry.pose import Pose, interpolate
from dotsim_ros.io.arrays import FloatArray


@dataclass(frozen=True)
class Motion:
    """Poses of the indenter's frame in the base frame, at increasing times.

    Attributes:
        time_s: (K,) from the start; the first is 0.
        poses: K poses; between two of them the motion is linear, the rotation spherical-linear.

    Raises:
        ValueError: no pose, another number of times, or times that do not increase from 0.
    """

    time_s: FloatArray
    poses: tuple[Pose, ...]

    def __post_init__(self) -> None:
        times = np.array(self.time_s, dtype=np.float64)
        if times.ndim != 1 or len(times) != len(self.poses) or len(times) == 0:
            raise ValueError(
                f"a motion needs a time for each pose, got {times.shape} times for "
                f"{len(self.poses)} poses"
            )
        if times[0] != 0.0 or not (np.diff(times) > 0.0).all() or not np.isfinite(times).all():
            raise ValueError("the times of a motion must begin at 0 and increase")
        object.__setattr__(self, "time_s", times)

    @property
    def duration_s(self) -> float:
        """Time of the last pose."""
        return float(self.time_s[-1])

    def at(self, time_s: float) -> Pose:
        """Return the pose at a time; before the start the first, after the end the last."""
        if time_s <= 0.0:
            return self.poses[0]
        if time_s >= self.duration_s:
            return self.poses[-1]
        index = int(np.searchsorted(self.time_s, time_s, side="right")) - 1
        start, end = self.time_s[index], self.time_s[index + 1]
        return interpolate(
            self.poses[index], self.poses[index + 1], float((time_s - start) / (end - start))
        )

    def sampled(self, rate_hz: float) -> Iterator[tuple[float, Pose]]:
        """Yield (time in seconds, pose) at a constant rate, and at the very end.

        Raises:
            ValueError: the rate is not positive.
        """
        if not rate_hz > 0.0:
            raise ValueError(f"the rate must be positive, got {rate_hz} Hz")
        # The last steady sample must not fall within rounding of the end, which is yielded anyway.
        count = int(np.ceil(self.duration_s * rate_hz - 1e-6))
        for index in range(count):
            yield index / rate_hz, self.at(index / rate_hz)
        yield self.duration_s, self.poses[-1]

    def keyframes(self) -> Iterator[tuple[float, Pose]]:
        """Yield (time in seconds, pose) of the motion's own poses."""
        yield from zip(self.time_s.tolist(), self.poses, strict=True)


def at_speed(
    poses: Sequence[Pose], *, speed_m_s: float, rotation_rate_rad_s: float = np.pi
) -> Motion:
    """Return the motion through poses at a speed of the origin, or of rotation where slower.

    Poses that repeat the one before are dropped; use `joined` and `held` for pauses.

    Raises:
        ValueError: no pose, or a speed that is not positive.
    """
    if not (speed_m_s > 0.0 and rotation_rate_rad_s > 0.0):
        raise ValueError(
            f"speeds must be positive, got {speed_m_s} m/s and {rotation_rate_rad_s} rad/s"
        )
    if not poses:
        raise ValueError("a motion needs at least one pose")
    kept, times = [poses[0]], [0.0]
    for pose in poses[1:]:
        distance = float(np.linalg.norm(pose.position_m - kept[-1].position_m))
        angle = rotation_angle(kept[-1], pose)
        duration = max(distance / speed_m_s, angle / rotation_rate_rad_s)
        if duration > 1e-9:
            kept.append(pose)
            times.append(times[-1] + duration)
    return Motion(np.array(times), tuple(kept))


def rotation_angle(start: Pose, end: Pose) -> float:
    """Return the angle of the rotation between two poses, 0 to pi."""
    a, b = start.quaternion_xyzw, end.quaternion_xyzw
    b = b if a @ b >= 0.0 else -b
    # The chord is exact where the cosine of a small angle is not.
    return float(4.0 * np.arcsin(min(1.0, 0.5 * float(np.linalg.norm(a - b)))))


def held(pose: Pose, duration_s: float) -> Motion:
    """Return the motion that stays at a pose.

    Raises:
        ValueError: the duration is negative or not finite.
    """
    if not (np.isfinite(duration_s) and duration_s >= 0.0):
        raise ValueError(f"a hold must not be negative, got {duration_s} s")
    if duration_s == 0.0:
        return Motion(np.zeros(1), (pose,))
    return Motion(np.array([0.0, duration_s]), (pose, pose))


def joined(*motions: Motion) -> Motion:
    """Return motions one after the other; each begins where the one before ends.

    Raises:
        ValueError: a motion begins more than 1 um or 0.1 mrad from where the one before ends.
    """
    times, poses = [motions[0].time_s], list(motions[0].poses)
    end_s = motions[0].duration_s
    for before, after in pairwise(motions):
        gap = float(np.linalg.norm(after.poses[0].position_m - before.poses[-1].position_m))
        turn = rotation_angle(before.poses[-1], after.poses[0])
        if gap > 1e-6 or turn > 1e-4:
            raise ValueError(
                f"motions to be joined are {gap:.3g} m and {turn:.3g} rad apart; put a motion "
                "between them"
            )
        times.append(after.time_s[1:] + end_s)
        poses.extend(after.poses[1:])
        end_s += after.duration_s
    return Motion(np.concatenate(times), tuple(poses))


def reversed_motion(motion: Motion) -> Motion:
    """Return the motion backwards."""
    return Motion(motion.duration_s - motion.time_s[::-1], motion.poses[::-1])


def pose_along(origin_m: ArrayLike, axis: ArrayLike, *, spin_rad: float = 0.0) -> Pose:
    """Return the pose of a frame at `origin_m` (3,) whose +z points along `axis` (3,).

    The frame is turned by the smallest rotation from the base frame, then about its own z.

    Raises:
        ValueError: the axis has no length.
    """
    direction = np.asarray(axis, dtype=np.float64)
    length = float(np.linalg.norm(direction))
    if not length > 0.0:
        raise ValueError("the axis of a pose must have a length")
    x, y, z = direction / length
    off_axis = float(np.hypot(x, y))
    if z > -0.5:
        tilt = np.array([-y, x, 0.0, 1.0 + z])
        tilt /= np.linalg.norm(tilt)
    elif off_axis > 0.0:
        # 1 + z would lose its digits.
        half_rad = 0.5 * np.arctan2(off_axis, z)
        about = np.array([-y, x]) / off_axis
        tilt = np.array([*(np.sin(half_rad) * about), 0.0, np.cos(half_rad)])
    else:
        tilt = np.array([1.0, 0.0, 0.0, 0.0])
    sine, cosine = np.sin(spin_rad / 2.0), np.cos(spin_rad / 2.0)
    ax, ay, az, aw = tilt
    # The product of the tilt and (0, 0, sine, cosine).
    quaternion = np.array(
        [
            ax * cosine + ay * sine,
            ay * cosine - ax * sine,
            aw * sine + az * cosine,
            aw * cosine - az * sine,
        ]
    )
    origin = np.asarray(origin_m, dtype=np.float64)
    return Pose(origin, quaternion / np.linalg.norm(quaternion))
