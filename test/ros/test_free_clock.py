# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Nodes that follow /clock by themselves, without steps: slower than real time, and standing."""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from arm_rig import ArmClient
from free_clock import free_clock
from harness import running
from policy_rig import policy_and_rig, write_network

import msg_adapters

SPEED_M_S = 0.01
SLOWNESS = 0.5
STANDSTILL_S = 1.0


def test_the_arm_goes_by_the_simulated_time() -> None:
    with (
        free_clock(speed=SLOWNESS) as clock,
        running("dotsim_ros.nodes.xarm_sim.node", parameters={"use_sim_time": True}),
        closing(ArmClient("xarm_sim")) as client,
    ):
        client.meet()
        to_the_right = lambda _: ((SPEED_M_S, 0.0, 0.0), (0.0, 0.0, 0.0))  # noqa: E731
        begun_s = 1e-9 * clock.now_ns()
        client.lead(2.0 / SLOWNESS, to_the_right)

        clock.is_standing = True
        # What was on its way may still come.
        client.lead(0.3, to_the_right)
        standing = client.count("ee_pose")
        client.lead(STANDSTILL_S, to_the_right)
        assert client.count("ee_pose") == standing
        clock.is_standing = False
        client.lead(0.5 / SLOWNESS, to_the_right)
        end_ns = round(1e9 * (begun_s + 2.4))
        client.wait(
            lambda: msg_adapters.message_stamp_ns(client.heard["ee_pose"][-1][1]) >= end_ns,
            "the last poses",
        )

        messages = [message for _, message in client.heard["ee_pose"]]
        stamps_s = 1e-9 * np.array([msg_adapters.message_stamp_ns(each) for each in messages])
        x_m = np.array([msg_adapters.decode_pose_stamped(each)[0][0] for each in messages])
        assert (np.diff(stamps_s) >= 0.0).all()
        ways_m = np.interp([begun_s + 0.5, begun_s + 1.5, begun_s + 2.4], stamps_s, x_m)
        # 10 mm in a simulated second, and as fast over the standstill.
        assert ways_m[1] - ways_m[0] == pytest.approx(SPEED_M_S, rel=0.01)
        assert ways_m[2] - ways_m[1] == pytest.approx(0.9 * SPEED_M_S, rel=0.01)


def test_the_policy_takes_a_standing_clock_for_no_jump_and_stops_at_one(tmp_path: Path) -> None:
    network = write_network(tmp_path / "policy")
    with (
        free_clock(speed=1.0) as clock,
        policy_and_rig(network, now_ns=clock.now_ns, use_sim_time="true") as (_, rig),
    ):
        rig.start()
        rig.has_images = rig.has_poses = rig.has_forces = False
        clock.is_standing = True
        # What was on its way has come.
        time.sleep(0.3)
        count = len(rig.commands)
        time.sleep(STANDSTILL_S)
        assert len(rig.commands) == count
        rig.has_images = rig.has_poses = rig.has_forces = True
        clock.is_standing = False
        rig.wait(lambda: len(rig.commands) > count + 50, "commands")
        assert rig.state().values["state"] != "latched"
        rig.wait(lambda: rig.newest().moves(), "a motion")
        stamps_s = [command.stamp_s for command in rig.commands]
        assert stamps_s == sorted(stamps_s)

        for jump_s in (50.0, -50.0):
            begun_s = rig.commands[-1].stamp_s
            clock.jump(jump_s)
            rig.wait_for_reason("latched", "clock_jump")
            rig.wait(
                lambda at_s=begun_s + jump_s: abs(rig.commands[-1].stamp_s - at_s) < 20.0,
                "the new time",
            )
            assert not rig.newest().moves()
            # It leads again when it is asked.
            rig.start()
