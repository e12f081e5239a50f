# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What tactile_sim offers by a name or parameter of its own: a velocity without a stamp, the depth
as a range, and the idle image."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Twist
from harness import Client, sensor
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


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    with sensor(**PARAMETERS) as (_, client):
        yield client


def camera() -> Camera:
    return Camera.from_specification(load_sensor("densetact2").camera)


def test_the_idle_image_is_kept_for_late_readers(client: Client) -> None:
    assert client.call(Trigger, "/tactile_sim/calibrate_idle").success
    idle = client.heard_late(Image, "/tactile_sim/idle_image")
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
