# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A simulated arm under velocity commands: late, lagging, limited, and able to fail on request.

Times are handed in, in seconds of a steady clock. The motion is computed on a grid of absolute
times, so it does not depend on when, or how regularly, somebody looks.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from dotsim_ros.control.arm.command import (
    ANGULAR,
    LINEAR,
    ToolLimits,
    Twist,
    zero_twist,
)
from dotsim_ros.control.arm.kinematics import ArmKinematics, JointMotion
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.quantity import check_fields, quantity

STEP_S = 0.005
REST = 1e-6
"""Below this difference (m/s, rad/s) a velocity has arrived."""
KEPT_S = 3.0
"""How long states are kept for feedback that is delayed."""


@dataclass(frozen=True)
class ArmResponse:
    """How the arm answers a command; each field says what it is.

    Raises:
        ValueError: a value out of its range.
    """

    latency_s: float = quantity(0.01, low=0.0, high=1.0)
    """Latency from a command to its first effect."""
    jitter_s: float = quantity(0.002, low=0.0, high=1.0)
    """Standard deviation of the random delay added to the latency; the delay is never negative."""
    time_constant_s: float = quantity(0.02, low=0.001, high=10.0)
    """Time constant of the first-order lag of the velocity behind the commanded one."""
    stale_s: float = quantity(0.2, low=0.02, high=10.0)
    """The arm stops after this time without a command."""

    def __post_init__(self) -> None:
        check_fields("", self)


@dataclass(frozen=True)
class ArmFaults:
    """What is wrong with the arm, for tests of what it does to its controller.

    Raises:
        ValueError: a value out of its range.
    """

    FIXED: ClassVar[str] = ""

    fail_drop_feedback: bool = quantity(False)
    """Injected failure: poses, velocities and joints are not published."""
    fail_delay_s: float = quantity(0.0, low=0.0, high=2.0)
    """Injected failure: commands act, and feedback is published, this much later."""
    fail_stop: bool = quantity(False)
    """Injected failure: the arm brakes and stays at rest."""

    def __post_init__(self) -> None:
        check_fields("", self)


@dataclass(frozen=True)
class ArmState:
    """The arm at one moment: its joints (7,), their rates in the step that led here and what held
    them back, the pose of the tool in the base, and its velocity (6,) along the base's axes."""

    time_s: float
    joints_rad: FloatArray
    motion: JointMotion
    pose: Pose
    twist: Twist


@dataclass(frozen=True)
class _Command:
    """A velocity, and when it begins to act."""

    acts_s: float
    twist: Twist = field(default_factory=zero_twist)
    along_tool: bool = False


@dataclass(frozen=True)
class _ArmStep:
    """What a step of the grid ends with; fields as those of `ArmState`."""

    joints_rad: FloatArray
    motion: JointMotion
    twist: Twist


class SimulatedArm:
    """An arm that is moved by velocities. Not for several threads at once.

    Args:
        start_joints_rad: (7,) where it begins, and where `reset` puts it.

    Attributes:
        is_emergency: stopped by `emergency_stop`, until `reset`.
    """

    def __init__(
        self,
        kinematics: ArmKinematics,
        start_joints_rad: FloatArray,
        *,
        limits: ToolLimits,
        response: ArmResponse,
        start_s: float,
        seed: int = 0,
    ) -> None:
        self._kinematics = kinematics
        self._start_joints_rad = np.array(start_joints_rad, dtype=np.float64)
        self.limits = limits
        self.response = response
        self.faults = ArmFaults()
        self.is_emergency = False
        self._random = np.random.default_rng(seed)
        self._start_s = start_s
        self._index = 0
        self._wanted = zero_twist()
        self._step = self._at_rest()
        self._history: deque[ArmState] = deque()
        self._keep()
        self._waiting: deque[_Command] = deque()
        self._command = _Command(-np.inf)

    @property
    def state(self) -> ArmState:
        """Return the newest state that was computed."""
        return self._history[-1]

    def is_stale(self) -> bool:
        """Return whether the arm stands because no command has come for too long."""
        return self._time_s() - self._command.acts_s > self.response.stale_s

    def command(self, twist: Twist, now_s: float, *, along_tool: bool) -> None:
        """Take a velocity; it acts after the latency, after those that came before.

        Args:
            twist: (6,) finite, m/s and rad/s; limited to what the tool may do.
            along_tool: its axes are those of the tool, which turn with it, else those of the base.

        Raises:
            ValueError: a number that is not finite: the arm is stopped.
        """
        if not np.isfinite(twist).all():
            self.halt(now_s)
            raise ValueError(f"the velocity holds a number that is not finite: {twist.tolist()}")
        late_s = abs(float(self._random.normal(0.0, self.response.jitter_s)))
        acts_s = now_s + self.response.latency_s + late_s + self.faults.fail_delay_s
        last_s = self._waiting[-1].acts_s if self._waiting else -np.inf
        limited = self.limits.within_speed(twist)
        self._waiting.append(_Command(max(acts_s, last_s), limited, along_tool))

    def halt(self, now_s: float) -> None:
        """Forget all commands and come to rest; the next command moves the arm again."""
        self.advance(now_s)
        self._waiting.clear()
        self._command = _Command(now_s)

    def emergency_stop(self, now_s: float) -> None:
        """Brake as hard as the tool may, without latency, and stay until `reset`."""
        self.advance(now_s)
        self.is_emergency = True

    def fail(self, faults: ArmFaults, now_s: float) -> None:
        """Fail from now on, or no longer."""
        self.advance(now_s)
        self.faults = faults

    def reset(self, now_s: float) -> None:
        """Put the arm to its start at once, at rest; ends an emergency stop."""
        self.halt(now_s)
        self.is_emergency = False
        self._wanted = zero_twist()
        self._step = self._at_rest()
        self._keep()

    def advance(self, now_s: float) -> ArmState:
        """Move on to the last time of the grid that is not after `now_s`; return the state."""
        # A deadline of the grid, computed another way, must not count as just before it.
        index = int(np.floor((now_s - self._start_s) / STEP_S + 1e-6))
        if index <= self._index:
            return self.state
        while self._index < index:
            if self._rests():
                self._index = index
            else:
                self._step = self._next_step()
                self._index += 1
        self._keep()
        return self.state

    def feedback(self, now_s: float) -> ArmState | None:
        """Return the state that the feedback shows at this time, or None where there is none."""
        self.advance(now_s)
        if self.faults.fail_drop_feedback:
            return None
        heard_s = now_s - self.faults.fail_delay_s
        for state in reversed(self._history):
            if state.time_s <= heard_s + 1e-6 * STEP_S:
                return state
        return None

    def _time_s(self) -> float:
        return self._start_s + self._index * STEP_S

    def _keep(self) -> None:
        """Add what has been computed to the history."""
        step, time_s = self._step, self._time_s()
        if self._history and self._history[-1].joints_rad is step.joints_rad:
            state = replace(self._history[-1], time_s=time_s)
        else:
            pose = self._kinematics.pose(step.joints_rad)
            state = ArmState(time_s, step.joints_rad, step.motion, pose, step.twist)
        self._history.append(state)
        while self._history[0].time_s < time_s - KEPT_S:
            self._history.popleft()

    def _at_rest(self) -> _ArmStep:
        joints = self._start_joints_rad.copy()
        still = self._kinematics.motion(joints, self._kinematics.jacobian(joints), zero_twist())
        return _ArmStep(joints, still, zero_twist())

    def _rests(self) -> bool:
        moves = self._is_commanded() and self._command.twist.any()
        moves = moves or self._wanted.any() or self._step.motion.rates_rad_s.any()
        return not (moves or self._waiting)

    def _take_commands(self, time_s: float) -> None:
        while self._waiting and self._waiting[0].acts_s <= time_s:
            self._command = self._waiting.popleft()

    def _is_braking(self) -> bool:
        return self.is_emergency or self.faults.fail_stop

    def _is_commanded(self) -> bool:
        return not (self._is_braking() or self.is_stale())

    def _target(self, rotation: FloatArray) -> Twist:
        """Return what the tool shall do, along the base's axes."""
        if not self._is_commanded():
            return zero_twist()
        twist = self._command.twist
        return (twist.reshape(2, 3) @ rotation.T).reshape(6) if self._command.along_tool else twist

    def _next_step(self) -> _ArmStep:
        """Return one step on from the present one."""
        self._take_commands(self._time_s())
        before, kinematics = self._step, self._kinematics
        # The rates at the middle of the step: the tool then moves as commanded, to second order.
        middle = before.joints_rad + 0.5 * STEP_S * before.motion.rates_rad_s
        jacobian, rotation = kinematics.jacobian_and_rotation(middle)
        self._wanted = self._approached(self._target(rotation))
        motion = kinematics.motion(before.joints_rad, jacobian, self._wanted)
        rates = self._eased(motion.rates_rad_s, jacobian)
        moved = before.joints_rad + STEP_S * rates
        allowed = np.minimum(np.maximum(moved, kinematics.lower_rad), kinematics.upper_rad)
        rates = (allowed - before.joints_rad) / STEP_S
        # A joint that stopped short of where it was going may have made the tool faster.
        rates *= self._room(jacobian @ rates)
        joints = before.joints_rad + STEP_S * rates
        return _ArmStep(joints, replace(motion, rates_rad_s=rates), jacobian @ rates)

    def _room(self, twist: Twist) -> float:
        """Return the factor, 1 at most, that brings a velocity within the limits."""
        linear, angular = _speeds(twist)
        return min(1.0, self.limits.linear_m_s / linear, self.limits.angular_rad_s / angular)

    def _approached(self, target: Twist) -> Twist:
        """Return how far the velocity gets towards its target in a step."""
        way = target - self._wanted
        if self._is_braking() or np.abs(way).max() < REST:
            goal = target
        else:
            share = -np.expm1(-STEP_S / self.response.time_constant_s)
            goal = self._wanted + share * way
        return self.limits.approached(self._wanted, goal, STEP_S)

    def _eased(self, rates: FloatArray, jacobian: FloatArray) -> FloatArray:
        """Return rates that change the tool's velocity by no more than is allowed.

        What is wanted changes slowly, but not what a singularity or the limit of a joint makes of
        it. What is not reached is then not wanted any more: the arm does not run after it.
        """
        limits, before = self.limits, self._step.motion.rates_rad_s
        linear, angular = _speeds(jacobian @ (rates - before))
        share = min(limits.linear_m_s2 * STEP_S / linear, limits.angular_rad_s2 * STEP_S / angular)
        if share >= 1.0:
            return rates
        rates = before + share * (rates - before)
        # The same rates of the joints move the tool otherwise than a step before.
        rates *= self._room(jacobian @ rates)
        self._wanted = jacobian @ rates
        return rates


def _speeds(twist: Twist) -> tuple[float, float]:
    """Return the lengths of both parts of a velocity, above zero."""
    linear, angular = twist[LINEAR], twist[ANGULAR]
    return max(float(np.sqrt(linear @ linear)), 1e-12), max(
        float(np.sqrt(angular @ angular)), 1e-12
    )
