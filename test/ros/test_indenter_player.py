# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`indenter_player` as a process, its poses read over DDS."""

import time
from contextlib import closing

import numpy as np
import pytest
from free_clock import free_clock
from geometry_msgs.msg import PoseStamped, WrenchStamped
from harness import Watcher, refused_starts, running, with_parameters
from rclpy.qos import HistoryPolicy, QoSProfile
from rosgraph_msgs.msg import Clock

import msg_adapters
from dotsim_ros.data.shipped_presses import read_presses
from dotsim_ros.data.trajectory import PoseChannel, Topics, Trajectory, write_trajectory
from dotsim_ros.io.files import parameter_path
from dotsim_ros.nodes.indenter_player.node import IndenterPlayer

MODULE = "dotsim_ros.nodes.indenter_player.node"
RADIUS_M = 0.01575
KEEP_ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)
SHORT = {"depth_m": 0.0002, "clearance_m": 0.0003, "hold_s": 0.0}
"""A press of 21 poses."""


class Listener(Watcher):
    """Reads poses; answers the first ones, a while later, with a wrench of their stamp."""

    def __init__(self, *, answers=0, answer_after_s=0.02):
        self.poses = []
        self.written_ns = []
        self.answered_ns = []
        self._answers = answers
        self._answer_after_s = answer_after_s
        super().__init__("listener")
        self._wrench = self.node.create_publisher(WrenchStamped, "wrench", KEEP_ALL)
        self.node.create_subscription(PoseStamped, "indenter/pose", self._on_pose, KEEP_ALL)

    def _on_pose(self, message, info):
        self.written_ns.append(info["source_timestamp"])
        self.poses.append(message)
        if len(self.answered_ns) == self._answers:
            return
        time.sleep(self._answer_after_s)
        self.answered_ns.append(time.time_ns())
        stamp = {"stamp_ns": msg_adapters.message_stamp_ns(message), "frame_id": "densetact_base"}
        self._wrench.publish(msg_adapters.encode_wrench_stamped((0, 0, 0), (0, 0, 0), **stamp))

    def wait_for(self, count):
        self.wait(lambda: len(self.poses) >= count, f"{count} poses")

    def stamps_ns(self):
        return np.array([msg_adapters.message_stamp_ns(message) for message in self.poses])

    def positions_m(self):
        return np.array([msg_adapters.decode_pose_stamped(message)[0] for message in self.poses])


def played(listener, **parameters):
    """Run the player to its end; return its log."""
    with running(MODULE, parameters={"exit_at_end": "true", **parameters}) as player:
        status = player.exit_status()
    assert status == 0, player.log
    count = int(player.log.partition("played ")[2].split()[0])
    listener.wait_for(count)
    assert len(listener.poses) == count
    return player.log


def test_scripted_press_arrives_whole_and_in_order():
    with closing(Listener()) as listener:
        played(listener, source="press", depth_m=0.001, hold_s=0.1)
    depths = RADIUS_M - np.linalg.norm(listener.positions_m(), axis=1)
    assert depths[0] == pytest.approx(-0.002)
    assert depths.max() == pytest.approx(0.001)
    assert depths[-1] == pytest.approx(-0.002)
    # 3 mm in and out at 5 mm/s and a hold of 0.1 s, at 100 Hz.
    assert len(listener.poses) == 131
    assert set(np.diff(listener.stamps_ns())) == {10_000_000}
    assert {message.header.frame_id for message in listener.poses} == {"densetact_base"}


def test_real_presses_play_in_the_order_asked_for():
    numbers = [3, 0]
    with closing(Listener()) as listener:
        played(
            listener,
            source="presses",
            press_numbers=str(numbers),
            speed_m_s=0.05,
            hold_s=0.02,
            indenter_radius_m=0.003,
        )
    positions = listener.positions_m()
    recording = read_presses(parameter_path("presses/densetact_presses.npz"))
    ends = [
        recording[number].poses(outer_radius_m=RADIUS_M, indenter_radius_m=0.003)[-1].position_m
        for number in numbers
    ]
    away_m = [np.linalg.norm(positions - end_m, axis=1) for end_m in ends]
    deepest = [int(np.argmin(each)) for each in away_m]
    assert max(each.min() for each in away_m) < 1e-3
    assert deepest == sorted(deepest)
    # No jump: at 100 Hz and at most 50 mm/s, half a millimetre a pose.
    assert np.linalg.norm(np.diff(positions, axis=0), axis=1).max() < 0.51e-3


def test_bag_plays_its_own_poses_at_its_own_times(tmp_path):
    random = np.random.default_rng(1)
    stamps = 5_000_000_000 + np.cumsum(random.integers(10**7, 9 * 10**7, 12))
    quaternion = random.normal(size=(12, 4))
    channel = PoseChannel(
        stamps,
        random.normal(size=(12, 3)),
        quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True),
        "stage",
    )
    topics = Topics(pose="/arm/tip")
    write_trajectory(tmp_path / "bag", Trajectory(pose=channel), topics=topics)
    with closing(Listener()) as listener:
        played(listener, source="bag", path=tmp_path / "bag", bag_topic="/arm/tip")
    assert np.array_equal(listener.positions_m(), channel.position_m)
    assert np.array_equal(np.diff(listener.stamps_ns()), np.diff(stamps))
    assert {message.header.frame_id for message in listener.poses} == {"stage"}


def test_lockstep_waits_for_the_answer_to_each_pose_and_goes_on_where_none_comes():
    # Each answer takes longer than the period of the poses.
    with closing(Listener(answers=17)) as listener:
        log = played(listener, **SHORT, wait_for_answer="true", answer_timeout_s=0.3)
    # When a pose was written, not when it was read: they are read one after the other in any case.
    written_ns, answered_ns = np.array(listener.written_ns), np.array(listener.answered_ns)
    assert len(answered_ns) == 17
    assert (written_ns[1:18] > answered_ns).all()
    assert "no wrench answers" in log


def test_loop_goes_on_until_it_is_interrupted():
    parameters = {"loop": "true", **SHORT}
    with (
        closing(Listener()) as listener,
        running(MODULE, parameters=parameters) as player,
    ):
        listener.wait_for(60)  # a pass holds 21
        assert player.interrupt(2) == 0, player.log
    assert "Traceback" not in player.log
    assert (np.diff(listener.stamps_ns()) > 0).all()


def test_a_clock_that_stands_still_does_not_hold_the_end_up():
    """Simulated time that is stopped: a pause, or a simulation that has died."""
    with closing(Listener()) as listener:
        clock = listener.node.create_publisher(Clock, "/clock", KEEP_ALL)
        with running(MODULE, parameters={"use_sim_time": "true"}) as player:
            told_ns = 10**9

            def run_the_clock() -> bool:
                nonlocal told_ns
                told_ns += 10**7
                clock.publish(Clock(clock=msg_adapters.encode_stamp(told_ns)))
                time.sleep(0.005)
                return len(listener.stamps_ns()) >= 3

            while not run_the_clock():
                pass
            # What was on its way when it stopped may still come.
            time.sleep(0.3)
            assert listener.stamps_ns()[-1] <= told_ns, "it plays on while the clock stands"
            assert player.interrupt() == 0, player.log
    stamps_ns = listener.stamps_ns()
    assert (np.diff(stamps_ns) > 0).all()
    assert stamps_ns[-1] <= told_ns


REFUSED = {
    "expected one of press, slide, twist": {"source": "dance"},
    "needs path": {"source": "bag"},
    "no bag at /nowhere": {"source": "bag", "path": "/nowhere"},
    "no recording of presses": {"source": "presses", "path": "/nowhere"},
    "presses 0 to 11": {"source": "presses", "press_numbers": "[99]"},
    "depth_m": {"depth_m": -0.001},
    "below the dome's radius": {"depth_m": 0.05},
    "leaves the dome": {"source": "slide", "slide_distance_m": 0.05},
    "exclude each other": {"loop": "true", "exit_at_end": "true"},
}
"""Parameters that cannot work, by words of the reason."""


@pytest.fixture(scope="module")
def refusals():
    """Return the log of each start that must be refused, by words of the reason."""
    starts = {reason: with_parameters(given) for reason, given in REFUSED.items()}
    return refused_starts(IndenterPlayer, starts)


@pytest.mark.parametrize("reason", REFUSED)
def test_bad_parameters_are_refused_with_the_reason(refusals, reason):
    assert reason in refusals[reason]
    assert "Traceback" not in refusals[reason]


def test_where_time_begins_again_the_motion_does_and_a_leap_is_left_out():
    parameters = {"use_sim_time": True, "depth_m": 0.002, "hold_s": 30.0}
    with (
        free_clock(speed=1.0) as clock,
        closing(Listener()) as listener,
        running(MODULE, parameters=parameters),
    ):
        listener.wait_for(30)
        clock.jump(20.0)
        count = len(listener.poses)
        listener.wait_for(count + 30)
        clock.jump(-70.0)
        count = len(listener.poses)
        listener.wait_for(count + 60)
    stamps_s, heights_m = 1e-9 * listener.stamps_ns(), listener.positions_m()[:, 2]
    steps_s = np.diff(stamps_s)
    (leap,) = np.flatnonzero(steps_s > 1.0)
    (back,) = np.flatnonzero(steps_s < 0.0)
    assert leap < back
    assert steps_s[[leap, back]] == pytest.approx([20.0, -70.0], abs=2.0)
    # Every hundredth of a second, over the leap too, and from the first pose after the return.
    even = np.delete(steps_s, [leap, back])
    assert even == pytest.approx(np.full(len(even), 0.01), abs=1e-6)
    assert np.abs(np.diff(heights_m)[: back - 1]).max() < 6e-5
    # 2 mm above the apex, where a press begins.
    again_m = heights_m[back + 1 :]
    assert again_m[0] == pytest.approx(0.01575 + 0.002, abs=1e-9)
    # The very first poses may go before anyone reads them.
    unread = int(np.argmin(np.abs(again_m - heights_m[0])))
    assert unread < 10
    assert np.array_equal(again_m[unread:][:30], heights_m[:30])
