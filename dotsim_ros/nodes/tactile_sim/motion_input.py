# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Subscriptions that move the indenter: poses from a topic, odometry or TF, or a velocity that is
integrated."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

import numpy as np
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy

import msg_adapters
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.twist import TwistFrame
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import value_text
from dotsim_ros.io.printable import cut
from dotsim_ros.nodes.common.health import Report, fault_values, is_recent
from dotsim_ros.nodes.common.ingest import (
    Fault,
    FaultLog,
    InputArbiter,
    RefusedInputError,
    TimeRestart,
)
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.reasons import LONGEST_REASON
from dotsim_ros.nodes.tactile_sim.force_input import ForceInput
from dotsim_ros.nodes.tactile_sim.motion import (
    NANOSECONDS_PER_SECOND,
    MotionGate,
    MotionOrder,
    Velocity,
    velocity_axes,
)
from dotsim_ros.nodes.tactile_sim.parameters import (
    BY_FORCE,
    ODOMETRY,
    POSE,
    TF,
    TWIST,
    TWIST_STAMPED,
    TactileSimParameters,
)
from dotsim_ros.nodes.tactile_sim.transform_input import TransformInput
from msg_adapters import Level

# A fifth of a second at 100 Hz, in which a busy machine may not get to read: the indenter follows
# the path of all poses. More would delay a faster stream.
REALTIME_QOS = QoSProfile(depth=20, reliability=ReliabilityPolicy.RELIABLE)
# The middleware drops the oldest meanwhile, so a flood of poses cannot starve the frames.
REALTIME_PAUSE_S = 0.001
# Every one counts: nothing is overwritten before it is simulated.
LOCKSTEP_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
MISSING_LOG_S = 5.0


@dataclass(frozen=True)
class _Carried:
    """The newest odometry: a motion that its own velocity carries on until the next one."""

    motion: MotionOrder
    velocity: Velocity
    heard_s: float

    def at(self, now_s: float) -> MotionOrder:
        """Return the motion to where the indenter is by now."""
        age_s = max(0.0, now_s - self.heard_s)
        stamp_ns = self.motion.stamp_ns + round(age_s * NANOSECONDS_PER_SECOND)
        return MotionOrder(self.velocity.moved(self.motion.pose, age_s), stamp_ns, None)


class MotionInput:
    """Receives what moves the indenter and passes on the motions that are valid.

    Args:
        node: owns the subscriptions.
        parameters: frames, input, clock and limits.
        on_motion: takes each valid motion; may refuse it by RefusedInputError.

    Attributes:
        faults: counts what is refused.

    Raises:
        ValueError: the messages of the pose's source are not installed.
    """

    def __init__(
        self,
        node: WorkingNode,
        parameters: TactileSimParameters,
        *,
        on_motion: Callable[[MotionOrder], None],
    ) -> None:
        self._node = node
        self._parameters = parameters
        self.faults = FaultLog()
        self._on_motion = on_motion
        self._lock = Lock()
        self._time_restart = TimeRestart()
        self._arbiter = InputArbiter(timeout_s=parameters.motion.input_timeout_s)
        self._gate = MotionGate(
            base_frame=parameters.frames.base_frame,
            maximum_jump_m=parameters.motion.maximum_jump_m,
            maximum_step_s=parameters.motion.maximum_step_s,
        )
        self._pose = parameters.motion.start_pose()
        self._velocity: Velocity | None = None
        self._carried: _Carried | None = None
        # When the indenter was last moved; None before.
        self._moved_ns: int | None = None
        self._is_realtime = parameters.time.is_realtime
        self._started_s = node.now_s()
        self._forces: ForceInput | None = None
        if parameters.motion.control == BY_FORCE:
            self._forces = ForceInput(
                node,
                parameters,
                self._quality(),
                guard=self.guard,
                check_time=self._check_time,
                on_motion=on_motion,
            )
            if not self._is_realtime:
                self._on_motion = self._forces.hold
        self._transforms: TransformInput | None = None
        if parameters.motion.pose_source == TF:
            self._transforms = TransformInput(
                node,
                parameters,
                guard=self.guard,
                check_time=self._check_time,
                on_pose=self._take_transform,
            )
        elif parameters.motion.pose_source == ODOMETRY:
            self._subscribe(Odometry, "indenter/odometry", self._hear_odometry)
        elif parameters.motion.input != TWIST:
            self._subscribe(PoseStamped, "indenter/pose", self._hear_pose)
        if parameters.motion.input != POSE:
            kind = TwistStamped if parameters.motion.twist_message == TWIST_STAMPED else Twist
            self._subscribe(kind, "indenter/twist", self._hear_twist)

    def report(self) -> Report:
        """Return the state of the input, for the diagnostics; what is missing is logged, too."""
        now_s, timeout_s = self._node.now_s(), self._parameters.motion.input_timeout_s
        silence_s = self._arbiter.silence_s(now_s)
        values = {
            "silence_s": "none received" if silence_s is None else f"{silence_s:.2f}",
            **fault_values(self.faults),
        }
        missing = "" if now_s - self._started_s < timeout_s else self._missing()
        if missing:
            self._node.get_logger().warning(
                f"input: {missing}", throttle_duration_sec=MISSING_LOG_S
            )
        if is_recent(self.faults, now_s):
            return Level.WARN, self.faults.last_reason, values
        if missing:
            return Level.WARN, missing, values
        if silence_s is None:
            return Level.OK, "no input so far", values
        if self._is_realtime and silence_s > timeout_s:
            return Level.WARN, f"no input for {silence_s:.1f} s: the last frame holds", values
        return Level.OK, "input is valid", values

    def _missing(self) -> str:
        """Return why there can be no pose, or which force has not come, in words; empty where
        nothing is known to be wrong."""
        missing = "" if self._transforms is None else self._transforms.missing()
        if not missing and self._forces is not None:
            missing = self._forces.missing()
        return missing

    def normal_force_n(self, pose: Pose) -> float:
        """Return the normal force that the gel is to give on an indenter at a pose.

        Only where `control` is `force`.
        """
        assert self._forces is not None
        return self._forces.normal_n(pose)

    def world_rotation(self) -> FloatArray | None:
        """Return the (3, 3) rotation from the base to the world; None where it is not known yet."""
        if self._transforms is None or not self._parameters.frames.world_frame:
            return np.eye(3)
        return self._transforms.world_rotation()

    def forget(self) -> None:
        """Start again: the next pose may be anywhere, a velocity begins at the start pose."""
        if self._transforms is not None:
            self._transforms.forget()
        if self._forces is not None:
            self._forces.forget()
        with self._lock:
            self._gate.forget()
            self._velocity = None
            self._carried = None
            self._moved_ns = None
            self._pose = self._parameters.motion.start_pose()

    def restart(self, *, before_ns: int) -> None:
        """Start again, since the clock has gone back: stamps of its new time are accepted.

        Args:
            before_ns: the clock before.
        """
        early = self._time_restart.begin(
            before_ns=before_ns, now_ns=self._node.time_ns(), now_s=time.monotonic()
        )
        self.forget()
        if self._transforms is not None:
            self._transforms.restart()
        for act in early:
            self.guard(act)
        if self._transforms is not None:
            self.guard(self._transforms.pass_on)

    def leap(self) -> None:
        """Take what came before the clock that has leapt forward to it."""
        for act in self._time_restart.early(time.monotonic()):
            self.guard(act)

    def configure(self, parameters: TactileSimParameters) -> None:
        """Take changed limits."""
        with self._lock:
            self._parameters = parameters
            self._arbiter.timeout_s = parameters.motion.input_timeout_s
            self._gate.maximum_jump_m = parameters.motion.maximum_jump_m
            self._gate.maximum_step_s = parameters.motion.maximum_step_s
        if self._transforms is not None:
            self._transforms.configure(parameters)
        if self._forces is not None:
            self._forces.configure(parameters)

    def guard(self, act: Callable[[], object]) -> None:
        """Do something with an input; count and log it where it is refused."""
        try:
            act()
        except RefusedInputError as error:
            if error.fault is Fault.ORDER and self._node.is_simulated:
                self._time_restart.hold(act, time.monotonic())
            self._note(error.fault, str(error))
        except ValueError as error:
            self._note(Fault.NUMBERS, str(error))

    def integrate(self, stamp_ns: int, duration_s: float) -> None:
        """Move by the velocity in force, for the real-time clock; nothing where there is none."""
        now_s = self._node.now_s()
        with self._lock:
            velocity, carried = self._velocity, self._carried
            if self._arbiter.is_silent(now_s):
                return
            start = self._pose
        if carried is not None:
            self.guard(lambda: self._on_motion(carried.at(now_s)))
        if velocity is None:
            return
        self.guard(lambda: self._move(velocity.moved(start, duration_s), stamp_ns))

    def _subscribe(
        self, kind: type, topic: str, callback: Callable[[msg_adapters.Message], None]
    ) -> None:
        self._node.open_subscription(
            kind, topic, lambda message: self._hear(callback, message), self._quality()
        )

    def _quality(self) -> QoSProfile:
        return REALTIME_QOS if self._is_realtime else LOCKSTEP_QOS

    def _hear(
        self, callback: Callable[[msg_adapters.Message], None], message: msg_adapters.Message
    ) -> None:
        self.guard(lambda: callback(message))
        if self._is_realtime and not self._node.is_simulated:
            time.sleep(REALTIME_PAUSE_S)

    def _note(self, fault: Fault, reason: str) -> None:
        reason = cut(reason, LONGEST_REASON)
        if self.faults.note(fault, reason, self._node.now_s()):
            self._node.get_logger().warning(f"input: {reason}")

    def _admit(self, name: str) -> None:
        """Let a message that was checked move the indenter; nothing of one that was not counts."""
        if self._arbiter.admit(name, self._node.now_s()):
            with self._lock:
                # The two inputs' stamps may come from different clocks.
                self._gate.forget()
                self._velocity = None
                self._carried = None
                self._moved_ns = None

    def _hear_pose(self, message: PoseStamped) -> None:
        pose, stamp_ns = Pose(*msg_adapters.decode_pose_stamped(message)), self._stamp_ns(message)
        self._take("indenter/pose", pose, stamp_ns, frame_id=message.header.frame_id)

    def _take_transform(self, pose: Pose, stamp_ns: int) -> None:
        self._take("/tf", pose, stamp_ns, frame_id=self._parameters.frames.base_frame)

    def _hear_odometry(self, message: Odometry) -> None:
        placed, moving = msg_adapters.decode_odometry(message)
        pose, velocity = Pose(*placed), Velocity(*moving, TwistFrame.OWN)
        if message.child_frame_id != self._parameters.frames.indenter_frame:
            raise RefusedInputError(
                Fault.FRAME,
                f"child_frame_id of the odometry is {value_text(message.child_frame_id)}, expected "
                f"{self._parameters.frames.indenter_frame!r}: set the parameter indenter_frame, or "
                "have the odometry of the indenter published",
            )
        stamp_ns = self._stamp_ns(message)
        motion = self._take("indenter/odometry", pose, stamp_ns, frame_id=message.header.frame_id)
        if self._is_realtime:
            with self._lock:
                self._carried = _Carried(motion, velocity, self._node.now_s())

    def _take(self, name: str, pose: Pose, stamp_ns: int, *, frame_id: str) -> MotionOrder:
        self._gate.check(pose, frame_id=frame_id)
        self._admit(name)
        return self._move(pose, stamp_ns)

    def _hear_twist(self, message: TwistStamped | Twist) -> None:
        axes = TwistFrame.PARENT
        if isinstance(message, TwistStamped):
            axes = velocity_axes(
                message.header.frame_id,
                base_frame=self._parameters.frames.base_frame,
                indenter_frame=self._parameters.frames.indenter_frame,
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
        last_ns, duration_s = self._moved_ns, 1.0 / self._parameters.time.rate_hz
        if last_ns is not None:
            duration_s = max(0.0, (stamp_ns - last_ns) / NANOSECONDS_PER_SECOND)
        # A silence is no motion: a controller that has stopped must not move the indenter on.
        duration_s = min(duration_s, self._parameters.motion.input_timeout_s)
        self._move(velocity.moved(self._pose, duration_s), stamp_ns)

    def _stamp_ns(self, message: PoseStamped | TwistStamped | Odometry) -> int:
        stamp_ns = msg_adapters.message_stamp_ns(message)
        # Tools that leave stamps at zero mean "now"; in lockstep there is no other clock.
        if stamp_ns == 0 and self._is_realtime:
            return self._gate.stamp_of_now(self._node.time_ns())
        self._check_time(stamp_ns)
        return stamp_ns

    def _check_time(self, stamp_ns: int) -> None:
        """Refuse a message of the time before the clock went back."""
        self._time_restart.check(stamp_ns, self._node.time_ns())

    def _move(self, pose: Pose, stamp_ns: int) -> MotionOrder:
        with self._lock:
            motion = self._gate.hear(pose, stamp_ns, frame_id=self._parameters.frames.base_frame)
            # Together, whatever the gel says to it: the time up to here has passed.
            self._pose, self._moved_ns = pose, stamp_ns
        if motion.new_start is not None:
            self._note(motion.new_start, motion.reason)
        self._on_motion(motion)
        return motion
