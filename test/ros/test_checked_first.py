# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Of a message that is refused nothing is kept and nothing is done: the inputs of a node, whose
callbacks the tests call."""

from __future__ import annotations

import re
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from sensor_msgs.msg import CompressedImage
from sensor_msgs.srv import SetCameraInfo

import msg_adapters
from dotsim_ros.control.safety_layer.limits import Reason
from dotsim_ros.nodes.common.ingest import Fault, FaultLog, RefusedInputError
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.parameters import from_values
from dotsim_ros.nodes.tactile_policy.inputs import PolicyInputs
from dotsim_ros.nodes.tactile_policy.parameters import TactilePolicyParameters
from dotsim_ros.nodes.tactile_sim.camera_calibration import CalibrationStore
from dotsim_ros.nodes.tactile_sim.motion_input import MotionInput
from dotsim_ros.nodes.tactile_sim.parameters import TactileSimParameters

TICK_NS = 10_000_000
OPEN: list[Desk] = []
"""Nodes that read their topics until they are destroyed, also those of tests that follow."""


class Desk(WorkingNode):
    """A node whose callbacks a test calls; has a clock of its own."""

    def __init__(self) -> None:
        self.callbacks: dict[str, Any] = {}
        self.now_ns = time.time_ns()
        super().__init__("desk")
        OPEN.append(self)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, qos_profile: Any, **options: Any
    ) -> Any:
        self.callbacks[topic] = callback
        return super().create_subscription(msg_type, topic, callback, qos_profile, **options)

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, **options: Any) -> Any:
        self.callbacks[srv_name] = callback
        return super().create_service(srv_type, srv_name, callback, **options)

    def time_ns(self) -> int:
        return self.now_ns

    def hand_in(self, topic: str, message: Any) -> None:
        self.now_ns += TICK_NS
        self.callbacks[topic](message)


@pytest.fixture(autouse=True)
def ros() -> Generator[None, None, None]:
    rclpy.init()
    yield
    while OPEN:
        OPEN.pop().destroy_node()
    rclpy.shutdown()


def first_warning(capfd: pytest.CaptureFixture[str]) -> str:
    """Return what a node has logged first."""
    return re.findall(r"\[WARN\] \[[\d.]+\] \[desk\]: (.*)", capfd.readouterr().err)[0]


class Policy(Desk):
    """The inputs of `tactile_policy`, which have a pose at x = 0.3 m and a force of 1 N."""

    def __init__(self, **parameters: Any) -> None:
        super().__init__()
        self.latched: list[tuple[Reason, str]] = []
        given = from_values(
            TactilePolicyParameters, {"policy": "p", "force_limit_n": 2.0, **parameters}
        )
        self.inputs = PolicyInputs(self, given, latch=lambda *why: self.latched.append(why))
        self.hand_in("ee_pose", self.pose(0.3))
        self.hand_in("wrench", self.wrench(1.0))

    def stamp(self, message: Any, stamp_ns: int | None) -> Any:
        stamp_ns = self.now_ns + TICK_NS if stamp_ns is None else stamp_ns
        seconds, rest = divmod(stamp_ns, 10**9)
        message.header.stamp.sec, message.header.stamp.nanosec = seconds, rest
        return message

    def pose(self, x_m: float, *, stamp_ns: int | None = None, frame: str = "link_base") -> Any:
        message = PoseStamped()
        message.header.frame_id = frame
        message.pose.position.x = x_m
        message.pose.orientation.w = 1.0
        return self.stamp(message, stamp_ns)

    def wrench(self, force_n: float, *, stamp_ns: int | None = None, frame: str = "tool") -> Any:
        message = WrenchStamped()
        message.header.frame_id = frame
        message.wrench.force.z = force_n
        return self.stamp(message, stamp_ns)

    def known(self) -> tuple[float, float]:
        readings = self.inputs.readings(time.monotonic())
        assert readings.tool is not None
        return float(readings.tool.position_m[0]), readings.force_n


@pytest.fixture
def policy() -> Policy:
    return Policy()


POSES = {
    "stamp zero": {"stamp_ns": 0, "x_m": 10.0},
    "a negative stamp": {"stamp_ns": -(10**9), "x_m": 0.4},
    "another frame": {"frame": "world", "x_m": 0.4},
    "a place 350 m away": {"x_m": 350.0},
    "NaN": {"x_m": float("nan")},
}


@pytest.mark.fault("messages", "`tactile_policy` gets a pose that makes no sense")
@pytest.mark.parametrize("what", POSES)
def test_a_pose_that_is_refused_leaves_no_trace(
    policy: Policy, what: str, answered: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    count = policy.inputs.pose.count
    policy.hand_in("ee_pose", policy.pose(**POSES[what]))
    assert policy.known() == (0.3, 1.0)
    assert (policy.inputs.pose.count, policy.latched) == (count, [])
    assert policy.inputs.refused == 1
    answered(first_warning(capfd), what=f"`tactile_policy` gets a pose with {what}")


@pytest.mark.fault("messages", "`tactile_policy` gets 100 N with stamp zero")
def test_a_force_that_is_refused_leaves_no_trace(
    policy: Policy, answered: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    policy.hand_in("wrench", policy.wrench(100.0, stamp_ns=0))
    assert policy.known() == (0.3, 1.0)
    answered(first_warning(capfd))
    policy.hand_in("wrench", policy.wrench(float("inf")))
    assert policy.known() == (0.3, 1.0)
    # A force that comes as it should counts, however large.
    policy.hand_in("wrench", policy.wrench(1e200))
    assert policy.known()[1] > 1e150


def test_a_message_that_is_older_than_the_last_one_leaves_no_trace(policy: Policy) -> None:
    policy.hand_in("ee_pose", policy.pose(0.5, stamp_ns=policy.now_ns - TICK_NS))
    policy.hand_in("wrench", policy.wrench(100.0, stamp_ns=policy.now_ns - TICK_NS))
    assert policy.known() == (0.3, 1.0)
    assert policy.latched == []


@pytest.mark.fault("messages", "two force sensors send to `tactile_policy`")
def test_forces_of_another_frame_are_latched(policy: Policy, answered: Any) -> None:
    policy.hand_in("wrench", policy.wrench(1.0, frame="other"))
    ((reason, words),) = policy.latched
    assert reason is Reason.WRONG_SENSOR
    answered(words)


@pytest.mark.fault("messages", "a compressed image of 100 bytes announces 30000 x 30000 pixels")
def test_an_image_that_would_unpack_to_gigabytes_is_not_fresh(
    answered: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    policy = Policy(image_transport="compressed")
    size = (30000).to_bytes(4, "big") * 2
    bomb = b"\x89PNG\r\n\x1a\n" + b"\0\0\0\x0dIHDR" + size + bytes(76)
    for data in (bomb, b"\xff\xd8\xff", b"GIF89a", b""):
        message = policy.stamp(CompressedImage(data=data, format="rgb8; png"), None)
        policy.hand_in("image_raw/compressed", message)
    assert policy.inputs.image.count == 0
    assert policy.inputs.refused == 4
    answered(first_warning(capfd))
    good = np.zeros((40, 60, 3), np.uint8)
    for compression in ("png", "jpeg"):
        message = msg_adapters.encode_compressed_image(
            good, compression=compression, stamp_ns=policy.now_ns + TICK_NS, frame_id="camera"
        )
        assert msg_adapters.compressed_image_size(message) == (60, 40)
        policy.hand_in("image_raw/compressed", message)
    assert policy.inputs.image.count == 2


@pytest.fixture
def motion() -> tuple[Desk, MotionInput, FaultLog, list[Any]]:
    desk, motions = Desk(), []
    inputs = MotionInput(desk, TactileSimParameters(), on_motion=motions.append)
    return desk, inputs, inputs.faults, motions


def velocity(linear_m_s: float, *, frame: str = "densetact_base") -> TwistStamped:
    message = TwistStamped()
    message.header.frame_id = frame
    message.twist.linear.z = linear_m_s
    return message


def indenter_pose(x_m: float, *, frame: str = "densetact_base", sec: int = 1) -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id, message.header.stamp.sec = frame, sec
    message.pose.position.x = x_m
    message.pose.orientation.w = 1.0
    return message


@pytest.mark.parametrize(
    "broken",
    [
        indenter_pose(float("nan")),
        indenter_pose(0.0, frame="map"),
        indenter_pose(0.0, sec=-1),
        indenter_pose(15.75),
    ],
    ids=["NaN", "frame", "stamp", "millimetres"],
)
def test_a_broken_pose_does_not_silence_a_velocity(motion: Any, broken: PoseStamped) -> None:
    desk, inputs, faults, motions = motion
    desk.hand_in("indenter/pose", broken)
    desk.hand_in("indenter/twist", velocity(-0.01))
    inputs.integrate(desk.now_ns, 0.04)
    assert len(motions) == 1
    assert faults.counts()[Fault.BOTH] == 0
    assert sum(faults.counts().values()) == 1


@pytest.mark.fault("messages", "`tactile_sim` gets a velocity of 1e308 m/s")
def test_a_velocity_beyond_all_is_refused_and_the_one_before_stays(
    motion: Any, answered: Any
) -> None:
    desk, inputs, faults, motions = motion
    desk.hand_in("indenter/twist", velocity(-0.01))
    desk.hand_in("indenter/twist", velocity(1e308))
    for _ in range(3):
        inputs.integrate(desk.time_ns(), 0.04)
        desk.now_ns += TICK_NS
    heights = [order.pose.position_m[2] for order in motions]
    np.testing.assert_allclose(np.diff(heights), -0.0004)
    answered(faults.last_reason)


@pytest.mark.parametrize("topic", ["indenter/pose", "indenter/wrench"])
def test_messages_of_stamp_zero_are_all_taken_while_a_clock_stands(topic: str) -> None:
    desk, motions = Desk(), []
    parameters = from_values(TactileSimParameters, {"control": "force"})
    faults = MotionInput(desk, parameters, on_motion=motions.append).faults
    for index in range(5):
        force = WrenchStamped()
        force.header.frame_id = "indenter"
        pose = indenter_pose(1e-4 * index, sec=0)
        desk.callbacks[topic](pose if topic == "indenter/pose" else force)
    assert sum(faults.counts().values()) == 0, faults.last_reason
    if motions:
        assert [order.pose.position_m[0] for order in motions] == [1e-4 * k for k in range(5)]
        assert set(np.diff([order.stamp_ns for order in motions])) == {1}
        # A clock that begins again is not held up by what was stamped before.
        desk.now_ns -= 10**10
        desk.callbacks[topic](indenter_pose(0.0, sec=0))
        assert motions[-1].new_start is Fault.RESTART
        assert motions[-1].stamp_ns == desk.now_ns


def test_the_time_of_a_velocity_counts_once_whatever_becomes_of_the_motion() -> None:
    desk, heights_mm = Desk(), []

    def press(order: Any) -> None:
        heights_mm.append(1e3 * order.pose.position_m[2])
        if heights_mm[-1] < 28.5:
            raise RefusedInputError(Fault.GEL, "too deep")

    parameters = from_values(TactileSimParameters, {"clock": "lockstep", "input": "twist"})
    faults = MotionInput(desk, parameters, on_motion=press).faults

    def hear(linear_m_s: float, stamp_ms: int) -> None:
        message = velocity(linear_m_s)
        message.header.stamp.sec, rest_ms = divmod(stamp_ms, 1000)
        message.header.stamp.nanosec = 1_000_000 * rest_ms
        desk.callbacks["indenter/twist"](message)

    # 0.4 mm each 40 ms: the last two of the way down are refused.
    for index in range(6):
        hear(-0.01, 1000 + 40 * index)
    np.testing.assert_allclose(heights_mm, [29.6, 29.2, 28.8, 28.4, 28.0, 27.6])
    # Out of order, it is no time that has passed.
    hear(0.01, 1190)
    for index in range(6, 12):
        hear(0.01, 1000 + 40 * index)
    np.testing.assert_allclose(heights_mm[6:], [28.0, 28.4, 28.8, 29.2, 29.6, 30.0])
    assert (faults.counts()[Fault.GEL], faults.counts()[Fault.ORDER]) == (5, 1)


def test_a_calibration_that_cannot_be_kept_is_not_shown(tmp_path: Path) -> None:
    desk, shown = Desk(), []
    # Below a file there is no folder.
    (tmp_path / "file").write_text("")
    url = f"file://{tmp_path}/file/camera.yaml"
    CalibrationStore(desk, url, camera_name="camera", check=lambda _: None, on_change=shown.append)
    request, response = SetCameraInfo.Request(), SetCameraInfo.Response()
    request.camera_info = msg_adapters.encode_camera_info(
        width=64,
        height=48,
        focal_px=30.0,
        principal_point_px=(31.5, 23.5),
        distortion=(0.0, 0.0, 0.0, 0.0),
        stamp_ns=1,
        frame_id="camera",
    )
    with pytest.raises(OSError, match="file"):
        desk.callbacks["set_camera_info"](request, response)
    assert (shown, response.success) == ([], False)
