# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What decides over the inputs of a node, without ROS: gate, arbiter, slot, faults."""

import numpy as np
import pytest

from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.twist import TwistFrame
from dotsim_ros.nodes.common.ingest import (
    EARLY_S,
    Fault,
    FaultLog,
    InputArbiter,
    RefusedInputError,
    TimeRestart,
)
from dotsim_ros.nodes.tactile_sim.motion import (
    HELD_MOTIONS,
    MotionGate,
    MotionOrder,
    MotionQueue,
    Velocity,
    velocity_axes,
)

SECOND = 1_000_000_000


def pose_at(x_m):
    return Pose(np.array([x_m, 0.0, 0.0]))


@pytest.fixture
def gate():
    gate = MotionGate(base_frame="base", maximum_jump_m=0.01, maximum_step_s=1.0)
    gate.hear(pose_at(0.0), 10 * SECOND, frame_id="base")
    return gate


def test_a_pose_goes_on_from_the_one_before(gate):
    assert gate.hear(pose_at(0.009), 11 * SECOND, frame_id="base").new_start is None


@pytest.mark.parametrize(
    ("x_m", "stamp_s", "fault"), [(0.011, 11, Fault.JUMP), (0.0, 8.9, Fault.RESTART)]
)
def test_a_jump_in_space_or_back_in_time_is_a_new_start(gate, x_m, stamp_s, fault):
    motion = gate.hear(pose_at(x_m), int(stamp_s * SECOND), frame_id="base")
    assert motion.new_start is fault


@pytest.mark.parametrize(
    ("stamp_s", "frame_id", "fault"),
    [(9.5, "base", Fault.ORDER), (10, "base", Fault.ORDER), (11, "map", Fault.FRAME)],
)
def test_a_refused_pose_leaves_what_was_heard_before(gate, stamp_s, frame_id, fault):
    with pytest.raises(RefusedInputError) as caught:
        gate.hear(pose_at(0.009), int(stamp_s * SECOND), frame_id=frame_id)
    assert caught.value.fault is fault
    # 11 mm from the refused pose would be 2 mm; from the one before it is a jump.
    assert gate.hear(pose_at(0.011), 11 * SECOND, frame_id="base").new_start is Fault.JUMP


def test_what_is_forgotten_leads_nowhere(gate):
    gate.forget()
    assert gate.hear(pose_at(1.0), SECOND, frame_id="base").new_start is None


def test_the_motions_of_a_frame_come_in_order_from_the_last_new_start_on():
    queue = MotionQueue()
    queue.put(MotionOrder(pose_at(0.0), 1, None))
    queue.put(MotionOrder(pose_at(1.0), 2, Fault.JUMP))
    queue.put(MotionOrder(pose_at(1.001), 3, None))
    motions = queue.take()
    assert [(motion.stamp_ns, motion.new_start) for motion in motions] == [
        (2, Fault.JUMP),
        (3, None),
    ]
    assert queue.take() == []


def test_a_flood_of_motions_is_thinned_and_keeps_the_new_start_and_the_newest():
    queue = MotionQueue()
    queue.put(MotionOrder(pose_at(0.0), 0, Fault.JUMP))
    for stamp_ns in range(1, 10 * HELD_MOTIONS):
        queue.put(MotionOrder(pose_at(1e-9 * stamp_ns), stamp_ns, None))
    stamps_ns = [motion.stamp_ns for motion in queue.take()]
    assert len(stamps_ns) <= HELD_MOTIONS
    assert (stamps_ns[0], stamps_ns[-1]) == (0, 10 * HELD_MOTIONS - 1)
    assert stamps_ns == sorted(stamps_ns)


def test_one_input_at_a_time_and_a_silent_one_gives_way():
    arbiter = InputArbiter(timeout_s=0.5)
    assert arbiter.silence_s(0.0) is None
    assert not arbiter.admit("pose", 1.0)
    with pytest.raises(RefusedInputError) as caught:
        arbiter.admit("twist", 1.4)
    assert caught.value.fault is Fault.BOTH
    assert arbiter.silence_s(1.4) == pytest.approx(0.4)
    assert arbiter.admit("twist", 1.6)
    assert not arbiter.admit("twist", 9.0)


def test_faults_are_all_counted_and_seldom_logged():
    faults = FaultLog(period_s=5.0)
    logged = [faults.note(Fault.JUMP, "far", now_s) for now_s in (0.0, 1.0, 4.9, 5.0)]
    assert logged == [True, False, False, True]
    assert faults.note(Fault.FRAME, "map", 5.1)
    assert faults.counts()[Fault.JUMP] == 4
    assert faults.counts()[Fault.GEL] == 0
    assert faults.last_reason == "map"


def test_a_velocity_is_along_the_axes_that_its_frame_says():
    quarter_turn = Pose(np.zeros(3), np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]))
    linear, angular = np.array([0.01, 0.0, 0.0]), np.zeros(3)
    for frame_id, expected in (("base", [0.005, 0.0, 0.0]), ("indenter", [0.0, 0.005, 0.0])):
        axes = velocity_axes(frame_id, base_frame="base", indenter_frame="indenter")
        moved = Velocity(linear, angular, axes).moved(quarter_turn, 0.5)
        assert moved.position_m == pytest.approx(expected)
    with pytest.raises(RefusedInputError, match="expected 'base' or 'indenter'"):
        velocity_axes("map", base_frame="base", indenter_frame="indenter")
    assert TwistFrame.OWN is velocity_axes("indenter", base_frame="b", indenter_frame="indenter")


def test_after_a_clock_went_back_a_message_of_the_time_before_is_refused_until_midway():
    restart = TimeRestart()
    restart.check(9 * SECOND, 9 * SECOND)
    assert restart.begin(before_ns=10 * SECOND, now_ns=0, now_s=0.0) == []
    for stamp_s, now_s in ((0.0, 0.0), (0.5, 0.1), (4.0, 4.0), (9.9, 6.0), (1.8e9, 0.1)):
        restart.check(int(stamp_s * SECOND), int(now_s * SECOND))
    for stamp_s, now_s in ((9.9, 0.0), (10.01, 0.1), (9.0, 4.0)):
        with pytest.raises(RefusedInputError, match="gone back") as caught:
            restart.check(int(stamp_s * SECOND), int(now_s * SECOND))
        assert caught.value.fault is Fault.ORDER


def test_what_was_refused_just_before_a_clock_went_back_is_done_again_once():
    restart = TimeRestart()
    restart.hold(lambda: "old", 0.0)
    restart.hold(lambda: "early", 1.0)
    acts = restart.begin(before_ns=SECOND, now_ns=0, now_s=0.9 + EARLY_S)
    assert [act() for act in acts] == ["early"]
    assert restart.begin(before_ns=SECOND, now_ns=0, now_s=1.0) == []
    restart.hold(lambda: "ahead", 2.0)
    assert [act() for act in restart.early(2.1)] == ["ahead"]
    assert restart.early(2.1) == []
