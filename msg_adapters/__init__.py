# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Messages of ROS 2 as NumPy arrays and back: pure functions, no node, no copy where possible.

Encoders make messages of the installed ROS by default, and of a bag's type store with
`types=BagTypes(store.types)`. Decoders read both. Times are integers of nanoseconds. Bad input
raises ValueError that says what was wrong and what was expected.
"""

from msg_adapters.camera_info import (
    EQUIDISTANT,
    PLUMB_BOB,
    CameraCalibration,
    calibration_of,
    decode_camera_info,
    encode_calibration,
    encode_camera_info,
)
from msg_adapters.cloud import Cloud, decode_cloud, decode_cloud_fields, encode_cloud
from msg_adapters.diagnostics import Level, Status, decode_diagnostics, encode_diagnostics
from msg_adapters.image import (
    compressed_image_size,
    decode_compressed_image,
    decode_image,
    decode_rgb,
    encode_compressed_image,
    encode_image,
)
from msg_adapters.joints import decode_joint_state, encode_joint_state
from msg_adapters.rigid import (
    decode_odometry,
    decode_pose_stamped,
    decode_transform,
    decode_twist,
    decode_twist_stamped,
    decode_wrench_stamped,
    encode_entity_wrench,
    encode_pose_stamped,
    encode_twist,
    encode_twist_stamped,
    encode_wrench_stamped,
)
from msg_adapters.stamps import (
    decode_stamp,
    encode_header,
    encode_stamp,
    message_stamp_ns,
    serialized_stamp_ns,
)
from msg_adapters.types import ROS, BagTypes, Message, MessageTypes, RosTypes, message_class
from msg_adapters.xarm import RobotState, decode_robot_state, encode_move_velocity

__all__ = [
    "EQUIDISTANT",
    "PLUMB_BOB",
    "ROS",
    "BagTypes",
    "CameraCalibration",
    "Cloud",
    "Level",
    "Message",
    "MessageTypes",
    "RobotState",
    "RosTypes",
    "Status",
    "calibration_of",
    "compressed_image_size",
    "decode_camera_info",
    "decode_cloud",
    "decode_cloud_fields",
    "decode_compressed_image",
    "decode_diagnostics",
    "decode_image",
    "decode_joint_state",
    "decode_odometry",
    "decode_pose_stamped",
    "decode_rgb",
    "decode_robot_state",
    "decode_stamp",
    "decode_transform",
    "decode_twist",
    "decode_twist_stamped",
    "decode_wrench_stamped",
    "encode_calibration",
    "encode_camera_info",
    "encode_cloud",
    "encode_compressed_image",
    "encode_diagnostics",
    "encode_entity_wrench",
    "encode_header",
    "encode_image",
    "encode_joint_state",
    "encode_move_velocity",
    "encode_pose_stamped",
    "encode_stamp",
    "encode_twist",
    "encode_twist_stamped",
    "encode_wrench_stamped",
    "message_class",
    "message_stamp_ns",
    "serialized_stamp_ns",
]
