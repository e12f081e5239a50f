# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What is sent to a real arm that takes velocities by service, and when nothing may be sent.

Needs no ROS and no clock: times are handed in.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from dotsim_ros.control.arm.command import Twist, check_reach, zero_twist
from dotsim_ros.nodes.xarm_adapter.parameters import XarmAdapterParameters
from msg_adapters import RobotState

VELOCITY_MODE = 5
READY_STATES = (0, 1, 2)
STATE_NAMES = {3: "paused", 4: "stopped", 5: "set up again and not ready"}


class Hindrance(StrEnum):
    """Why the arm is not commanded; the value names its counter."""

    NONE = "none"
    SILENT = "robot_silent"
    ERROR = "robot_error"
    MODE = "wrong_mode"
    STATE = "wrong_state"
    NO_SERVICE = "no_service"


@dataclass(frozen=True)
class Call:
    """A velocity (6,) to send, along the axes of the tool or of the base, in m/s and rad/s."""

    twist: Twist
    along_tool: bool


class VelocityLink:
    """Decides at each moment what to call the arm with: the newest command, zero, or nothing.

    One call is under way at most. A command that is stale is followed by calls of zero until one
    has been answered, then by nothing. Not for several threads at once.

    Attributes:
        settings: what may be sent, and how old what it depends on may be.
        robot: the arm's newest state, None before the first.
        hindrance: why no command was sent at the last call of `next_call`.
        counts: calls by what became of them.
        last_refusal: the newest answer other than success, in words.
    """

    def __init__(self, settings: XarmAdapterParameters) -> None:
        self.settings = settings
        self.hindrance = Hindrance.SILENT
        self.detail = "the arm's state has not been received"
        self.counts: Counter[str] = Counter()
        self.last_refusal = ""
        self._call = Call(zero_twist(), along_tool=False)
        self._command_s = -np.inf
        self.robot: RobotState | None = None
        self._robot_s = -np.inf
        self._sent: Call | None = None
        self._sent_s = -np.inf
        self._moves = False

    def command(self, twist: Twist, now_s: float, *, along_tool: bool) -> None:
        """Take a velocity (6,) along the axes of the tool or of the base, in m/s and rad/s; the
        newest replaces all before."""
        self._call = Call(self.settings.tool.within_speed(twist), along_tool)
        self._command_s = now_s

    def drop(self) -> None:
        """Let the newest command count as zero at once."""
        self._command_s = -np.inf

    def is_commanded(self, now_s: float) -> bool:
        """Return whether there is a command that is not stale."""
        return now_s - self._command_s <= self.settings.stale_s

    def hear(self, robot: RobotState, now_s: float) -> None:
        """Note the arm's state.

        Raises:
            ValueError: its tool is where no arm reaches; the state before stays, until it is old.
        """
        check_reach(robot.position_m)
        self.robot, self._robot_s = robot, now_s

    def next_call(self, now_s: float, *, has_service: bool) -> Call | None:
        """Return what to send now, or None; a call that is returned must be sent."""
        if self._sent is not None and now_s - self._sent_s > self.settings.answer_s:
            self.failed(f"no answer within {self.settings.answer_s:g} s")
        self.hindrance, self.detail = self._obstacle(now_s, has_service)
        if self.hindrance is not Hindrance.NONE:
            return None
        if self._sent is not None:
            self.counts["held_back"] += 1
            return None
        if self.is_commanded(now_s):
            call = self._call
        elif self._moves:
            call = Call(zero_twist(), self._call.along_tool)
        else:
            return None
        self._sent, self._sent_s = call, now_s
        self._moves = True
        self.counts["calls"] += 1
        return call

    def answered(self, code: int, message: str) -> None:
        """Note the driver's answer to the call under way; 0 is success."""
        sent, self._sent = self._sent, None
        if code:
            self.counts["refused"] += 1
            self.last_refusal = f"the driver answers {code}: {message or 'without a reason'}"
        elif sent is not None and not sent.twist.any():
            self._moves = False

    def failed(self, reason: str) -> None:
        """Note that the call under way came to nothing."""
        self._sent = None
        self.counts["failed"] += 1
        self.last_refusal = reason

    def is_waiting(self) -> bool:
        """Return whether a call is under way."""
        return self._sent is not None

    def _obstacle(self, now_s: float, has_service: bool) -> tuple[Hindrance, str]:
        robot, silence_s = self.robot, now_s - self._robot_s
        if robot is None:
            return Hindrance.SILENT, "the arm's state has not been received"
        if silence_s > self.settings.silence_s:
            return Hindrance.SILENT, f"the arm's state was last received {silence_s:.2f} s ago"
        if robot.error:
            return (
                Hindrance.ERROR,
                f"the arm reports error {robot.error}: find out why, then clean_error, "
                "motion_enable, set_mode 5, set_state 0",
            )
        if robot.mode != VELOCITY_MODE:
            return (
                Hindrance.MODE,
                f"the arm is in mode {robot.mode}, expected {VELOCITY_MODE} (Cartesian velocity): "
                "call set_mode 5, then set_state 0",
            )
        if robot.state not in READY_STATES:
            name = STATE_NAMES.get(robot.state, "unknown")
            return (
                Hindrance.STATE,
                f"the arm is in state {robot.state} ({name}): call set_state 0",
            )
        if not has_service:
            return Hindrance.NO_SERVICE, "the service vc_set_cartesian_velocity is not available"
        return Hindrance.NONE, ""
