# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`xarm_adapter`: between standard messages and the driver of a real xArm (xarm_msgs).

Velocities become calls of `vc_set_cartesian_velocity`; the arm's state becomes a pose.
"""

from __future__ import annotations

from threading import RLock
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy

import msg_adapters
from dotsim_ros.control.arm.command import ANGULAR, LINEAR, Twist
from dotsim_ros.nodes.common.declare import declare, follow
from dotsim_ros.nodes.common.health import Report, statuses_of
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.pace import FramePace
from dotsim_ros.nodes.common.spin import run_node
from dotsim_ros.nodes.common.velocity_input import VelocityInput
from dotsim_ros.nodes.xarm_adapter.link import Call, Hindrance, VelocityLink
from dotsim_ros.nodes.xarm_adapter.parameters import XarmAdapterParameters
from msg_adapters import Level, Status
from msg_adapters.xarm import move_velocity_service, robot_state_message

# The driver publishes reliably; best effort hears it either way, and only the newest counts.
STATE_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
POSE_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
WARN_EVERY_S = 2.0
REAL = "xArm"


class XarmAdapter(WorkingNode):
    """The node; parameters and topics as docs/arm.md lists them."""

    def __init__(self) -> None:
        super().__init__("xarm_adapter")
        if self.is_simulated:
            raise ValueError(
                "use_sim_time is set, and a real arm moves in real time: unset it, or use xarm_sim"
            )
        self._settings = declare(self, XarmAdapterParameters)
        service, state = _driver_types()
        self._lock = RLock()
        self._link = VelocityLink(self._settings)
        self._future: Any = None
        self._pace = FramePace(rate_hz=self._settings.rate_hz, start_s=self.now_s())
        self._client = self.create_client(service, self._settings.service)
        self._poses = self.open_publisher(PoseStamped, "ee_pose", POSE_QOS)
        self._input = VelocityInput(
            self,
            base_frame=self._settings.base_frame,
            tool_frame=self._settings.tool_frame,
            take=self._command,
            stop=self._drop,
        )
        self.create_subscription(state, self._settings.robot_states, self._on_state, STATE_QOS)
        self.report_health(
            self._settings.diagnostics_period_s,
            self._health,
            without_clock="poses cannot be stamped",
        )
        follow(self, lambda: self._settings, self._change_parameters)

    def begin(self) -> None:
        """Start to command the arm."""
        self._pace = FramePace(rate_hz=self._settings.rate_hz, start_s=self.now_s())
        self.start_paced("calls", lambda: self._pace, self._tick, "the loop of calls failed")
        self.get_logger().info(
            f"ready: {self._settings.service}, at most {self._settings.speed_limit_m_s:g} m/s, "
            f"watchdog {self._settings.duration_s:g} s"
        )

    def _tick(self) -> None:
        has_service = self._client.service_is_ready()
        with self._lock:
            call = self._link.next_call(self.now_s(), has_service=has_service)
            if self._future is not None and not self._link.is_waiting():
                # Nobody waits for that answer any more.
                self._client.remove_pending_request(self._future)
                self._future = None
            if call is not None:
                self._send(call)
            hindrance, detail = self._link.hindrance, self._link.detail
            wants = self._link.is_commanded(self.now_s())
        if wants and hindrance is not Hindrance.NONE:
            self.get_logger().warning(
                f"not commanding: {detail}", throttle_duration_sec=WARN_EVERY_S
            )

    def _send(self, call: Call) -> None:
        linear, angular = call.twist[LINEAR], call.twist[ANGULAR]
        request = msg_adapters.encode_move_velocity(
            linear, angular, along_tool=call.along_tool, duration_s=self._settings.duration_s
        )
        self._future = self._client.call_async(request)
        self._future.add_done_callback(self._on_answer)

    def _on_answer(self, future: Any) -> None:
        with self._lock:
            # The answer of a call that was given up is not that of the one under way.
            if future is not self._future:
                return
            self._future = None
            if future.exception() is not None:
                self._link.failed(f"the call failed: {future.exception()}")
            else:
                answer = future.result()
                self._link.answered(answer.ret, answer.message)
                if not answer.ret:
                    return
            refusal = self._link.last_refusal
        self.get_logger().warning(refusal, throttle_duration_sec=WARN_EVERY_S)

    def _command(self, twist: Twist, along_tool: bool) -> None:
        with self._lock:
            self._link.command(twist, self.now_s(), along_tool=along_tool)

    def _drop(self) -> None:
        with self._lock:
            self._link.drop()

    def _on_state(self, message: Any) -> None:
        try:
            robot = msg_adapters.decode_robot_state(message)
            stamp_ns = msg_adapters.message_stamp_ns(message) or self.time_ns()
            with self._lock:
                self._link.hear(robot, self.now_s())
        except ValueError as error:
            self.get_logger().warning(
                f"the arm's state is refused: {error}", throttle_duration_sec=WARN_EVERY_S
            )
            return
        self._poses.publish(
            msg_adapters.encode_pose_stamped(
                robot.position_m,
                robot.quaternion_xyzw,
                stamp_ns=stamp_ns,
                frame_id=self._settings.base_frame,
            )
        )

    def _health(self) -> list[Status]:
        with self._lock:
            link = self._link
            is_commanded = link.is_commanded(self.now_s())
            state = "commanded" if is_commanded else "no velocity: the arm stands"
            reports = {"arm": self._arm_report(), "input": self._input.report(state, {})}
        return statuses_of(self.label, REAL, reports)

    def _arm_report(self) -> Report:
        link, robot = self._link, self._link.robot
        counted = ("calls", "held_back", "refused", "failed")
        values = {
            **{name: str(link.counts[name]) for name in counted},
            "last_refusal": link.last_refusal,
            "hindrance": link.hindrance.value,
        }
        if robot is not None:
            values |= {
                "robot_mode": str(robot.mode),
                "robot_state": str(robot.state),
                "robot_error": str(robot.error),
                "robot_warning": str(robot.warning),
            }
        if link.hindrance is Hindrance.NONE:
            return Level.OK, "the arm takes velocities", values
        return Level.ERROR, f"not commanding: {link.detail}", values

    def _change_parameters(self, changed: XarmAdapterParameters) -> None:
        with self._lock:
            self._settings = changed
            self._link.settings = changed


def _driver_types() -> tuple[type, type]:
    """Return the service and the message of the arm's driver.

    Raises:
        ValueError: xarm_msgs is not installed.
    """
    try:
        return move_velocity_service(), robot_state_message()
    except ImportError as error:
        raise ValueError(
            f"{error}. xarm_msgs comes with UFACTORY's driver: build "
            "https://github.com/xArm-Developer/xarm_ros2 in a workspace and source it; without an "
            "arm use xarm_sim"
        ) from None


def main() -> int:
    """Run the node until it is stopped; return the exit status."""
    return run_node(XarmAdapter)


if __name__ == "__main__":
    raise SystemExit(main())
