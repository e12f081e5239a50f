# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""When an arm that is led by touch may move.

A stop ends when its cause does (an old image, a silent pose), or it is latched: until the loop is
enabled again by hand. The rule against old data is that of a stopping distance: the arm
brakes early enough to stand still `SafetyLimits.stop_within_s` after the last message came.
"""

from __future__ import annotations

import numpy as np

from dotsim_ros.control.arm.command import LINEAR, Twist, turn_between
from dotsim_ros.control.safety_layer.limits import Readings, Reason, SafetyLimits, State
from dotsim_ros.geometry.pose import Pose

START_PATIENCE_S = 1.0
"""The first command after a start or a stop may take so long."""
ENABLE_PATIENCE_S = 0.25
"""Enabling is not refused for one late image: the loop waits for the next."""


class Supervisor:
    """The states of the loop, why it is not running, and the same in words, with the figures. Not
    for several threads at once.

    Attributes:
        home: the pose at which the loop was enabled last.
    """

    def __init__(self, limits: SafetyLimits) -> None:
        self.limits = limits
        self.state = State.DISABLED
        self.reason = Reason.NONE
        self.detail = ""
        self.home: Pose | None = None
        self._hindered_s = -np.inf
        self._retreat_start_m = np.zeros(3)

    def enable(self, readings: Readings) -> None:
        """Start at the present pose; forgets what was latched.

        Raises:
            ValueError: something hinders it; the state stays.
        """
        reason, detail = self._old_data(readings, ENABLE_PATIENCE_S)
        if reason is not Reason.NONE or readings.tool is None:
            raise ValueError(detail)
        if readings.force_n > self.limits.release_n:
            raise ValueError(f"the force is {readings.force_n:.2f} N already: lift the tool")
        self.home = readings.tool
        self._hindered_s = readings.now_s
        self._enter(State.STARTING)

    def disable(self) -> None:
        """Stop on request."""
        self._enter(State.DISABLED)

    def latch(self, reason: Reason, detail: str) -> None:
        """Stop until the loop is enabled again; the first reason stays."""
        if self.state not in (State.DISABLED, State.LATCHED):
            self._enter(State.LATCHED, reason, detail)

    def decide(self, readings: Readings, command: Twist, *, command_age_s: float) -> State:
        """Return what to do in this tick.

        Args:
            command: (6,) the command in force, for the time that the arm needs to stop.
            command_age_s: since the policy gave its newest command.
        """
        if self.state in (State.DISABLED, State.LATCHED):
            return self.state
        self._check_place(readings)
        if self.state is State.LATCHED:
            return self.state
        # A slower arm may wait longer: that must not restart what has stopped.
        is_stopped = self.state is State.STOPPED
        brake_s = (
            self.limits.longest_brake_s if is_stopped else self.limits.tool.brake_time_s(command)
        )
        timeout_s = self.limits.timeout_s(brake_s)
        reason, detail = self._old_data(readings, timeout_s)
        is_blind = reason in (Reason.IMAGE_STALE, Reason.IMAGE_DELAYED)
        # A retreat needs the pose and the force, not the image.
        must_retreat = (reason is Reason.NONE or is_blind) and self._must_retreat(readings)
        if must_retreat or reason is not Reason.NONE:
            self._hindered_s = readings.now_s
        if must_retreat:
            self._retreat(readings)
        elif reason is not Reason.NONE:
            self._stop(reason, detail)
        else:
            self._follow(readings.now_s, command_age_s, timeout_s)
        return self.state

    def check_way(self, readings: Readings, command: Twist) -> bool:
        """Latch where a command would lead out of the workspace; return whether it may be given.

        Args:
            command: (6,) along the base's axes.
        """
        tool, home = readings.tool, self.home
        assert tool is not None
        assert home is not None
        velocity = command[LINEAR]
        coasting_s = self.limits.reaction_s + readings.pose.age_s
        braking_m = velocity * np.linalg.norm(velocity) / (2.0 * self.limits.maximum_linear_m_s2)
        stop_m = tool.position_m + velocity * coasting_s + braking_m - home.position_m
        beyond = np.abs(stop_m) > self.limits.half_box_m
        if not beyond.any():
            return True
        axis = int(np.argmax(beyond))
        self.latch(
            Reason.WORKSPACE,
            f"the arm would come to rest {1e3 * stop_m[axis]:+.1f} mm along {'xyz'[axis]} from "
            f"where it was enabled, the workspace ends at "
            f"{1e3 * self.limits.half_box_m[axis]:.1f} mm",
        )
        return False

    def _enter(self, state: State, reason: Reason = Reason.NONE, detail: str = "") -> None:
        self.state, self.reason, self.detail = state, reason, detail

    def _old_data(self, readings: Readings, timeout_s: float) -> tuple[Reason, str]:
        limits = self.limits
        streams = [
            ("pose", readings.pose, Reason.POSE_STALE, Reason.POSE_DELAYED),
            ("image", readings.image, Reason.IMAGE_STALE, Reason.IMAGE_DELAYED),
        ]
        if np.isfinite(limits.force_n):
            # Before the image: without the force the arm must not even retreat.
            streams.insert(1, ("force", readings.force, Reason.FORCE_STALE, Reason.FORCE_STALE))
        for name, stream, stale, delayed in streams:
            if stream.age_s > timeout_s:
                return stale, (
                    f"no {name} has come so far"
                    if np.isinf(stream.age_s)
                    else f"the newest {name} came {1e3 * stream.age_s:.0f} ms ago"
                )
            if abs(stream.delay_s) > limits.maximum_delay_s:
                side = "after" if stream.delay_s > 0.0 else "before"
                return delayed, (
                    f"the newest {name} came {abs(stream.delay_s):.3f} s {side} the time of its "
                    "stamp: is its sender slow, or its clock another one?"
                )
        return Reason.NONE, ""

    def _stop(self, reason: Reason, detail: str) -> None:
        if not self.limits.resume_when_fresh:
            self.latch(reason, detail)
        elif self.state is not State.STOPPED or self.reason is not reason:
            self._enter(State.STOPPED, reason, detail)

    def _follow(self, now_s: float, age_s: float, timeout_s: float) -> None:
        if age_s <= timeout_s:
            if self.state is not State.RUNNING:
                self._enter(State.RUNNING)
            return
        # The first command after a start, a stop or a retreat takes its time.
        waits = self.state is not State.RUNNING
        if waits and now_s - self._hindered_s <= START_PATIENCE_S:
            if self.state is State.RETREATING:
                self._enter(State.STARTING)
            return
        age_text = (
            "no command" if np.isinf(age_s) else f"the newest command is {1e3 * age_s:.0f} ms old"
        )
        self._stop(Reason.POLICY_LATE, f"{age_text}: the policy does not keep up")

    def _must_retreat(self, readings: Readings) -> bool:
        is_retreating = self.state is State.RETREATING
        return readings.force_n > (self.limits.release_n if is_retreating else self.limits.force_n)

    def _retreat(self, readings: Readings) -> None:
        assert readings.tool is not None
        if self.state is not State.RETREATING:
            self._retreat_start_m = readings.tool.position_m
            self._enter(
                State.RETREATING,
                Reason.FORCE_LIMIT,
                f"the force is {readings.force_n:.2f} N, the limit {self.limits.force_n:.2f} N",
            )
            return
        way_m = float(np.linalg.norm(readings.tool.position_m - self._retreat_start_m))
        if way_m > self.limits.retreat_m:
            self.latch(
                Reason.RETREAT_FAILED,
                f"the force is still {readings.force_n:.2f} N after a retreat of "
                f"{1e3 * way_m:.1f} mm",
            )

    def _check_place(self, readings: Readings) -> None:
        tool, home = readings.tool, self.home
        assert tool is not None
        assert home is not None
        away_m = np.abs(tool.position_m - home.position_m)
        # A retreat goes where the tool came from, and has a limit of its own.
        if self.state is not State.RETREATING and (away_m > self.limits.half_box_m).any():
            self.latch(
                Reason.WORKSPACE,
                f"the tool is {np.round(1e3 * away_m, 1).tolist()} mm along x, y and z from where "
                "it was enabled, "
                f"{np.round(1e3 * self.limits.half_box_m, 1).tolist()} mm are allowed",
            )
        turn_rad = float(np.linalg.norm(turn_between(tool, home)))
        if turn_rad > self.limits.maximum_turn_rad:
            self.latch(
                Reason.WORKSPACE,
                f"the tool is turned by {turn_rad:.3f} rad from how it was enabled, "
                f"{self.limits.maximum_turn_rad:.3f} are allowed",
            )
