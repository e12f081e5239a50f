# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Measured presses, and what a model predicts for them: the currency of models and tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray, IntArray

if TYPE_CHECKING:
    # With it come all that bags are read with, which a node that simulates has no use for.
    from dotsim_ros.data.trajectory import Trajectory

SAME_DELAY_S = 1e-3
"""Delays that differ by less are one delay of a whole channel."""
LARGEST_COORDINATE_M = 1.0
"""A tactile sensor and what presses it are smaller; more is a length in millimetres."""


@dataclass(frozen=True)
class Press:
    """What was measured while one indenter pressed the sensor, F frames.

    Attributes:
        name: of its trajectory.
        indenter: name of the indenter.
        poses: F poses of the indenter's frame (tip, +z out of the gel) in the base frame.
        stamp_s: (F,) increasing.
        skin_position_m: (F, V, 3) of the data set's skin vertices, base frame; None: not measured.
        force_n: (F, 3) of the gel on the indenter, base frame; None: not measured.

    Raises:
        ValueError: no frame, an array of another length, times that do not increase, numbers that
            are not finite, or lengths that are no metres.
    """

    name: str
    indenter: str
    poses: list[Pose]
    stamp_s: FloatArray
    skin_position_m: FloatArray | None = None
    force_n: FloatArray | None = None

    def __post_init__(self) -> None:
        count = len(self.poses)
        if count == 0 or self.stamp_s.shape != (count,):
            raise ValueError(f"{self.name}: {count} poses and stamps of {self.stamp_s.shape}")
        falls = np.flatnonzero(~(np.diff(self.stamp_s) > 0.0))
        if falls.size:
            raise ValueError(
                f"{self.name}: frame {falls[0] + 1} is not later than the one before; record "
                "increasing stamps"
            )
        _check_lengths(self.name, "pose", np.stack([pose.position_m for pose in self.poses]))
        if self.skin_position_m is not None:
            if self.skin_position_m.ndim != 3 or self.skin_position_m.shape[::2] != (count, 3):
                raise ValueError(
                    f"{self.name}: skin of shape {self.skin_position_m.shape}, expected "
                    f"({count}, V, 3)"
                )
            _check_lengths(self.name, "skin", self.skin_position_m)
        if self.force_n is not None:
            if self.force_n.shape != (count, 3):
                raise ValueError(
                    f"{self.name}: forces of shape {self.force_n.shape}, expected ({count}, 3)"
                )
            _check_finite(self.name, "wrench", self.force_n)

    @property
    def frame_count(self) -> int:
        """Number of frames F."""
        return len(self.poses)


@dataclass(frozen=True)
class Prediction:
    """What a model predicts for the F frames of a press.

    Attributes:
        skin_position_m: (F, V, 3) of the measured skin's vertices, base frame.
        force_n: (F, 3) of the gel on the indenter, base frame; None where a model has no force.
    """

    skin_position_m: FloatArray
    force_n: FloatArray | None = None


class Model(Protocol):
    """A simulator of the gel's surface."""

    @property
    def name(self) -> str:
        """How tables call it."""

    def predict(self, press: Press, indenter: Indenter, skin: SkinMesh) -> Prediction:
        """Return the skin, and the force where it has one, at the poses of a press.

        Nothing of the press is read but its poses and stamps.

        Args:
            press: the poses.
            indenter: the shape that presses.
            skin: the measured skin at rest.
        """


def _check_finite(name: str, channel: str, values: FloatArray) -> None:
    bad = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
    if bad.size:
        raise ValueError(
            f"{name}, {channel}, frame {bad[0]}: a number is not finite; leave such frames out of "
            "the recording"
        )


def _check_lengths(name: str, channel: str, position_m: FloatArray) -> None:
    _check_finite(name, channel, position_m)
    largest = np.abs(position_m).reshape(len(position_m), -1).max(axis=1)
    bad = np.flatnonzero(largest > LARGEST_COORDINATE_M)
    if bad.size:
        raise ValueError(
            f"{name}, {channel}, frame {bad[0]}: a coordinate is {largest[bad[0]]:.4g} m from the "
            "base, expected metres: were these millimetres?"
        )


def _stamps_differ(channel: str, stamp_ns: IntArray, pose_ns: IntArray) -> str:
    if len(stamp_ns) == len(pose_ns):
        later_s = 1e-9 * (stamp_ns - pose_ns).astype(np.float64)
        if float(np.ptp(later_s)) < SAME_DELAY_S:
            return (
                f"every stamp of the {channel} is {abs(later_s[0]):.3g} s "
                f"{'after' if later_s[0] > 0.0 else 'before'} that of its pose, expected equal "
                "stamps: two clocks, or one channel stamped when it was received; stamp all by one "
                "clock, when they are measured"
            )
    return (
        f"{len(stamp_ns)} stamps of the {channel} differ from the {len(pose_ns)} of the pose, "
        "expected equal stamps; record one pose with each, interpolated to its time if need be"
    )


def press_of(trajectory: Trajectory, *, name: str, indenter: str) -> Press:
    """Return a trajectory as a press.

    Args:
        trajectory: its pose, and skin and wrench with the same stamps where it has them.
        name: of the press.
        indenter: name of its indenter.

    Raises:
        ValueError: it has no poses, or skin and wrench are stamped otherwise; or as `Press`.
    """
    pose = trajectory.pose
    if pose is None:
        raise ValueError(
            f"{name}: no pose of the indenter; record it as geometry_msgs/PoseStamped, or name its "
            "topic"
        )
    for channel_name in ("skin", "wrench"):
        channel = trajectory.channels().get(channel_name)
        if channel is not None and not np.array_equal(channel.stamp_ns, pose.stamp_ns):
            raise ValueError(
                f"{name}: {_stamps_differ(channel_name, channel.stamp_ns, pose.stamp_ns)}"
            )
    skin, wrench = trajectory.skin, trajectory.wrench
    return Press(
        name=name,
        indenter=indenter,
        poses=pose.poses(),
        stamp_s=1e-9 * pose.stamp_ns.astype(np.float64),
        skin_position_m=None if skin is None else skin.position_m.astype(np.float64),
        force_n=None if wrench is None else wrench.force_n,
    )
