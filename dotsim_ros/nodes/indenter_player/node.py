# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`indenter_player`: plays presses as poses of the indenter.

Publishes `indenter/pose` (PoseStamped) from scripted presses, recorded real presses or a bag.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.utilities import try_shutdown

import msg_adapters
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.nodes.common.clock_watch import ClockJump
from dotsim_ros.nodes.common.declare import declare
from dotsim_ros.nodes.common.ingest import TimeRestart
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.spin import run_node
from dotsim_ros.nodes.indenter_player.parameters import PlayerParameters
from dotsim_ros.nodes.indenter_player.program import program_of

POSE_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
POLL_S = 0.02
ANSWER_POLL_S = 0.001
FOREVER_S = 1e6
AGAIN_S = 0.1
"""A player that has ended looks so often whether simulated time has begun again."""
WARN_EVERY_S = 5.0
FARTHEST_AHEAD_NS = 60_000_000_000


class IndenterPlayer(WorkingNode):
    """Plays a program at absolute deadlines."""

    def __init__(self) -> None:
        super().__init__("indenter_player")
        self._settings = declare(self, PlayerParameters)
        self._program = program_of(self._settings)
        self._publisher = self.open_publisher(PoseStamped, "indenter/pose", POSE_QOS)
        self._forces: Publisher | None = None
        if self._program.forces is not None:
            self._forces = self.open_publisher(WrenchStamped, "indenter/wrench", POSE_QOS)
        self._answered = threading.Condition()
        self._time_restart = TimeRestart()
        if self._settings.wait_for_answer:
            self.create_subscription(WrenchStamped, "wrench", self._on_answer, POSE_QOS)
        self._restart()
        self.on_clock_jump(self._follow_jump)
        self._patience_end_s = time.monotonic() + self._settings.wait_for_subscriber_s
        if self.is_simulated:
            self.create_timer(
                WARN_EVERY_S, self._warn_of_silence, clock=Clock(clock_type=ClockType.STEADY_TIME)
            )

    def _restart(self) -> None:
        """Let the first pose be the next one, and no answer have come."""
        self._poses = self._program_poses()
        self._next: tuple[float, Pose, FloatArray | None] | None = None
        self._start_s: float | None = None
        self._start_ns = 0
        self._look_s = self.now_s()
        self._count = 0
        self._asked_s: float | None = None
        with self._answered:
            self._answered_stamp_ns = self._sent_stamp_ns = -1

    def _follow_jump(self, jump: ClockJump) -> None:
        if jump.is_restart:
            self._time_restart.begin(
                before_ns=jump.before_ns, now_ns=jump.now_ns, now_s=time.monotonic()
            )
            self._restart()
        else:
            self._start_ns += jump.shift_ns

    def begin(self) -> None:
        """Start to play."""
        self._patience_end_s = time.monotonic() + self._settings.wait_for_subscriber_s
        self.start_work("player", self, "the player failed")
        self.get_logger().info(
            f"ready: {self._settings.source}, {self._program.motion.duration_s:.2f} s of motion on "
            f"{self._publisher.topic_name}"
        )

    def deadline_s(self) -> float:
        """Return when to look, or to publish, next."""
        return self._look_s

    def run(self, now_s: float) -> None:
        """Publish the pose that is due, once somebody hears it and has answered the one before."""
        if self._start_s is None:
            if self._must_wait_for_subscribers():
                self._look_s = now_s + POLL_S
                return
            self._start_s, self._start_ns = now_s, self.time_ns()
            self._next = next(self._poses)
        if self._must_wait_for_answer(now_s):
            self._look_s = now_s + ANSWER_POLL_S
            return
        self._asked_s = None
        if self._next is None:
            self._end()
            return
        time_s, pose, force_n = self._next
        if self._start_s + time_s <= now_s:
            self._publish(self._start_ns + round(time_s * 1e9), pose, force_n)
            self._count += 1
            self._asked_s = now_s if self._settings.wait_for_answer else None
            self._next = next(self._poses, None)
        if self._next is None:
            self._look_s = now_s
        else:
            self._look_s = self._start_s + self._next[0]

    def _end(self) -> None:
        self._look_s = self.now_s() + (AGAIN_S if self.is_simulated else FOREVER_S)
        if self._count == 0:
            return
        self._publisher.wait_for_all_acked(Duration(seconds=2))
        duration_s = self._program.motion.duration_s
        self.get_logger().info(f"played {self._count} poses, {duration_s:.2f} s of motion")
        self._count = 0
        if self._settings.exit_at_end:
            try_shutdown()

    def _program_poses(self) -> Iterator[tuple[float, Pose, FloatArray | None]]:
        program = self._program
        offset_s = 0.0
        while True:
            samples = (
                program.motion.sampled(program.rate_hz)
                if program.rate_hz > 0.0
                else program.motion.keyframes()
            )
            for time_s, pose in samples:
                # The end of a loop is the start of the next.
                if offset_s == 0.0 or time_s > 0.0:
                    force_n = None if program.forces is None else program.forces.at(time_s)
                    yield offset_s + time_s, pose, force_n
            if not self._settings.loop:
                return
            offset_s += program.motion.duration_s

    def _on_answer(self, message: WrenchStamped) -> None:
        stamp_ns = msg_adapters.message_stamp_ns(message)
        self._time_restart.check(stamp_ns, self.time_ns())
        with self._answered:
            # One such stamp would answer all that is still to come.
            if stamp_ns > self._sent_stamp_ns + FARTHEST_AHEAD_NS:
                raise ValueError(
                    "the wrench is stamped a minute and more after the newest pose, so it answers "
                    "none: its sender must give it the pose's stamp (clock: lockstep)"
                )
            self._answered_stamp_ns = max(stamp_ns, self._answered_stamp_ns)
            self._answered.notify_all()

    def _publish(self, stamp_ns: int, pose: Pose, force_n: FloatArray | None) -> None:
        with self._answered:
            self._sent_stamp_ns = stamp_ns
        # Before the pose, so that a sensor in real time has it with the pose.
        if self._forces is not None and self._program.forces is not None and force_n is not None:
            self._forces.publish(
                msg_adapters.encode_wrench_stamped(
                    force_n,
                    np.zeros(3),
                    stamp_ns=stamp_ns,
                    frame_id=self._program.forces.frame_id,
                )
            )
        self._publisher.publish(
            msg_adapters.encode_pose_stamped(
                pose.position_m,
                pose.quaternion_xyzw,
                stamp_ns=stamp_ns,
                frame_id=self._program.frame_id,
            )
        )

    def _warn_of_silence(self) -> None:
        if self.time_ns() == 0:
            self.get_logger().warning(
                "use_sim_time is set and no /clock comes, or one beyond what a stamp holds: waiting"
            )

    def _must_wait_for_subscribers(self) -> bool:
        # Steps begin when all participants are connected.
        if self.is_stepped:
            return False
        count, wanted = self._publisher.get_subscription_count(), self._settings.subscriber_count
        are_forces_heard = self._forces is None or self._forces.get_subscription_count() > 0
        if count >= wanted and are_forces_heard:
            return False
        if time.monotonic() < self._patience_end_s:
            return True
        unheard = "" if are_forces_heard else ", and none of its forces"
        self.get_logger().warning(
            f"{count} subscribers of {self._publisher.topic_name} instead of {wanted}{unheard}: "
            "playing anyway"
        )
        return False

    def _must_wait_for_answer(self, now_s: float) -> bool:
        """Return whether the newest pose has no answer yet; wait a little for it where it may come
        meanwhile."""
        if self._asked_s is None:
            return False
        with self._answered:
            if not self.is_simulated:
                self._answered.wait_for(self._is_answered, POLL_S)
            if self._is_answered():
                return False
        if self.now_s() < self._asked_s + self._settings.answer_timeout_s:
            return True
        self.get_logger().warning(
            f"no wrench answers the pose of {self._sent_stamp_ns} ns within "
            f"{self._settings.answer_timeout_s:g} s: going on",
            throttle_duration_sec=WARN_EVERY_S,
        )
        return False

    def _is_answered(self) -> bool:
        return self._answered_stamp_ns >= self._sent_stamp_ns


def main() -> None:
    """Run the executable."""
    sys.exit(run_node(IndenterPlayer))


if __name__ == "__main__":
    main()
