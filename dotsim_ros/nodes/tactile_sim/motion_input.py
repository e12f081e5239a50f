"""Subscriptions that move the indenter: poses, or a velocity that is integrated."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Lock

from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

import msg_adapters
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.twist import TwistFrame
from dotsim_ros.nodes.common.guarded_node import GuardedNode
from dotsim_ros.nodes.common.ingest import Fault, FaultLog, InputArbiter, RefusedInputError
from dotsim_ros.nodes.common.reasons import LONGEST_REASON
from dotsim_ros.nodes.tactile_sim.motion import (
    NANOSECONDS_PER_SECOND,
    MotionGate,
    MotionOrder,
    Velocity,
    velocity_axes,
)
from dotsim_ros.nodes.tactile_sim.parameters import (
    POSE,
    REALTIME,
    TWIST,
    TWIST_STAMPED,
    TactileSimParameters,
)
from dotsim_ros.printable import cut

# Only the newest counts, but a single one must not get lost. For a publisher of best effort the
# user overrides the reliability by parameter; ROS warns that the two do not match.
REALTIME_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
# The middleware keeps the newest meanwhile, so a flood of poses cannot starve the frames.
REALTIME_PAUSE_S = 0.002
# Every one counts: nothing is overwritten before it is simulated.
LOCKSTEP_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)


class MotionInput:
    """Receives what moves the indenter and passes on the motions that are valid.

    Args:
        node: owns the subscriptions.
        parameters: frames, input, clock and limits.
        faults: counts what is refused.
        on_motion: takes each valid motion; may refuse it by RefusedInputError.
    """

    def __init__(
        self,
        node: GuardedNode,
        parameters: TactileSimParameters,
        *,
        faults: FaultLog,
        on_motion: Callable[[MotionOrder], None],
    ) -> None:
        self._node = node
        self._parameters = parameters
        self._faults = faults
        self._on_motion = on_motion
        self._lock = Lock()
        self._arbiter = InputArbiter(timeout_s=parameters.input_timeout_s)
        self._gate = MotionGate(
            base_frame=parameters.base_frame,
            maximum_jump_m=parameters.maximum_jump_m,
            maximum_step_s=parameters.maximum_step_s,
        )
        self._pose = parameters.start_pose()
        self._velocity: Velocity | None = None
        self._twist_stamp_ns: int | None = None
        self._is_realtime = parameters.clock == REALTIME
        if parameters.input != TWIST:
            self._subscribe(PoseStamped, "indenter/pose", self._hear_pose)
        if parameters.input != POSE:
            kind = TwistStamped if parameters.twist_message == TWIST_STAMPED else Twist
            self._subscribe(kind, "indenter/twist", self._hear_twist)

    def silence_s(self) -> float | None:
        """Return for how long no input has come; None before the first."""
        return self._arbiter.silence_s(self._node.now_s())

    def forget(self) -> None:
        """Start anew: the next pose may be anywhere, a velocity begins at the start pose."""
        with self._lock:
            self._gate.forget()
            self._velocity = None
            self._twist_stamp_ns = None
            self._pose = self._parameters.start_pose()

    def configure(self, parameters: TactileSimParameters) -> None:
        """Take changed limits."""
        with self._lock:
            self._parameters = parameters
            self._arbiter.timeout_s = parameters.input_timeout_s
            self._gate.maximum_jump_m = parameters.maximum_jump_m
            self._gate.maximum_step_s = parameters.maximum_step_s

    def guard(self, act: Callable[[], object]) -> None:
        """Do something with an input; count and log it where it is refused."""
        try:
            act()
        except RefusedInputError as error:
            self._note(error.fault, str(error))
        except ValueError as error:
            self._note(Fault.NUMBERS, str(error))

    def integrate(self, stamp_ns: int, duration_s: float) -> None:
        """Move by the velocity in force, for the real-time clock; nothing where there is none."""
        with self._lock:
            velocity = self._velocity
            if velocity is None or self._arbiter.is_silent(self._node.now_s()):
                return
            start = self._pose
        self.guard(lambda: self._move(velocity.moved(start, duration_s), stamp_ns))

    def _subscribe(
        self, kind: type, topic: str, callback: Callable[[msg_adapters.Message], None]
    ) -> None:
        self._node.create_subscription(
            kind,
            topic,
            lambda message: self._hear(callback, message),
            REALTIME_QOS if self._is_realtime else LOCKSTEP_QOS,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def _hear(
        self, callback: Callable[[msg_adapters.Message], None], message: msg_adapters.Message
    ) -> None:
        self.guard(lambda: callback(message))
        if self._is_realtime and not self._node.is_simulated:
            time.sleep(REALTIME_PAUSE_S)

    def _note(self, fault: Fault, reason: str) -> None:
        reason = cut(reason, LONGEST_REASON)
        if self._faults.note(fault, reason, self._node.now_s()):
            self._node.get_logger().warning(f"input: {reason}")

    def _admit(self, name: str) -> None:
        """Let a message that was checked move the indenter; nothing of one that was not counts."""
        if self._arbiter.admit(name, self._node.now_s()):
            with self._lock:
                # The two inputs' stamps may come from different clocks.
                self._gate.forget()
                self._velocity = None
                self._twist_stamp_ns = None

    def _hear_pose(self, message: PoseStamped) -> None:
        pose, stamp_ns = Pose(*msg_adapters.decode_pose_stamped(message)), self._stamp_ns(message)
        self._gate.check(pose, frame_id=message.header.frame_id)
        self._admit("indenter/pose")
        self._move(pose, stamp_ns)

    def _hear_twist(self, message: TwistStamped | Twist) -> None:
        axes = TwistFrame.PARENT
        if isinstance(message, TwistStamped):
            axes = velocity_axes(
                message.header.frame_id,
                base_frame=self._parameters.base_frame,
                indenter_frame=self._parameters.indenter_frame,
            )
            linear, angular = msg_adapters.decode_twist_stamped(message)
        else:
            linear, angular = msg_adapters.decode_twist(message)
        velocity = Velocity(linear, angular, axes)
        # In real time too: a sender whose clock makes no sense is not followed.
        stamp_ns = self._stamp_ns(message) if isinstance(message, TwistStamped) else 0
        self._admit("indenter/twist")
        if self._is_realtime:
            with self._lock:
                self._velocity = velocity
            return
        last_ns, duration_s = self._twist_stamp_ns, 1.0 / self._parameters.rate_hz
        if last_ns is not None:
            duration_s = max(0.0, (stamp_ns - last_ns) / NANOSECONDS_PER_SECOND)
        # A silence is no motion: a controller that has stopped must not move the indenter on.
        duration_s = min(duration_s, self._parameters.input_timeout_s)
        self._move(velocity.moved(self._pose, duration_s), stamp_ns)
        self._twist_stamp_ns = stamp_ns

    def _stamp_ns(self, message: PoseStamped | TwistStamped) -> int:
        stamp_ns = msg_adapters.message_stamp_ns(message)
        # Tools that leave stamps at zero mean "now"; in lockstep there is no other clock.
        if stamp_ns == 0 and self._is_realtime:
            return self._node.time_ns()
        return stamp_ns

    def _move(self, pose: Pose, stamp_ns: int) -> None:
        with self._lock:
            motion = self._gate.hear(pose, stamp_ns, frame_id=self._parameters.base_frame)
            self._pose = pose
        if motion.new_start is not None:
            self._note(motion.new_start, f"new start, not a motion: {motion.new_start.value}")
        self._on_motion(motion)
