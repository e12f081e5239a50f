# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The arm that stands in for an xArm 7: a user's program leads it over DDS and measures it."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import psutil
import pytest
from arm_rig import ArmClient
from harness import Executable, measured_until, running

import msg_adapters
from dotsim_ros.control.arm.kinematics import JOINT_NAMES, ArmKinematics
from dotsim_ros.geometry.pose import Pose, compose, inverse

MODULE = "dotsim_ros.nodes.xarm_sim.node"
START_M = np.array([0.35, 0.0, 0.3])
INDENTER = Pose(np.array([0.35, 0.0, 0.28]), np.array([1.0, 0.0, 0.0, 0.0]))
PERIOD_S = 0.01
Session = tuple[Executable, ArmClient]


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    with (
        running(MODULE, parameters={"diagnostics_period_s": 0.1}) as executable,
        closing(ArmClient("xarm_sim")) as client,
    ):
        client.meet()
        yield executable, client


@pytest.fixture
def client(session: Session) -> Iterator[ArmClient]:
    session[1].trigger("reset")
    settled(session[1])
    yield session[1]
    session[1].set_parameters(fail_drop_feedback=False, fail_delay_s=0.0, fail_stop=False)


def velocities(stamps: Any, positions: Any) -> Any:
    """Return the velocities between poses; their times are multiples of the arm's grid. Poses of
    one time, as after a halt, must be of one place."""
    steps = 0.005 * np.round(np.diff(stamps) / 0.005)
    ways = np.diff(positions, axis=0)
    is_later = steps > 0.0
    assert not ways[~is_later].any()
    return ways[is_later] / steps[is_later, None], steps[is_later]


def settled(client: ArmClient) -> Any:
    """Return where the tool is once it stands, by what the arm sent from now on: a pose may be
    heard long after it was sent."""
    since_s, since_ns = time.monotonic(), client.now_ns()
    places = []

    def stands() -> bool:
        places[:] = client.positions(since_s, sent_after_ns=since_ns)[1][-10:]
        return len(places) == 10 and float(np.ptp(places, axis=0).max()) < 1e-7

    client.wait(stands, "the arm to stand")
    return places[-1]


def test_no_socket_is_open_to_other_machines(session: Session) -> None:
    number = session[0].process.pid
    found = {each.laddr.ip for each in psutil.net_connections("inet") if each.pid == number}
    assert found == {"127.0.0.1"}


def test_poses_carry_the_times_of_their_states_100_a_second(client: ArmClient) -> None:
    since_s = time.monotonic()
    time.sleep(1.5)
    stamps, places = client.positions(since_s)
    np.testing.assert_allclose(places, np.tile(START_M, (len(places), 1)), atol=1e-6)
    assert len(stamps) > 50
    # Every stamp falls on the arm's grid, whenever its tick came.
    away = np.abs(stamps / 0.005 - np.round(stamps / 0.005)) * 0.005
    assert np.percentile(away, 95) < 5e-4
    # A tick that comes late may tell a state again.
    steps = np.diff(stamps)
    assert ((steps == 0.0) | (steps > 0.004)).all()
    assert np.median(steps) == pytest.approx(PERIOD_S, abs=2e-4)


def test_joints_pose_and_indenter_agree(client: ArmClient) -> None:
    client.lead(0.5, lambda t: ((0.03, 0.02, -0.01), (0.1, 0.0, 0.2)))
    settled(client)
    joints = client.newest("joint_states", time.monotonic())
    assert joints.header.frame_id == "link_base"
    assert list(joints.name) == list(JOINT_NAMES)
    positions, rates = msg_adapters.decode_joint_state(joints, JOINT_NAMES)
    tool = ArmKinematics().pose(positions)
    pose = client.newest("ee_pose", time.monotonic())
    assert pose.header.frame_id == "link_base"
    place, quaternion = msg_adapters.decode_pose_stamped(pose)
    np.testing.assert_allclose(place, tool.position_m, atol=1e-9)
    assert abs(quaternion @ tool.quaternion_xyzw) == pytest.approx(1.0, abs=1e-12)
    assert not rates.any()
    seen = client.newest("indenter/pose", time.monotonic())
    assert seen.header.frame_id == "densetact_base"
    expected = compose(inverse(tool), INDENTER)
    np.testing.assert_allclose(
        msg_adapters.decode_pose_stamped(seen)[0], expected.position_m, atol=1e-9
    )


def test_velocities_along_base_and_tool_move_as_their_frame_says(client: ArmClient) -> None:
    # The tool points down: its +z is the base's -z, its +y the base's -y, and +x is +x.
    for frame_id, signs in (("link_base", (1, 1, 1)), ("link_tcp", (1, -1, -1))):
        before = settled(client)
        client.lead(0.5, lambda t: ((0.02, 0.03, 0.05), (0.0, 0.0, 0.0)), frame_id=frame_id)
        moved = settled(client) - before
        # 0.5 s, and as long as the last velocity stays valid, if the machine lets it.
        assert 0.01 < np.linalg.norm(moved) < 0.08
        direction = np.array([0.02, 0.03, 0.05]) * signs
        expected = direction * np.linalg.norm(moved) / np.linalg.norm(direction)
        np.testing.assert_allclose(moved, expected, atol=2e-4)
    client.state("input", lambda status: "the arm stands" in status.message)


def test_silence_stops_the_arm_after_a_fifth_of_a_second(client: ArmClient) -> None:
    def is_in_time() -> bool:
        begin_s, begin_ns = time.monotonic(), client.now_ns()
        last_s = client.lead(0.5, lambda t: ((0.0, 0.05, 0.0), (0.0, 0.0, 0.0)))
        last_ns = client.now_ns() - round(1e9 * (time.monotonic() - last_s))
        settled(client)
        stamps, places = client.positions(begin_s, sent_after_ns=begin_ns)
        velocity, steps = velocities(stamps, places)
        speed = np.linalg.norm(velocity, axis=1)
        first_ns = next(
            stamp_ns
            for arrival_s, message in client.heard["ee_pose"]
            if arrival_s > begin_s
            and (stamp_ns := msg_adapters.message_stamp_ns(message)) > begin_ns
        )
        ends_s = 1e-9 * (first_ns - last_ns) + np.cumsum(steps)
        goes_on = (speed[(ends_s > 0.03) & (ends_s < 0.2)] > 0.045).all()
        # 0.2 s, latency, the lag's way down to a fiftieth, and the message's own way.
        return bool(goes_on and (speed[ends_s > 0.2 + 0.01 + 0.08 + 0.1] < 0.002).all())

    # The last velocities of one that leads it from a busy machine may be late.
    assert any(is_in_time() for _ in range(3))
    client.state("input", lambda status: "the arm stands" in status.message)


def test_a_velocity_of_an_unknown_frame_is_refused_and_not_said_each_time(session: Session) -> None:
    executable, client = session
    client.trigger("reset")
    before, begin_s = settled(client), time.monotonic()
    client.lead(0.5, lambda t: ((0.1, 0.0, 0.0), (0.0, 0.0, 0.0)), frame_id="densetact_base")
    np.testing.assert_allclose(settled(client), before, atol=1e-9)
    status = client.state("input", lambda status: int(status.values["wrong_frame"]) >= 3)
    assert status.level == msg_adapters.Level.WARN
    executable.wait_for_line("frame_id of the velocity is 'densetact_base'")
    # Not more often than every 5 s, and here once more for the rest of the 5 s before.
    lines = executable.log.count("frame_id of the velocity")
    assert lines <= 2 + (time.monotonic() - begin_s) / 5.0


def test_a_velocity_that_is_no_number_stops_the_arm(client: ArmClient) -> None:
    def way_m() -> float:
        client.trigger("reset")
        settled(client)
        client.lead(0.3, lambda t: ((0.0, 0.0, 0.1), (0.0, 0.0, 0.0)))
        sent_ns = client.now_ns()
        sent_s = client.send((0.0, float("nan"), 0.0))
        settled(client)
        _, places = client.positions(sent_s, sent_after_ns=sent_ns)
        assert np.isfinite(places).all()
        return float(np.ptp(places, axis=0).max())

    # Without it the last velocity would have gone on for 0.2 s and 20 mm, each time.
    measured_until(way_m, below=0.012)


def test_stops_hold_until_they_are_taken_back(client: ArmClient) -> None:
    def lead_up() -> None:
        client.lead(0.3, lambda t: ((0.0, 0.0, 0.1), (0.0, 0.0, 0.0)))

    def stands(text: str, level: msg_adapters.Level) -> None:
        stopped_ns = client.now_ns()
        lead_up()
        _, places = client.positions(sent_after_ns=stopped_ns + 60_000_000)
        assert np.ptp(places, axis=0).max() < 1e-7
        assert client.state("arm", lambda status: text in status.message).level == level

    lead_up()
    assert client.set_parameters(fail_stop=True).successful
    stands("failing on request", msg_adapters.Level.WARN)
    assert client.set_parameters(fail_stop=False).successful
    lead_up()
    assert client.trigger("emergency_stop").success
    stands("emergency stop", msg_adapters.Level.ERROR)
    assert client.trigger("reset").success
    np.testing.assert_allclose(settled(client), START_M, atol=1e-6)
    lead_up()
    assert settled(client)[2] > START_M[2] + 0.03


def test_a_process_that_was_held_up_makes_no_jump(session: Session) -> None:
    executable, client = session

    def beyond_m() -> float:
        """Return how much farther it goes than while it is led."""
        client.trigger("reset")
        settled(client)
        since_s, since_ns = time.monotonic(), client.now_ns()
        client.lead(0.3, lambda t: ((0.0, 0.0, 0.1), (0.0, 0.0, 0.0)))
        executable.process.send_signal(signal.SIGSTOP)
        led_s = time.monotonic() - since_s
        time.sleep(0.7)
        executable.process.send_signal(signal.SIGCONT)
        settled(client)
        stamps, places = client.positions(since_s, sent_after_ns=since_ns)
        velocity, _ = velocities(stamps, places)
        assert np.linalg.norm(velocity, axis=1).max() <= 0.1 * 1.01
        assert places[-1][2] - START_M[2] > 0.02
        return float(places[-1][2] - START_M[2] - 0.1 * led_s)

    # As far as the last velocity was valid, at its speed; now and then it is read after the halt.
    measured_until(beyond_m, below=0.1 * (0.2 + 0.05))


def test_the_indenter_can_be_placed_again_and_kept_silent(client: ArmClient) -> None:
    for values, reason in (
        ({"fail_delay_s": 3.0}, "fail_delay_s"),
        ({"indenter_pose": [0.0, 0.0, 0.0]}, "expected 7 numbers"),
        ({"start_pose": [0.4, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0]}, "read-only"),
    ):
        result = client.set_parameters(**values)
        assert not result.successful
        assert reason in result.reason
    before = client.newest("indenter/pose", time.monotonic()).pose.position.z
    assert before == pytest.approx(0.02, abs=1e-6)
    assert client.set_parameters(indenter_pose=[0.35, 0.0, 0.27, 1.0, 0.0, 0.0, 0.0]).successful
    placed = pytest.approx(0.03, abs=1e-6)
    client.wait(
        lambda: client.newest("indenter/pose", time.monotonic()).pose.position.z == placed,
        "the indenter at its new place",
    )
    assert client.set_parameters(publish_indenter=False).successful
    time.sleep(0.3)
    count = client.count("indenter/pose")
    time.sleep(0.2)
    assert client.count("indenter/pose") == count
    assert client.set_parameters(
        publish_indenter=True, indenter_pose=[0.35, 0.0, 0.28, 1.0, 0.0, 0.0, 0.0]
    ).successful


def test_two_sigints_end_it_with_status_0(session: Session) -> None:
    # The last of this file.
    assert session[0].interrupt(2) == 0, session[0].log
    assert "Traceback" not in session[0].log
