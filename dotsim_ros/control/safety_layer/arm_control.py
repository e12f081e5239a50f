# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""From the policy's commands to those of the arm: one tick of the control loop, safety included.

Needs no ROS and no clock: times are handed in.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import RLock

import numpy as np

from dotsim_ros.control.arm.command import (
    ANGULAR,
    LINEAR,
    CommandInterpolator,
    CommandPredictor,
    Twist,
    in_base_axes,
    shortened,
    turn_between,
    zero_twist,
)
from dotsim_ros.control.safety_layer.limits import (
    CONTROL_RATE_HZ,
    POLICY_RATE_HZ,
    TICK_S,
    Readings,
    Reason,
    SafetyLimits,
    State,
)
from dotsim_ros.control.safety_layer.supervisor import Supervisor
from dotsim_ros.io.quantity import check_fields, quantity

TOOL_FRAME, BASE_FRAME = "link_tcp", "link_base"

LONGEST_STEP_TICKS = 2.0
"""A control loop that was held up must not make up for it with one large step."""


@dataclass(frozen=True)
class ControlSettings:
    """How commands are given; each field says what it is.

    Raises:
        ValueError: a value out of its range.
    """

    command_frame: str = quantity(TOOL_FRAME, choices=(TOOL_FRAME, BASE_FRAME))
    """Axes of the commands: those of the tool, or those of the arm's base."""
    command_rate_hz: float = quantity(POLICY_RATE_HZ, low=POLICY_RATE_HZ, high=CONTROL_RATE_HZ)
    """25: each command of the policy is published once; 100: commands between them are interpolated
    linearly."""
    command_lead_s: float = quantity(0.0, low=0.0, high=0.2)
    """How long after its image a command takes effect: the commands are extrapolated by as much. 0:
    they are published as they are."""
    hold_orientation: bool = quantity(True)
    """Turn the tool back to its orientation when the node was enabled, which touch alone does not
    identify."""
    orientation_gain_per_s: float = quantity(2.0, low=0.01, high=20.0)
    """Gain of that rotation: angular speed for each radian of error."""
    orientation_limit_rad_s: float = quantity(0.1, low=1e-3, high=4.0)
    """Limit of the angular speed of that rotation."""

    def __post_init__(self) -> None:
        check_fields("", self)
        if self.command_rate_hz not in (POLICY_RATE_HZ, CONTROL_RATE_HZ):
            raise ValueError(
                f"command_rate_hz is {self.command_rate_hz:g}, expected {POLICY_RATE_HZ:g} or "
                f"{CONTROL_RATE_HZ:g}"
            )

    @property
    def along_tool(self) -> bool:
        """Whether the axes of the commands are those of the tool, else those of the base."""
        return self.command_frame == TOOL_FRAME

    @property
    def interpolates(self) -> bool:
        """Whether each tick has a command of its own, on a line from one of the policy's to the
        next."""
        return self.command_rate_hz == CONTROL_RATE_HZ


@dataclass(frozen=True)
class Order:
    """What the arm is commanded in one tick.

    Attributes:
        twist: (6,) along the axes of the settings.
        state, reason, detail: those of the supervisor.
        is_urgent: the arm is being stopped, or retreats: every tick counts.
    """

    twist: Twist
    state: State
    reason: Reason
    detail: str
    is_urgent: bool


class ArmControl:
    """Turns the policy's commands and what is known of the arm into orders; for any threads."""

    def __init__(self, limits: SafetyLimits, settings: ControlSettings) -> None:
        self.limits = limits
        self._settings = settings
        self._lock = RLock()
        self._supervisor = Supervisor(limits)
        self._interpolator = CommandInterpolator(1.0 / POLICY_RATE_HZ)
        self._predictor = CommandPredictor(settings.command_lead_s, 1.0 / POLICY_RATE_HZ)
        self._policy_command, self._policy_s = zero_twist(), -np.inf
        self._twist, self._tick_s = zero_twist(), -np.inf

    @property
    def state(self) -> State:
        """Return the state of the loop."""
        return self._supervisor.state

    def wants_commands(self) -> bool:
        """Return whether the policy is needed."""
        return self._supervisor.state not in (State.DISABLED, State.LATCHED)

    def enable(self, readings: Readings) -> None:
        """Start; see `Supervisor.enable`."""
        with self._lock:
            self._supervisor.enable(readings)
            self._policy_s = -np.inf

    def disable(self) -> None:
        """Brake and stay."""
        with self._lock:
            self._supervisor.disable()

    def latch(self, reason: Reason, detail: str) -> None:
        """Stop until enabled again; see `Supervisor.latch`."""
        with self._lock:
            self._supervisor.latch(reason, detail)

    def put(self, command: Twist, now_s: float, *, image_s: float) -> bool:
        """Take a command of the policy; one that is not finite stops the arm.

        Args:
            command: (6,) along the tool's axes.
            image_s: when the image that it answers came.

        Returns:
            Whether it was taken: one that answers an image as old as would stop the arm is not.
        """
        with self._lock:
            if not np.isfinite(command).all():
                self.latch(Reason.NOT_FINITE, f"the policy commands {command.tolist()}")
                return False
            if now_s - image_s > self.limits.stop_within_s:
                return False
            command = self._predictor.put(command, image_s)
            self._policy_command, self._policy_s = command, now_s
            self._interpolator.put(command, now_s)
            return True

    def tick(self, readings: Readings) -> Order:
        """Return the order of this tick."""
        with self._lock:
            now_s = readings.now_s
            before = self._supervisor.state
            state = self._supervisor.decide(
                readings, self._twist, command_age_s=now_s - self._policy_s
            )
            if state is State.RUNNING and before is not State.RUNNING:
                self._interpolator.reset()
                self._interpolator.put(self._policy_command, now_s)
            passed_s = max(0.0, now_s - self._tick_s) if np.isfinite(self._tick_s) else 0.0
            self._tick_s = now_s
            twist = self._moved(readings, state, passed_s)
            if state is State.RUNNING and not self._supervisor.check_way(
                readings, self._along_base(twist, readings)
            ):
                state = self._supervisor.state
                twist = self._moved(readings, state, passed_s)
            moves = bool(twist.any() or self._twist.any())
            self._twist = twist
            return Order(
                twist,
                state,
                self._supervisor.reason,
                self._supervisor.detail,
                is_urgent=moves and state is not State.RUNNING,
            )

    def _moved(self, readings: Readings, state: State, passed_s: float) -> Twist:
        """Return how far the command gets towards what the state asks for."""
        if state in (State.RUNNING, State.RETREATING):
            target = self._target(readings, state)
            passed_s = min(passed_s, LONGEST_STEP_TICKS * TICK_S)
        else:
            target = zero_twist()
        return self.limits.tool.approached(self._twist, target, passed_s)

    def _target(self, readings: Readings, state: State) -> Twist:
        assert readings.tool is not None
        settings = self._settings
        if state is State.RETREATING:
            target = zero_twist()
            target[LINEAR] = (0.0, 0.0, -self.limits.retreat_m_s)
        else:
            interpolated = self._interpolator.at(readings.now_s)
            target = interpolated if settings.interpolates else self._policy_command.copy()
            if settings.hold_orientation:
                home = self._supervisor.home
                assert home is not None
                turn = settings.orientation_gain_per_s * turn_between(readings.tool, home)
                target[ANGULAR] += shortened(turn, settings.orientation_limit_rad_s)
        target = self.limits.tool.within_speed(target)
        return target if settings.along_tool else in_base_axes(target, readings.tool)

    def _along_base(self, twist: Twist, readings: Readings) -> Twist:
        assert readings.tool is not None
        return in_base_axes(twist, readings.tool) if self._settings.along_tool else twist
