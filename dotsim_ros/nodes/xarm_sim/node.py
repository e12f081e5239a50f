# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`xarm_sim`: stands where the driver of an xArm 7 would.

A velocity of the tool goes in; its pose, its velocity and the joints come out, and the pose of a
fixed indenter as the sensor on the tool sees it.
"""

from __future__ import annotations

from threading import RLock
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

import msg_adapters
from dotsim_ros.control.arm.command import ANGULAR, LINEAR, Twist
from dotsim_ros.control.arm.kinematics import JOINT_NAMES, SINGULAR_M, ArmKinematics
from dotsim_ros.control.arm.simulated import ArmFaults, ArmState, SimulatedArm
from dotsim_ros.geometry.pose import Pose, compose, inverse
from dotsim_ros.nodes.common.declare import declare, follow
from dotsim_ros.nodes.common.health import Report, statuses_of
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.pace import FramePace
from dotsim_ros.nodes.common.spin import run_node
from dotsim_ros.nodes.common.velocity_input import VelocityInput
from dotsim_ros.nodes.xarm_sim.parameters import XarmSimParameters
from msg_adapters import Level, Status

FEEDBACK_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
SIMULATED = "simulated xArm 7"
CLOCK_TOLERANCE_S = 1e-4
CLOCK_TRIES = 4


class XarmSim(WorkingNode):
    """The node; parameters, topics and services as docs/arm.md lists them."""

    def __init__(self) -> None:
        super().__init__("xarm_sim")
        self._settings = declare(self, XarmSimParameters)
        self._lock = RLock()
        self._heard_s = -np.inf
        self._published = 0
        self._ahead_ns: int | None = None
        self._start_s = self.now_s()
        self._arm = self._make_arm(self._start_s)
        self._pace = self._new_pace()
        self._place_indenter()
        self._poses = self.open_publisher(PoseStamped, "ee_pose", FEEDBACK_QOS)
        self._twists = self.open_publisher(TwistStamped, "ee_twist", FEEDBACK_QOS)
        self._joints = self.open_publisher(JointState, "joint_states", FEEDBACK_QOS)
        self._indenters = self.open_publisher(PoseStamped, "indenter/pose", FEEDBACK_QOS)
        self._input = VelocityInput(
            self,
            base_frame=self._settings.base_frame,
            tool_frame=self._settings.tool_frame,
            take=self._command,
            stop=self._halt,
        )
        self.report_health(
            self._settings.diagnostics_period_s,
            self._health,
            without_clock="poses cannot be stamped",
        )
        self.create_service(Trigger, "~/emergency_stop", self._on_emergency_stop)
        self.create_service(Trigger, "~/reset", self._on_reset)
        follow(self, lambda: self._settings, self._change_parameters)

    def begin(self) -> None:
        """Start the arm."""
        self._pace = self._new_pace()
        self.start_paced("arm", lambda: self._pace, self._tick, "the simulation of the arm failed")
        self.get_logger().info(
            f"ready: tool at {np.round(self._arm.state.pose.position_m, 4).tolist()} m in "
            f"{self._settings.base_frame}"
        )

    def _new_pace(self) -> FramePace:
        """Return deadlines from now on that fall on the grid of the arm's states."""
        rate_hz = self._settings.rate_hz
        passed = np.ceil((self.now_s() - self._start_s) * rate_hz)
        return FramePace(rate_hz=rate_hz, start_s=self._start_s + passed / rate_hz)

    def _make_arm(self, start_s: float) -> SimulatedArm:
        settings = self._settings
        kinematics = ArmKinematics(joint_speed_rad_s=settings.joint_speed_limit_rad_s)
        try:
            joints = kinematics.joints_at(settings.pose("start_pose"))
        except ValueError as error:
            raise ValueError(f"start_pose: {error}") from None
        kinematics.posture_rad = joints
        arm = SimulatedArm(
            kinematics,
            joints,
            limits=settings.tool,
            response=settings.response,
            start_s=start_s,
            seed=settings.seed,
        )
        arm.fail(settings.faults, start_s)
        return arm

    def _place_indenter(self) -> None:
        settings = self._settings
        self._indenter = settings.pose("indenter_pose")
        self._sensor = settings.pose("tool_from_sensor")

    def _tick(self) -> None:
        now_s, ahead_ns = self._clocks()
        with self._lock:
            state, heard = self._arm.advance(now_s), self._arm.feedback(now_s)
            sensor, indenter = self._sensor, self._indenter
            shows_indenter = self._settings.publish_indenter
        # use_sim_time without /clock: there is no time to stamp anything with.
        if ahead_ns is None:
            return
        if shows_indenter and self._indenters.get_subscription_count():
            seen = compose(inverse(compose(state.pose, sensor)), indenter)
            self._publish_pose(
                self._indenters,
                seen,
                stamp_ns=_stamp_of(state, ahead_ns),
                frame_id=self._settings.sensor_frame,
            )
        if heard is not None:
            self._publish(heard, _stamp_of(heard, ahead_ns))

    def _clocks(self) -> tuple[float, int | None]:
        """Return the node's time (s), and how far the one that stamps is ahead of it (ns), None
        where it stands at zero.

        In simulated time both are one. Else another process may run between the two readings; then
        they are read again. A difference that could come from that counts as none: a state that is
        published twice has the same stamp, never one that runs back.
        """
        if self.is_simulated:
            now_s, stamp_ns = self.now_s(), self.time_ns()
            return now_s, stamp_ns - round(1e9 * now_s) if stamp_ns else None
        readings = []
        for _ in range(CLOCK_TRIES):
            before_s = self.now_s()
            stamp_ns = self.time_ns()
            after_s = self.now_s()
            readings.append((after_s - before_s, 0.5 * (before_s + after_s), stamp_ns))
            if after_s - before_s < CLOCK_TOLERANCE_S:
                break
        spent_s, now_s, stamp_ns = min(readings)
        if stamp_ns == 0:
            return now_s, None
        ahead_ns = stamp_ns - round(1e9 * now_s)
        known_ns = self._ahead_ns
        if known_ns is None or abs(ahead_ns - known_ns) > 1e9 * (spent_s + CLOCK_TOLERANCE_S):
            self._ahead_ns = ahead_ns
            return now_s, ahead_ns
        return now_s, known_ns

    def _publish(self, state: ArmState, stamp_ns: int) -> None:
        frame_id = self._settings.base_frame
        self._publish_pose(self._poses, state.pose, stamp_ns=stamp_ns, frame_id=frame_id)
        if self._twists.get_subscription_count():
            self._twists.publish(
                msg_adapters.encode_twist_stamped(
                    state.twist[LINEAR], state.twist[ANGULAR], stamp_ns=stamp_ns, frame_id=frame_id
                )
            )
        if self._joints.get_subscription_count():
            self._joints.publish(
                msg_adapters.encode_joint_state(
                    JOINT_NAMES,
                    state.joints_rad,
                    state.motion.rates_rad_s,
                    stamp_ns=stamp_ns,
                    frame_id=frame_id,
                )
            )
        self._published += 1

    def _publish_pose(self, publisher: Any, pose: Pose, *, stamp_ns: int, frame_id: str) -> None:
        publisher.publish(
            msg_adapters.encode_pose_stamped(
                pose.position_m, pose.quaternion_xyzw, stamp_ns=stamp_ns, frame_id=frame_id
            )
        )

    def _command(self, twist: Twist, along_tool: bool) -> None:
        with self._lock:
            self._heard_s = self.now_s()
            self._arm.command(twist, self._heard_s, along_tool=along_tool)

    def _halt(self) -> None:
        with self._lock:
            self._arm.halt(self.now_s())

    def _health(self) -> list[Status]:
        with self._lock:
            reports = {"arm": self._arm_report(), "input": self._input_report()}
        return statuses_of(self.label, SIMULATED, reports)

    def _arm_report(self) -> Report:
        arm, motion, twist = self._arm, self._arm.state.motion, self._arm.state.twist
        held = [JOINT_NAMES[index] for index in motion.at_limit]
        values = {
            "speed_m_s": f"{float(np.linalg.norm(twist[LINEAR])):.4f}",
            "angular_speed_rad_s": f"{float(np.linalg.norm(twist[ANGULAR])):.4f}",
            "fastest_joint_rad_s": f"{float(np.abs(motion.rates_rad_s).max()):.3f}",
            "smallest_singular_value_m": f"{motion.smallest_m:.4f}",
            "joints_at_limit": ", ".join(held) or "none",
            "feedback_count": str(self._published),
            "late": str(self._pace.late),
            "dropped": str(self._pace.dropped),
            "emergency_stop": str(arm.is_emergency).lower(),
            "fail_drop_feedback": str(arm.faults.fail_drop_feedback).lower(),
            "fail_delay_s": f"{arm.faults.fail_delay_s:g}",
            "fail_stop": str(arm.faults.fail_stop).lower(),
        }
        if arm.is_emergency:
            return Level.ERROR, "emergency stop: call reset to continue", values
        if arm.faults != ArmFaults():
            return Level.WARN, "failing on request", values
        if held:
            return Level.WARN, f"held back by the limit of {', '.join(held)}", values
        if motion.slowed < 1.0:
            return Level.WARN, "slowed down: a joint is at its greatest speed", values
        if motion.smallest_m < SINGULAR_M:
            return Level.WARN, "nearly singular: some directions are slowed down", values
        return Level.OK, "standing" if arm.is_stale() else "following", values

    def _input_report(self) -> Report:
        silence_s = self.now_s() - self._heard_s
        message = "input is valid"
        if not np.isfinite(silence_s):
            message = "no velocity so far"
        elif self._arm.is_stale():
            message = f"no velocity for {silence_s:.1f} s: the arm stands"
        shown = f"{silence_s:.2f}" if np.isfinite(silence_s) else "none received"
        return self._input.report(message, {"silence_s": shown})

    def _on_emergency_stop(self, _request: Any, response: Any) -> Any:
        with self._lock:
            self._arm.emergency_stop(self.now_s())
        self.get_logger().warning("emergency stop: call reset to continue")
        response.success, response.message = True, "stopped: call reset to continue from the start"
        return response

    def _on_reset(self, _request: Any, response: Any) -> Any:
        with self._lock:
            self._arm.reset(self.now_s())
        response.success, response.message = True, "the arm is at its start, at rest"
        return response

    def _change_parameters(self, changed: XarmSimParameters) -> None:
        with self._lock:
            self._settings = changed
            self._place_indenter()
            if changed.faults != self._arm.faults:
                self._arm.fail(changed.faults, self.now_s())
                self.get_logger().warning(f"failing on request: {changed.faults}")


def _stamp_of(state: ArmState, ahead_ns: int) -> int:
    """Return the time of a state on the clock that stamps, so far ahead of the steady one."""
    return max(0, ahead_ns + round(1e9 * state.time_s))


def main() -> int:
    """Run the node until it is stopped; return the exit status."""
    return run_node(XarmSim)


if __name__ == "__main__":
    raise SystemExit(main())
