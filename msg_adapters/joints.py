# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""sensor_msgs/JointState as vectors; other lengths, missing joints and numbers that are not finite
are refused by ValueError."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msg_adapters.checks import finite_vector
from msg_adapters.stamps import encode_header
from msg_adapters.types import ROS, Message, MessageTypes


def encode_joint_state(
    names: Sequence[str],
    positions_rad: ArrayLike,
    velocities_rad_s: ArrayLike,
    *,
    stamp_ns: int,
    frame_id: str,
    types: MessageTypes = ROS,
) -> Message:
    """Return a sensor_msgs/JointState of J names, (J,) positions and (J,) velocities, without
    efforts."""
    count = len(names)
    return types.make(
        "sensor_msgs/msg/JointState",
        header=encode_header(stamp_ns, frame_id, types=types),
        name=list(names),
        position=types.doubles(finite_vector(positions_rad, count, "joint positions")),
        velocity=types.doubles(finite_vector(velocities_rad_s, count, "joint velocities")),
        effort=types.doubles(np.zeros(0)),
    )


def decode_joint_state(
    message: Message, names: Sequence[str]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the (J,) positions (rad) and velocities (rad/s) of the named joints, in that order."""
    present = list(message.name)
    missing = [name for name in names if name not in present]
    if missing:
        raise ValueError(f"the joint state lacks {', '.join(missing)}; it has {', '.join(present)}")
    order = [present.index(name) for name in names]
    positions = finite_vector(message.position, len(present), "joint positions")
    velocities = finite_vector(message.velocity, len(present), "joint velocities")
    return positions[order], velocities[order]
