# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The node whose indenter follows a force: real messages, real gel."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from harness import (
    APEX_M,
    BASE_FRAME,
    Client,
    Executable,
    TactileFrame,
    refused_starts,
    running,
    with_parameters,
)
from rclpy.qos import HistoryPolicy, QoSProfile
from std_srvs.srv import Trigger

import msg_adapters
from dotsim_ros.data.trajectory import PoseChannel, Trajectory, WrenchChannel, write_trajectory
from dotsim_ros.nodes.indenter_player.node import IndenterPlayer

FORCE = {"control": "force", "diagnostics_period_s": 0.1, "grid_spacing_m": 0.0048}
LOCKSTEP = {**FORCE, "clock": "lockstep"}
PERIOD_NS = 40_000_000
TOLERANCE = 0.01
SETTLING_FRAMES = 5
LARGEST_TRAVEL_M = 0.6e-3
CLEAR_M = 0.2e-3
ABOVE = (0.0, 0.0, APEX_M + 0.004)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


class ForceClient(Client):
    """A user's program that sends poses without a depth, and the forces of their time."""

    def __init__(self) -> None:
        super().__init__()
        self._forces = self.node.create_publisher(
            WrenchStamped, "indenter/wrench", QoSProfile(depth=10, history=HistoryPolicy.KEEP_ALL)
        )
        self.stamp_ns = 10_000_000_000

    def meet(self) -> None:
        super().meet()
        self.wait(lambda: self._forces.get_subscription_count() > 0, "a reader of forces")

    def push(
        self,
        force_n: tuple[float, float, float],
        *,
        stamp_ns: int | None = None,
        frame_id: str = BASE_FRAME,
    ) -> None:
        """Publish a force as it is given, valid or not."""
        message = WrenchStamped()
        message.header.frame_id = frame_id
        if stamp_ns is None:
            stamp_ns = self.node.get_clock().now().nanoseconds
        message.header.stamp = msg_adapters.encode_stamp(stamp_ns)
        force = message.wrench.force
        force.x, force.y, force.z = force_n
        self._forces.publish(message)

    def frame_at(
        self, force_n: float, position_m: tuple[float, float, float] = ABOVE, **pose: Any
    ) -> TactileFrame:
        """Send a pose and the force of its time, and wait for the frame."""
        self.stamp_ns += PERIOD_NS
        self.push((0.0, 0.0, force_n), stamp_ns=self.stamp_ns, frame_id="indenter")
        self.send(position_m, stamp_ns=self.stamp_ns, **pose)
        return self.whole_frame(self.stamp_ns)

    def frames_at(self, *forces_n: float, **where: Any) -> list[TactileFrame]:
        """Return the frames of a course of forces."""
        return [self.frame_at(force_n, **where) for force_n in forces_n]


@contextmanager
def forced_sensor(**parameters: Any) -> Iterator[tuple[Executable, ForceClient]]:
    with running(parameters=parameters) as executable, closing(ForceClient()) as client:
        client.meet()
        yield executable, client


@pytest.fixture(scope="module")
def started() -> Iterator[tuple[Executable, ForceClient]]:
    with forced_sensor(**LOCKSTEP) as found:
        yield found


@pytest.fixture
def client(started: tuple[Executable, ForceClient]) -> ForceClient:
    """A client of a sensor at rest."""
    assert started[1].call(Trigger, "/tactile_sim/reset").success
    return started[1]


def normal_n(frame: TactileFrame) -> float:
    """Return the force along the axis of an upright indenter."""
    return float(frame.force_n()[2])


def largest_travel_m(frames: list[TactileFrame]) -> float:
    heights_m = [np.array(frame.indenter_m())[2] for frame in frames]
    return float(np.abs(np.diff(heights_m)).max())


def test_a_force_is_held_whatever_the_height_of_the_pose(client: ForceClient) -> None:
    frames = client.frames_at(*[0.5] * SETTLING_FRAMES)
    frames += client.frames_at(*[0.5] * 2, position_m=(0.0, 0.0, APEX_M + 0.001))
    for frame in frames[SETTLING_FRAMES - 1 :]:
        assert normal_n(frame) == pytest.approx(0.5, rel=TOLERANCE)
    assert frames[-1].indenter_m()[2] < APEX_M
    assert largest_travel_m(frames) <= LARGEST_TRAVEL_M + 1e-6


def test_a_ramp_is_followed_without_delay_and_released(client: ForceClient) -> None:
    client.frames_at(*[0.5] * SETTLING_FRAMES)
    asked_n = np.linspace(0.5, 1.5, 21)[1:].tolist()
    errors = [
        normal_n(f) / n - 1.0 for f, n in zip(client.frames_at(*asked_n), asked_n, strict=True)
    ]
    assert np.abs(errors).max() < 0.04
    assert np.abs(errors[5:]).max() < 0.02
    free = client.frames_at(*[0.0] * 4)[-1]
    assert normal_n(free) == 0.0
    assert free.indenter_m()[2] > APEX_M
    again = client.frames_at(*[0.5] * SETTLING_FRAMES)[-1]
    assert normal_n(again) == pytest.approx(0.5, rel=TOLERANCE)


def test_the_force_is_held_where_the_pose_goes_across_and_tilts(client: ForceClient) -> None:
    tilt_rad = 0.3
    turn = (0.0, math.sin(0.5 * tilt_rad), 0.0, math.cos(0.5 * tilt_rad))
    axis = np.array([math.sin(tilt_rad), 0.0, math.cos(tilt_rad)])
    for _ in range(SETTLING_FRAMES):
        frame = client.frame_at(0.5, quaternion_xyzw=turn)
    assert frame.force_n() @ axis == pytest.approx(0.5, rel=TOLERANCE)
    for step in range(1, 11):
        frame = client.frame_at(0.5, (2e-4 * step, 0.0, ABOVE[2]), quaternion_xyzw=turn)
        assert frame.force_n() @ axis == pytest.approx(0.5, rel=0.1)
    assert frame.indenter_m()[0] != 0.0


def test_a_force_that_the_gel_cannot_give_is_told_and_left_again(
    started: tuple[Executable, ForceClient], client: ForceClient
) -> None:
    frames = client.frames_at(*[500.0] * 22)
    assert largest_travel_m(frames) <= LARGEST_TRAVEL_M + CLEAR_M
    state = client.wait_for_state("force", lambda state: state.level is msg_adapters.Level.WARN)
    assert "500.000 N are asked for" in state.message
    assert "the gel allows no deeper press" in state.message
    assert float(state.values["reached_n"]) == pytest.approx(normal_n(frames[-1]), abs=1e-3)
    started[0].wait_for_line("force: 500.000 N are asked for")
    for _ in range(30):
        frame = client.frame_at(0.5)
        if normal_n(frame) == pytest.approx(0.5, rel=TOLERANCE):
            break
    assert normal_n(frame) == pytest.approx(0.5, rel=TOLERANCE)
    client.wait_for_state("force", lambda state: state.level is msg_adapters.Level.OK)


BAD_FORCES = {
    "nan": ("invalid_numbers", {"force_n": (0.0, 0.0, math.nan)}),
    "grams": ("invalid_numbers", {"force_n": (0.0, 0.0, 5000.0)}),
    "another frame": ("wrong_frame", {"frame_id": "map"}),
    "the same time": ("out_of_order", {"later_ns": 0}),
    "time backwards": ("out_of_order", {"later_ns": -PERIOD_NS}),
}


def test_bad_forces_are_refused_and_the_one_before_holds(client: ForceClient) -> None:
    before = client.frames_at(*[0.5] * SETTLING_FRAMES)[-1]
    for fault, given in BAD_FORCES.values():
        count = int(client.state_from_now("input").values[fault])
        bad = {"force_n": (0.0, 0.0, 2.0), "later_ns": PERIOD_NS, "frame_id": "indenter", **given}
        client.push(
            bad["force_n"], stamp_ns=client.stamp_ns + bad["later_ns"], frame_id=bad["frame_id"]
        )
        client.wait_for_state("input", lambda s, f=fault, n=count: int(s.values[f]) == n + 1)
    client.stamp_ns += PERIOD_NS
    assert normal_n(client.frame_at(0.5)) == pytest.approx(normal_n(before), rel=TOLERANCE)


def test_a_force_that_pulls_is_refused_at_its_pose_and_the_one_before_holds(
    client: ForceClient,
) -> None:
    client.frames_at(*[0.5] * SETTLING_FRAMES)
    assert normal_n(client.frame_at(-0.5)) == pytest.approx(0.5, rel=TOLERANCE)
    client.wait_for_state("input", lambda state: "turn the sign" in state.values["last_fault"])
    assert normal_n(client.frame_at(-0.01)) < 0.5


def test_a_pose_waits_for_the_force_of_its_time_in_whatever_order_they_come(
    client: ForceClient,
) -> None:
    first = client.frames_at(0.3, 0.3, 0.6)
    assert client.call(Trigger, "/tactile_sim/reset").success
    stamps = [client.stamp_ns + PERIOD_NS * (1 + index) for index in range(3)]
    for stamp_ns in stamps:
        client.send(ABOVE, stamp_ns=stamp_ns)
    client.wait_for_state("input", lambda state: "3 poses wait for a force" in state.message)
    for stamp_ns, force_n in zip(stamps, (0.3, 0.3, 0.6), strict=True):
        client.push((0.0, 0.0, force_n), stamp_ns=stamp_ns)
    client.stamp_ns = stamps[-1]
    again = [client.whole_frame(stamp_ns) for stamp_ns in stamps]
    assert [a.is_same(b) for a, b in zip(first, again, strict=True)] == [True] * 3


def test_an_axis_that_passes_the_gel_by_is_refused(
    started: tuple[Executable, ForceClient], client: ForceClient
) -> None:
    count = int(client.state("input").values["refused_by_gel"])
    client.stamp_ns += PERIOD_NS
    client.push((0.0, 0.0, 0.5), stamp_ns=client.stamp_ns)
    client.send((0.03, 0.0, 0.03), stamp_ns=client.stamp_ns)
    client.wait_for_state("input", lambda s: int(s.values["refused_by_gel"]) == count + 1)
    started[0].wait_for_line("passes the gel by along its z axis")
    client.stamp_ns += 2_000_000_000
    assert normal_n(client.frames_at(*[0.5] * SETTLING_FRAMES)[-1]) == pytest.approx(
        0.5, rel=TOLERANCE
    )


def test_another_indenter_finds_the_force_anew(client: ForceClient) -> None:
    for indenter in ("cone", "sphere_4mm"):
        assert client.set_parameters(indenter=indenter).successful
        frames = client.frames_at(*[0.5] * (SETTLING_FRAMES + 2))
        assert normal_n(frames[-1]) == pytest.approx(0.5, rel=TOLERANCE), indenter


def test_in_real_time_the_newest_force_is_followed_under_a_single_pose() -> None:
    with forced_sensor(**FORCE, rate_hz=10.0) as (_, client):
        client.wait_for_state("input", lambda state: "no force on indenter/wrench" in state.message)
        client.send(ABOVE)
        for asked_n in (0.3, 0.0):
            client.push((0.0, 0.0, asked_n))
            found = client.next_frame(
                lambda frame, asked_n=asked_n: (
                    frame.indenter_m() is not None
                    and abs(normal_n(frame) - asked_n) <= TOLERANCE * asked_n
                )
            )
            assert (found.indenter_m()[2] > APEX_M) == (asked_n == 0.0)
        client.wait_for_state("input", lambda state: "the last one holds" in state.message)


PLAYER = "dotsim_ros.nodes.indenter_player.node"


def test_a_recording_of_forces_is_played_into_the_sensor(
    client: ForceClient, tmp_path: Path
) -> None:
    asked_n = np.repeat(np.linspace(0.3, 1.0, 4), 4)
    stamps_ns = 10**9 + PERIOD_NS * np.arange(len(asked_n))
    forces_n = np.column_stack([np.zeros((len(asked_n), 2)), asked_n])
    recording = Trajectory(
        pose=PoseChannel(
            stamps_ns, np.tile(ABOVE, (len(asked_n), 1)), np.tile(UPRIGHT, (len(asked_n), 1))
        ),
        wrench=WrenchChannel(stamps_ns, forces_n, np.zeros_like(forces_n)),
    )
    write_trajectory(tmp_path / "bag", recording)
    client.frames.clear()
    parameters = {
        "source": "bag",
        "path": tmp_path / "bag",
        "bag_force_topic": "/indenter/wrench",
        "wait_for_answer": "true",
        "exit_at_end": "true",
    }
    with running(PLAYER, parameters=parameters) as player:
        assert player.exit_status() == 0, player.log
    client.wait(
        lambda: sum(frame.is_whole() for frame in client.frames.values()) == len(asked_n),
        "the frames of the recording",
    )
    found_n = [normal_n(client.frames[stamp_ns]) for stamp_ns in sorted(client.frames)]
    assert found_n[3::4] == pytest.approx(asked_n[3::4], rel=0.03)


def test_a_player_of_forces_that_are_not_there_does_not_start(tmp_path: Path) -> None:
    pose = PoseChannel(np.array([1, 2]), np.tile(ABOVE, (2, 1)), np.tile(UPRIGHT, (2, 1)))
    write_trajectory(tmp_path / "bag", Trajectory(pose=pose))
    given = {"path": tmp_path / "bag", "bag_force_topic": "/no/force"}
    starts = {
        "source is 'press', which has no recorded forces": {**given, "source": "press"},
        "holds no message on /no/force": {**given, "source": "bag"},
    }
    logs = refused_starts(
        IndenterPlayer, {why: with_parameters(each) for why, each in starts.items()}
    )
    for why, log in logs.items():
        assert why in log
