# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A /clock that goes back, leaps forward or falls silent under `tactile_sim`."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from free_clock import free_clock
from harness import APEX_M, Client, TactileFrame, sensor
from rosgraph_msgs.msg import Clock

import msg_adapters
from msg_adapters import Level

STEP_NS = 80_000_000
COUNT = 10
APART_M = APEX_M + 0.0005


class Simulator:
    """Publishes /clock and a pose in each step of an episode, and waits for its frame.

    Args:
        client: of the sensor.
    """

    def __init__(self, client: Client) -> None:
        self.client = client
        self._clock = client.node.create_publisher(Clock, "/clock", 10)
        client.wait(lambda: self._clock.get_subscription_count() > 0, "who follows the clock")

    def tick(self, step: int) -> None:
        """Tell the time of a step."""
        self._clock.publish(Clock(clock=msg_adapters.encode_stamp(step * STEP_NS)))

    def episode(self, *, poses_first: bool = False) -> list[TactileFrame]:
        """Press in ten steps of a time that begins again, and return the frames."""
        self.client.frames.clear()
        frames = []
        for step in range(1, COUNT + 1):
            if not poses_first:
                self.tick(step)
            stamp_ns = self.client.send((0.0, 0.0, APART_M - 1e-4 * step), stamp_ns=step * STEP_NS)
            if poses_first:
                self.tick(step)
            frames.append(self.client.whole_frame(stamp_ns))
        return frames

    def restarts(self) -> int:
        """Return how often the node says that time began again."""
        return int(self.client.state("clock").values["restarts"])


@pytest.fixture(scope="module")
def simulator() -> Iterator[Simulator]:
    parameters = {"clock": "lockstep", "use_sim_time": True, "diagnostics_period_s": 0.1}
    with sensor(**parameters, grid_spacing_m=0.0048) as (_, client):
        yield Simulator(client)


def test_every_short_episode_has_all_its_frames_from_a_gel_at_rest(simulator: Simulator) -> None:
    first = simulator.episode()
    assert first[-1].force_n()[2] > 0.1
    for poses_first in (False, True, True):
        # The first pose may come before the clock says that it is a new time.
        again = simulator.episode(poses_first=poses_first)
        assert [a.is_same(b) for a, b in zip(again, first, strict=True)] == [True] * COUNT
    status = simulator.client.wait_for_state(
        "clock", lambda state: "went back by 0.7" in state.message
    )
    assert status.level is Level.OK


def test_a_pose_that_is_left_over_from_the_time_before_keeps_no_other_out(
    simulator: Simulator,
) -> None:
    first = simulator.episode()
    before = simulator.restarts()
    simulator.tick(1)
    simulator.client.wait(lambda: simulator.restarts() > before, "a new start")
    simulator.client.send((0.0, 0.0, APEX_M), stamp_ns=COUNT * STEP_NS - 1)
    simulator.client.wait_for_state("input", lambda state: "the time before" in state.message)
    again = simulator.episode()
    assert [a.is_same(b) for a, b in zip(again, first, strict=True)] == [True] * COUNT


def test_a_pose_that_comes_before_the_clock_leaps_to_it_has_its_frame(simulator: Simulator) -> None:
    client, apart_m = simulator.client, (0.0, 0.0, APART_M)
    restarts = simulator.restarts()
    # To 160 s, back to 0, and on to 120 s, which is nearer to the time before.
    simulator.tick(2000)
    client.whole_frame(client.send(apart_m, stamp_ns=2000 * STEP_NS))
    simulator.tick(1)
    client.wait(lambda: simulator.restarts() > restarts, "a new start")
    stamp_ns = client.send(apart_m, stamp_ns=1500 * STEP_NS)
    simulator.tick(1500)
    client.whole_frame(stamp_ns)


def test_a_leap_is_reported_as_one_a_return_is_a_new_start_and_silence_is_warned_of() -> None:
    parameters = {"use_sim_time": True, "diagnostics_period_s": 0.1, "input_timeout_s": 0.5}
    with free_clock(speed=1.0) as clock, sensor(**parameters, grid_spacing_m=0.0048) as (_, client):
        frame = client.next_frame(lambda frame: True)
        # At the time of a frame, since the client itself follows no clock.
        client.send((0.0, 0.0, APEX_M - 0.0004), stamp_ns=frame.stamp_ns)
        pressed = client.next_frame(lambda frame: bool(frame.force_n()[2] > 0.0))

        clock.jump(30.0)
        leapt = client.wait_for_state("clock", lambda state: "leapt forward by 30" in state.message)
        assert leapt.level is Level.WARN
        later = client.next_frame(lambda frame: frame.stamp_ns > pressed.stamp_ns + 30 * 10**9)
        assert later.is_same(pressed)
        values = client.state("frames").values
        assert values["dropped"] == "0"
        # A busy machine may hold /clock up as long as a leap.
        assert int(client.state("clock").values["leaps"]) >= 1

        client.frames.clear()
        clock.jump(-60.0)
        client.wait_for_state("clock", lambda state: state.values["restarts"] == "1")
        rest = client.wait(
            lambda: next(
                (
                    each
                    for each in list(client.frames.values())
                    if each.stamp_ns < pressed.stamp_ns and each.is_whole()
                ),
                None,
            ),
            "a frame of the new time",
        )
        assert rest.force_n().tolist() == [0.0, 0.0, 0.0]
        client.send((0.0, 0.0, APEX_M - 0.0004), stamp_ns=rest.stamp_ns)
        client.wait(
            lambda: any(
                each.stamp_ns < pressed.stamp_ns and each.is_whole() and each.force_n()[2] > 0.0
                for each in list(client.frames.values())
            ),
            "a press in the new time",
        )

        clock.is_standing = True
        for part in ("frames", "clock"):
            silent = client.wait_for_state(
                part, lambda state: "/clock has not moved on" in state.message
            )
            assert silent.level is Level.WARN
