# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What tactile_sim offers by a name or parameter of its own: a velocity without a stamp, the depth
as a range, the idle image, and the camera's pose on /tf_static."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Twist
from harness import BASE_FRAME, Client, sensor
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from message_packages import importable
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

import msg_adapters
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.specification import load_sensor

OPTICAL_FRAME = "densetact_optical_frame"
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PARAMETERS = {
    "twist_message": "Twist",
    "diagnostics_period_s": 0.1,
    # Nothing here depends on the rate or on the grid; a coarse one is made in a tenth of the time.
    "rate_hz": 10.0,
    "grid_spacing_m": 0.0048,
}
TF2_ROS = """
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage


class StaticTransformBroadcaster:
    def __init__(self, node):
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._publisher = node.create_publisher(TFMessage, "/tf_static", latched)

    def sendTransform(self, transform):
        self._publisher.publish(TFMessage(transforms=[transform]))
"""
"""What tf2_ros does for one transform, where it is not installed: no package index has it."""


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    """A client of a sensor, both with TF."""
    folder = tmp_path_factory.mktemp("tf")
    forget("tf2_msgs")
    with importable("tf2_msgs"), pytest.MonkeyPatch.context() as patch:
        if importlib.util.find_spec("tf2_ros") is None:
            (folder / "tf2_ros.py").write_text(TF2_ROS)
            patch.setenv("PYTHONPATH", str(folder), prepend=os.pathsep)
        with sensor(**PARAMETERS) as (_, client):
            yield client
    forget("tf2_msgs")


def forget(package: str) -> None:
    """Unload a package: what this process has still loaded counts as found, by others too."""
    for name in [each for each in sys.modules if each.partition(".")[0] == package]:
        del sys.modules[name]


def camera() -> Camera:
    return Camera.from_specification(load_sensor("densetact2").camera)


def heard_late(client: Client, kind: type, topic: str) -> Any:
    """Return what a reader hears that comes after the message was sent."""
    heard: list[Any] = []
    reader = client.node.create_subscription(kind, topic, heard.append, LATCHED)
    client.wait(lambda: heard, topic)
    client.node.destroy_subscription(reader)
    return heard[-1]


def test_the_idle_image_is_kept_for_late_readers(client: Client) -> None:
    assert client.call(Trigger, "/tactile_sim/calibrate_idle").success
    idle = heard_late(client, Image, "/tactile_sim/idle_image")
    assert (idle.header.frame_id, idle.encoding) == (OPTICAL_FRAME, "rgb8")
    at_rest = client.next_frame(lambda frame: not frame.force_n().any()).image()
    np.testing.assert_array_equal(msg_adapters.decode_image(idle), at_rest)
    assert at_rest.std() > 0.0


def test_the_depth_becomes_a_range_by_parameter(client: Client) -> None:
    axial_m = client.next_frame(lambda frame: True).depth_m()
    assert client.set_parameters(depth_convention="range").successful
    answered_ns = client.now_ns()
    # Frames of before may come after.
    range_m = client.next_frame(lambda frame: frame.stamp_ns > answered_ns).depth_m()
    assert client.set_parameters(depth_convention="z").successful
    along_axis = camera().rays()[0][..., 2]
    is_ahead = np.isfinite(axial_m)
    assert (along_axis[is_ahead] > 0.0).all()
    np.testing.assert_allclose((range_m * along_axis)[is_ahead], axial_m[is_ahead], atol=1e-7)
    # Beyond 90 degrees from the axis a fisheye sees the skin, and only a range says where.
    is_behind = along_axis < 0.0
    assert np.isfinite(range_m[is_behind]).any()
    assert not np.isfinite(axial_m[is_behind]).any()


def test_a_velocity_without_a_stamp_moves_the_indenter_along_the_base(client: Client) -> None:
    commands = client.node.create_publisher(Twist, "indenter/twist", 5)
    client.wait(lambda: commands.get_subscription_count() > 0, "the reader of velocities")
    twist = Twist()
    twist.linear.x, twist.linear.z = 0.002, -0.01

    def went_down() -> Any:
        commands.publish(twist)
        places_m = [frame.indenter_m() for frame in list(client.frames.values())]
        return next((at_m for at_m in places_m if at_m is not None and at_m[2] < 0.028), None)

    x_m, y_m, z_m = client.wait(went_down, "the indenter to move")
    # It begins 30 mm above the base.
    assert (x_m, y_m) == (pytest.approx(0.2 * (0.03 - z_m), abs=1e-9), 0.0)


def test_the_cameras_pose_is_on_tf_static_for_late_readers_unless_it_is_not_wanted(
    client: Client,
) -> None:
    kind = msg_adapters.message_class("tf2_msgs/msg/TFMessage")
    (placed,) = heard_late(client, kind, "/tf_static").transforms
    assert (placed.header.frame_id, placed.child_frame_id) == (BASE_FRAME, OPTICAL_FRAME)
    pose, at, turned = camera().pose, placed.transform.translation, placed.transform.rotation
    np.testing.assert_allclose((at.x, at.y, at.z), pose.position_m, atol=1e-12)
    quaternion = (turned.x, turned.y, turned.z, turned.w)
    assert abs(np.dot(quaternion, pose.quaternion_xyzw)) == pytest.approx(1.0, abs=1e-12)

    def change(label: str) -> None:
        transition = Transition(label=label)
        assert client.call(ChangeState, "/tactile_sim/change_state", transition=transition).success

    change("deactivate")
    change("cleanup")
    assert client.set_parameters(publish_tf=False).successful
    change("configure")
    change("activate")
    client.next_frame(lambda frame: True)
    client.wait(lambda: client.node.count_publishers("/tf_static") == 0, "no pose of the camera")
