# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The topic cmd_vel of an arm: velocities are checked as a whole before the arm gets them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import TwistStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy

import msg_adapters
from dotsim_ros.control.arm.command import Twist, check_plausible
from dotsim_ros.io.documents import value_text
from dotsim_ros.io.printable import cut
from dotsim_ros.nodes.common.health import Report, fault_values, is_recent
from dotsim_ros.nodes.common.ingest import Fault, FaultLog
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.reasons import LONGEST_REASON
from msg_adapters import Level

COMMAND_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)


class VelocityInput:
    """The subscription of an arm's node to its commands.

    Args:
        node: owns it.
        base_frame, tool_frame: a velocity stamped with one of them is along its axes.
        take: takes a velocity (6,) that is one, and whether it is along the tool's axes.
        stop: called where one is not: the arm must not follow the one before.
    """

    def __init__(
        self,
        node: WorkingNode,
        *,
        base_frame: str,
        tool_frame: str,
        take: Callable[[Twist, bool], None],
        stop: Callable[[], None],
    ) -> None:
        self._node, self._take, self._stop = node, take, stop
        self._base_frame, self._tool_frame = base_frame, tool_frame
        self._faults = FaultLog()
        node.open_subscription(TwistStamped, "cmd_vel", self._on_command, COMMAND_QOS)

    def report(self, message: str, values: dict[str, str]) -> Report:
        """Return the state of the input: its newest fault for a while, else a message."""
        values = values | fault_values(self._faults)
        if is_recent(self._faults, self._node.now_s()):
            return Level.WARN, self._faults.last_reason, values
        return Level.OK, message, values

    def _on_command(self, message: TwistStamped) -> None:
        frame = message.header.frame_id
        if frame not in (self._base_frame, self._tool_frame):
            self._refuse(
                Fault.FRAME,
                f"frame_id of the velocity is {value_text(frame)}, expected {self._base_frame!r} "
                f"or {self._tool_frame!r}: stamp it with the frame whose axes it is along",
            )
            return
        try:
            twist = np.concatenate(msg_adapters.decode_twist_stamped(message))
            check_plausible(twist)
            # A sender whose clock makes no sense is not followed either; zero means now.
            msg_adapters.message_stamp_ns(message)
        except ValueError as error:
            self._stop()
            self._refuse(Fault.NUMBERS, f"{error}: the arm is stopped")
            return
        self._take(twist, frame == self._tool_frame)

    def _refuse(self, fault: Fault, reason: str) -> None:
        reason = cut(reason, LONGEST_REASON)
        if self._faults.note(fault, reason, self._node.now_s()):
            self._node.get_logger().warning(f"cmd_vel: {reason}")
