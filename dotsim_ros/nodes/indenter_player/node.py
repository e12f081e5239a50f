"""`indenter_player`: plays presses as poses of the indenter.

Publishes `indenter/pose` (PoseStamped) from scripted presses, recorded real presses or a bag.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator

from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.duration import Duration
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.utilities import try_shutdown

import msg_adapters
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.nodes.common.declare import declare
from dotsim_ros.nodes.common.spin import WorkingNode, run_node
from dotsim_ros.nodes.indenter_player.parameters import PlayerParameters, program_of

POSE_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
POLL_S = 0.02
SIMULATED_POLL_S = 0.001
WARN_EVERY_S = 5.0
FARTHEST_AHEAD_NS = 60_000_000_000


class IndenterPlayer(WorkingNode):
    """Plays a program from a thread of its own, at absolute deadlines."""

    def __init__(self) -> None:
        super().__init__("indenter_player")
        self._settings = declare(self, PlayerParameters)
        self._program = program_of(self._settings)
        self._publisher = self.create_publisher(
            PoseStamped,
            "indenter/pose",
            POSE_QOS,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        self._answered = threading.Condition()
        self._answered_stamp_ns = self._sent_stamp_ns = -1
        if self._settings.wait_for_answer:
            self.create_subscription(WrenchStamped, "wrench", self._on_answer, POSE_QOS)

    def begin(self) -> None:
        """Start to play."""
        self.start_thread("player", self._play, "the player failed")
        self.get_logger().info(
            f"ready: {self._settings.source}, {self._program.motion.duration_s:.2f} s of motion on "
            f"{self._publisher.topic_name}"
        )

    def _on_answer(self, message: WrenchStamped) -> None:
        stamp_ns = msg_adapters.message_stamp_ns(message)
        with self._answered:
            # One such stamp would answer all that is still to come.
            if stamp_ns > self._sent_stamp_ns + FARTHEST_AHEAD_NS:
                raise ValueError(
                    "the wrench is stamped a minute and more after the newest pose, so it answers "
                    "none: its sender must give it the pose's stamp (clock: lockstep)"
                )
            self._answered_stamp_ns = max(stamp_ns, self._answered_stamp_ns)
            self._answered.notify_all()

    def _play(self) -> None:
        if not (self._wait_for_clock() and self._wait_for_subscriber()):
            return
        count = 0
        start_ns = self.time_ns()
        start_s = time.monotonic()
        for time_s, pose in self._poses():
            stamp_ns = start_ns + round(time_s * 1e9)
            if not self._wait_until(stamp_ns, start_s + time_s):
                return
            self._publish(stamp_ns, pose)
            count += 1
            if self._settings.wait_for_answer:
                self._wait_for_answer(stamp_ns)
        self._publisher.wait_for_all_acked(Duration(seconds=2))
        self.get_logger().info(f"played {count} poses, {time_s:.2f} s of motion")
        if self._settings.exit_at_end:
            try_shutdown()

    def _poses(self) -> Iterator[tuple[float, Pose]]:
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
                    yield offset_s + time_s, pose
            if not self._settings.loop:
                return
            offset_s += program.motion.duration_s

    def _publish(self, stamp_ns: int, pose: Pose) -> None:
        with self._answered:
            self._sent_stamp_ns = stamp_ns
        self._publisher.publish(
            msg_adapters.encode_pose_stamped(
                pose.position_m,
                pose.quaternion_xyzw,
                stamp_ns=stamp_ns,
                frame_id=self._program.frame_id,
            )
        )

    def _wait_for_clock(self) -> bool:
        warned = -WARN_EVERY_S
        while self.time_ns() == 0:
            if time.monotonic() - warned > WARN_EVERY_S:
                self.get_logger().warning(
                    "use_sim_time is set and no /clock comes, or one beyond what a stamp holds: "
                    "waiting"
                )
                warned = time.monotonic()
            if self.stopping.wait(POLL_S):
                return False
        return True

    def _wait_for_subscriber(self) -> bool:
        deadline = time.monotonic() + self._settings.wait_for_subscriber_s
        while (count := self._publisher.get_subscription_count()) < self._settings.subscriber_count:
            if time.monotonic() >= deadline:
                self.get_logger().warning(
                    f"{count} subscribers of {self._publisher.topic_name} instead of "
                    f"{self._settings.subscriber_count}: playing anyway"
                )
                return True
            if self.stopping.wait(POLL_S):
                return False
        return True

    def _wait_until(self, stamp_ns: int, deadline_s: float) -> bool:
        """Wait for a time; return False where the node is to stop.

        Args:
            stamp_ns: the time on the node's clock, which counts where simulated time is used.
            deadline_s: the same on the monotonic clock, which no correction of the time moves.
        """
        if self.get_parameter("use_sim_time").value:
            # Not Clock.sleep_until, which nothing ends while the clock stands still.
            while self.time_ns() < stamp_ns:
                if self.stopping.wait(SIMULATED_POLL_S):
                    return False
            return True
        return not self.stopping.wait(max(0.0, deadline_s - time.monotonic()))

    def _wait_for_answer(self, stamp_ns: int) -> None:
        deadline = time.monotonic() + self._settings.answer_timeout_s
        with self._answered:
            while self._answered_stamp_ns < stamp_ns and not self.stopping.is_set():
                remaining_s = deadline - time.monotonic()
                if remaining_s <= 0.0:
                    self.get_logger().warning(
                        f"no wrench answers the pose of {stamp_ns} ns within "
                        f"{self._settings.answer_timeout_s:g} s: going on",
                        throttle_duration_sec=WARN_EVERY_S,
                    )
                    return
                self._answered.wait(min(remaining_s, POLL_S))


def main() -> None:
    """Run the executable."""
    sys.exit(run_node(IndenterPlayer))


if __name__ == "__main__":
    main()
