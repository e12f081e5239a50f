# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The adapter to a real arm, against a driver that speaks UFACTORY's own messages over DDS.

The driver is a stand-in, its messages are real: built by ROS's generators from their public
definitions, with the same type hashes as UFACTORY's package.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import hostile
import numpy as np
import pytest
import rclpy
from arm_rig import ArmClient
from geometry_msgs.msg import PoseStamped, TwistStamped
from harness import (
    Executable,
    check_interrupts,
    measured_until,
    refused_starts,
    running,
    spin_in_background,
    with_parameters,
)
from message_packages import importable
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from scipy.spatial.transform import Rotation

import msg_adapters
from dotsim_ros.nodes.xarm_adapter.node import XarmAdapter

MODULE = "dotsim_ros.nodes.xarm_adapter.node"
TYPE_HASHES = {
    "msg/RobotMsg": "RIHS01_fdb17c24941fbbe2773b899604de978780d6c9f72bda695f87bb1dce26b9cd49",
    "srv/MoveVelocity": "RIHS01_ffce29aa93365d67add3e542c1ac7c2e9967b98d3242bed14c430861519ec499",
}
"""Those of xarm_msgs of xArm-Developer/xarm_ros2 when it is built for ROS 2 Jazzy."""
PARAMETERS = {"diagnostics_period_s": 0.1, "answer_s": 2.0, "stale_s": 0.1}
STATE_PERIOD_S = 0.02
QUIET_S = 0.3
"""Longer than an arm that is told nothing moves on."""
POSE_MM_RAD = [350.0, -20.0, 300.0, 3.0, 0.2, -1.1]


@pytest.fixture(scope="session")
def xarm_package() -> Iterator[Path]:
    """Return the folder that xarm_msgs is built in."""
    with importable("xarm_msgs") as folder:
        yield folder


@dataclass
class Heard:
    """A call that the driver has got."""

    at_s: float
    speeds: list[float]
    is_tool_coord: bool
    duration: float


@dataclass
class Robot:
    """What the driver reports, and how it behaves."""

    mode: int = 5
    state: int = 2
    err: int = 0
    answer: int = 0
    takes_s: float = 0.0
    is_silent: bool = False
    pose: list[float] = field(default_factory=lambda: list(POSE_MM_RAD))


class FakeDriver:
    """Stands where UFACTORY's driver would, with its names and messages."""

    def __init__(self) -> None:
        messages = importlib.import_module("xarm_msgs.msg")
        services = importlib.import_module("xarm_msgs.srv")
        self._message = messages.RobotMsg
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node("ufactory_driver", context=self._context)
        self.robot = Robot()
        self.calls: list[Heard] = []
        self.under_way = 0
        self.most_under_way = 0
        self._lock = threading.Lock()
        group = ReentrantCallbackGroup()
        self._publisher = self.node.create_publisher(self._message, "/xarm/robot_states", 10)
        self._service = self.node.create_service(
            services.MoveVelocity,
            "/xarm/vc_set_cartesian_velocity",
            self._on_call,
            callback_group=group,
        )
        self.node.create_timer(STATE_PERIOD_S, self._report, callback_group=group)
        # Several threads: were two calls under way, it would see both.
        several = MultiThreadedExecutor(num_threads=4, context=self._context)
        self._thread = spin_in_background(self.node, several)

    def close(self) -> None:
        """Leave the graph."""
        rclpy.try_shutdown(context=self._context)
        self._thread.join(10.0)
        self.node.destroy_node()

    def since(self, begin_s: float) -> list[Heard]:
        """Return the calls after a time."""
        with self._lock:
            return [call for call in self.calls if call.at_s > begin_s]

    def _report(self) -> None:
        robot = self.robot
        if robot.is_silent:
            return
        message = self._message()
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.mode, message.state, message.err = robot.mode, robot.state, robot.err
        message.pose = np.array(robot.pose, dtype=np.float32)
        message.angle = [0.1] * 7
        self._publisher.publish(message)

    def _on_call(self, request: Any, response: Any) -> Any:
        with self._lock:
            self.under_way += 1
            self.most_under_way = max(self.most_under_way, self.under_way)
            self.calls.append(
                Heard(
                    time.monotonic(),
                    list(request.speeds),
                    request.is_tool_coord,
                    request.duration,
                )
            )
        time.sleep(self.robot.takes_s)
        with self._lock:
            self.under_way -= 1
        response.ret = self.robot.answer
        response.message = "told to refuse" if self.robot.answer else ""
        return response


@dataclass
class Rig:
    """A driver, the adapter, and a program that commands it."""

    driver: FakeDriver
    adapter: Executable
    client: ArmClient


@pytest.fixture(scope="module")
def started(xarm_package: Path) -> Iterator[Rig]:
    driver = FakeDriver()
    try:
        with (
            running(MODULE, parameters=PARAMETERS) as adapter,
            closing(ArmClient("xarm_adapter", {"ee_pose": PoseStamped})) as client,
        ):
            client.meet()
            yield Rig(driver, adapter, client)
    finally:
        driver.close()


@pytest.fixture
def rig(started: Rig) -> Iterator[Rig]:
    started.driver.robot = Robot()
    yield started
    started.driver.robot = Robot()
    started.client.set_parameters(answer_s=PARAMETERS["answer_s"], stale_s=PARAMETERS["stale_s"])
    # The last velocity must have become zero, and been answered.
    started.client.wait(lambda: not started.driver.under_way, "the last answer")
    time.sleep(QUIET_S)
    started.client.wait(
        lambda: not started.driver.since(time.monotonic() - QUIET_S), "the end of the calls"
    )


def lead(rig: Rig, duration_s: float, **frame: str) -> tuple[float, list[Heard]]:
    """Command 50 mm/s and a turn; return when the last was sent, and what the driver heard."""
    begin_s = time.monotonic()
    last_s = rig.client.lead(duration_s, lambda t: ((0.05, 0.0, -0.01), (0.0, 0.1, 0.0)), **frame)
    return last_s, rig.driver.since(begin_s)


def test_the_messages_are_those_of_the_real_driver(xarm_package: Path) -> None:
    for name, expected in TYPE_HASHES.items():
        (path,) = xarm_package.glob(f"c/xarm_msgs/{name}.json")
        hashes = json.loads(path.read_text())["type_hashes"]
        found = {entry["type_name"]: entry["hash_string"] for entry in hashes}
        assert found[f"xarm_msgs/{name}"] == expected


def test_without_the_package_it_does_not_start_and_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Another test may have built it.
    entries = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    bare = [entry for entry in entries if not (Path(entry) / "xarm_msgs").is_dir()]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(bare))
    looked_up = subprocess.run([sys.executable, "-c", "import xarm_msgs"], capture_output=True)
    if looked_up.returncode == 0:
        pytest.skip("xarm_msgs is installed")
    node = Executable(MODULE)
    try:
        assert node.exit_status() == 2
        assert "'xarm_msgs' is not installed" in node.log
        assert "without an arm use xarm_sim" in node.log
        assert "Traceback" not in node.log
    finally:
        node.end()


REFUSED = {
    "duration_s": {"duration_s": 0.0},
    "stale_s": {"stale_s": 9.0},
    "cannot start: Invalid service name": {"service": "'bad name'"},
    "the topic 'bad name' has no valid name": {"robot_states": "'bad name'"},
}
"""Parameters that are dangerous or cannot work, by words of the reason."""


def test_dangerous_parameters_are_refused_at_the_start(xarm_package: Path) -> None:
    starts = {reason: with_parameters(given) for reason, given in REFUSED.items()}
    for reason, log in refused_starts(XarmAdapter, starts).items():
        assert reason in log


def test_it_ends_at_the_first_sigint_whenever_that_comes(xarm_package: Path) -> None:
    check_interrupts("xarm_adapter", count=2)


def test_velocities_arrive_in_millimetres_with_a_watchdog(rig: Rig) -> None:
    _, calls = lead(rig, 1.0)
    assert len(calls) > 5
    for call in calls:
        assert call.duration == pytest.approx(0.1)
        assert not call.is_tool_coord
        assert len(call.speeds) == 6
    np.testing.assert_allclose(calls[0].speeds, [50.0, 0.0, -10.0, 0.0, 0.1, 0.0], rtol=1e-6)
    # What was commanded last goes on until the adapter stops it.
    rig.client.wait(lambda: not any(rig.driver.calls[-1].speeds), "the arm to be stopped")
    assert rig.client.set_parameters(duration_s=0.3).successful
    _, calls = lead(rig, 0.3, frame_id="link_tcp")
    assert all(call.is_tool_coord for call in calls if any(call.speeds))
    assert calls[0].duration == pytest.approx(0.3)
    # The watchdog can be changed, but not taken away.
    result = rig.client.set_parameters(duration_s=0.0)
    assert not result.successful
    assert "duration_s" in result.reason
    assert rig.client.set_parameters(duration_s=0.1).successful


def test_no_parameter_and_no_message_ends_it(rig: Rig) -> None:
    attacker = hostile.Attacker("/", "xarm_adapter", rig.adapter.process.pid)
    try:
        hostile.try_every_parameter(attacker)
        begin_s = time.monotonic()
        attacker.send(
            TwistStamped,
            "cmd_vel",
            hostile.spoilt(TwistStamped(header=hostile.header("link_base"))),
        )
        kind = importlib.import_module("xarm_msgs.msg").RobotMsg
        states = [kind(header=each, mode=5, state=2) for each in hostile.headers("")]
        for number in hostile.EXTREMES:
            states.append(kind(mode=5, state=2, pose=np.full(6, number, dtype=np.float32)))
            states.append(kind(mode=5, state=2, angle=[number] * 7))
        attacker.send(kind, "/xarm/robot_states", states)
        assert rig.adapter.process.poll() is None
        assert "Traceback" not in rig.adapter.log
        assert not any(any(call.speeds) for call in rig.driver.since(begin_s))
        rig.client.state("arm", lambda status: status.level == msg_adapters.Level.OK)
        _, calls = lead(rig, 0.5)
        assert any(any(call.speeds) for call in calls)
    finally:
        attacker.close()


def test_silence_becomes_zero_speed_once_and_then_nothing(rig: Rig) -> None:
    last_s, _ = lead(rig, 0.4)
    rig.client.wait(lambda: not any(rig.driver.calls[-1].speeds), "the arm to be stopped")
    time.sleep(QUIET_S)
    after = rig.driver.since(last_s)
    moving = [call.at_s for call in after if any(call.speeds)]
    (stop_s,) = [call.at_s for call in after if not any(call.speeds)]
    assert stop_s > max(moving, default=last_s)
    assert stop_s - last_s > 0.09


def test_one_call_is_under_way_at_most(rig: Rig) -> None:
    rig.driver.most_under_way = 0
    rig.driver.robot.takes_s = 0.1
    _, calls = lead(rig, 1.0)
    assert rig.driver.most_under_way == 1
    assert (np.diff([call.at_s for call in calls]) > 0.095).all()
    rig.client.state("arm", lambda status: int(status.values["held_back"]) > 5)


def test_a_driver_that_does_not_answer_is_given_up_and_taken_up_again(rig: Rig) -> None:
    assert rig.client.set_parameters(answer_s=0.3).successful
    rig.driver.robot.takes_s = 0.8
    lead(rig, 0.6)
    status = rig.client.state("arm", lambda status: int(status.values["failed"]) > 0)
    assert "no answer within 0.3 s" in status.values["last_refusal"]
    rig.driver.robot.takes_s, rig.driver.robot.answer = 0.0, 9
    time.sleep(1.2)
    lead(rig, 0.3)
    rig.adapter.wait_for_line("the driver answers 9: told to refuse")
    rig.driver.robot.answer = 0
    _, calls = lead(rig, 1.0)
    assert len(calls) > 5


def test_an_arm_that_is_not_ready_is_left_alone_and_why_is_said(rig: Rig) -> None:
    for change, words in (({"err": 24}, "error 24"), ({"is_silent": True}, "was last received")):
        rig.driver.robot = Robot(**change)
        status = rig.client.state("arm", lambda status, words=words: words in status.message)
        assert status.level == msg_adapters.Level.ERROR
        _, calls = lead(rig, 0.3)
        assert calls == []
    rig.adapter.wait_for_line("error 24")
    rig.driver.robot = Robot()
    rig.client.state("arm", lambda status: status.level == msg_adapters.Level.OK)
    _, calls = lead(rig, 0.3)
    assert any(any(call.speeds) for call in calls)


def test_a_velocity_that_is_no_number_becomes_zero_at_once(rig: Rig) -> None:
    # The velocities before would go on for a second.
    assert rig.client.set_parameters(stale_s=1.0).successful

    def last_moving_s() -> float:
        lead(rig, 0.3)
        sent_s = rig.client.send((float("nan"), 0.0, 0.0))
        time.sleep(0.7)
        moving = [call for call in rig.driver.since(sent_s) if any(call.speeds)]
        return max((call.at_s - sent_s for call in moving), default=0.0)

    measured_until(last_moving_s, below=0.05)
    assert all(np.isfinite(call.speeds).all() for call in rig.driver.calls)


def test_a_velocity_of_another_frame_is_not_passed_on(rig: Rig) -> None:
    _, calls = lead(rig, 0.4, frame_id="world")
    assert calls == []
    rig.client.state("input", lambda status: int(status.values["wrong_frame"]) > 5)


def test_the_arms_state_becomes_a_pose(rig: Rig) -> None:
    message = rig.client.newest("ee_pose", time.monotonic())
    assert message.header.frame_id == "link_base"
    position, quaternion = msg_adapters.decode_pose_stamped(message)
    np.testing.assert_allclose(position, [0.35, -0.02, 0.3], atol=1e-6)
    turned = Rotation.from_quat(quaternion) * Rotation.from_euler("xyz", POSE_MM_RAD[3:]).inv()
    assert turned.magnitude() < 1e-6
    stamp_s = 1e-9 * msg_adapters.message_stamp_ns(message)
    assert abs(stamp_s - 1e-9 * rig.client.node.get_clock().now().nanoseconds) < 1.0
    rig.driver.robot.pose = [float("nan")] * 6
    time.sleep(0.2)
    count = rig.client.count("ee_pose")
    time.sleep(0.2)
    assert rig.client.count("ee_pose") == count
    rig.adapter.wait_for_line("the arm's state is refused")
