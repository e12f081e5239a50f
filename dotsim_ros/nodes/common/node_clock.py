# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The time by which a node acts: the steady clock, or with `use_sim_time` that of /clock or steps.

A simulated time that goes back is a new start: results that are being computed are dropped. One
that leaps forward leaves something out: nothing of it passes in the node, so that no work is late.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import ClockType, JumpThreshold, ROSClock
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time

from dotsim_ros.nodes.common.clock_watch import ClockJump, ClockWatch
from dotsim_ros.nodes.simulated_time.schedule import LONGEST_STEP_S, SimulatedSchedule
from msg_adapters.stamps import MAXIMUM_SECONDS, NANOSECONDS_PER_SECOND

SILENT_CLOCK_WARNING_S = 5.0
PAUSED_CLOCK_WARNING_S = 60.0
"""A simulator may be paused for long."""
ROUNDING_NS = 1000
"""A time that is so little before the last one is the same, computed another way."""
LATEST_NS = (MAXIMUM_SECONDS - 1_000_000) * NANOSECONDS_PER_SECOND
"""Eleven days before the end of what a stamp holds: what is planned from a time must have one,
too."""


def ros_time_ns(node: Node) -> int:
    """Return the time of a node's ROS clock; 0 where there is none, since /clock is silent or its
    time is none that messages could be stamped with."""
    now_ns = int(node.get_clock().now().nanoseconds)
    return now_ns if 0 < now_ns <= LATEST_NS else 0


class SimulatedClock:
    """The simulated time of a node, and what it does at which time.

    Args:
        node: whose clock it is.
        is_stepped: whether the time moves on by `step_to` alone, and not with /clock.

    Attributes:
        schedule: of the node's work.
        on_jump: called when time goes back or leaps forward.
    """

    def __init__(self, node: Node, *, is_stepped: bool) -> None:
        self._node, self._is_stepped = node, is_stepped
        self.schedule = SimulatedSchedule()
        self.watch = ClockWatch(time.monotonic())
        self.on_jump: list[Callable[[ClockJump], None]] = []
        self._origin_ns: int | None = None
        if is_stepped:
            # The steps themselves say the time, and to read it twice costs a tenth of a core.
            node._time_source.detach_node()
        else:
            self._follow()

    def time_ns(self) -> int:
        """Return the time of messages; 0 before the first."""
        if self._origin_ns is None:
            return 0
        return self._origin_ns + round(1e9 * self.schedule.now_s)

    def silence(self) -> str:
        """Return in words that the time does not move on; empty where it does."""
        return "" if self._is_stepped else self.watch.silence(time.monotonic())

    def step_to(self, time_ns: int) -> None:
        """Go on in a step; the node's ROS clock, which its log is stamped by, goes with it."""
        clock = self._node.get_clock()
        assert isinstance(clock, ROSClock)
        clock.set_ros_time_override(Time(nanoseconds=time_ns, clock_type=ClockType.ROS_TIME))
        self._go_to(time_ns)

    def begin_again(self) -> None:
        """Begin again where /clock has gone back: the next message may be of the new time."""
        if self._origin_ns is None or self._is_stepped:
            return
        time_ns = ros_time_ns(self._node)
        if time_ns and time_ns < self.time_ns() and self._has_jumped(time_ns):
            self._go_to(time_ns)

    def drop_scheduled(self) -> None:
        """Forget all that is due, and what is being computed."""
        self.on_jump.clear()
        self.schedule.clear()

    def _go_to(self, time_ns: int) -> None:
        """Do what is due up to a time."""
        self.watch.move(time.monotonic())
        if self._origin_ns is None:
            self._origin_ns = time_ns
        elif self._has_jumped(time_ns):
            self._jump_to(time_ns, self._origin_ns)
        self.schedule.advance(1e-9 * (time_ns - self._origin_ns))

    def _has_jumped(self, time_ns: int) -> bool:
        step_ns = time_ns - self.time_ns()
        return not -ROUNDING_NS <= step_ns <= round(1e9 * LONGEST_STEP_S)

    def _jump_to(self, time_ns: int, origin_ns: int) -> None:
        """Let the times of messages go on from another time than what passes in the node does."""
        before_ns = self.time_ns()
        # Of a leap, only so much passes that what comes next is done: a clock may run so fast that
        # each of its ticks is one.
        passed_ns = 0 if time_ns < before_ns else round(1e9 * self.schedule.until_next_s())
        jump = ClockJump(before_ns, time_ns, time_ns - before_ns - passed_ns)
        self._origin_ns = origin_ns + jump.shift_ns
        self.watch.jump(jump, time.monotonic())
        self._node.get_logger().warning(jump.text(), throttle_duration_sec=SILENT_CLOCK_WARNING_S)
        if jump.is_restart:
            self.schedule.drop_computed()
        for act in list(self.on_jump):
            act(jump)

    def _follow(self) -> None:
        """Go on whenever /clock does."""

        def go() -> None:
            time_ns = ros_time_ns(self._node)
            if time_ns:
                self._go_to(time_ns)

        # Not within the jump's own callback, which must return before the clock can be read.
        moved = self._node.create_guard_condition(go)
        self._jumps = self._node.get_clock().create_jump_callback(
            JumpThreshold(
                min_forward=Duration(nanoseconds=1),
                min_backward=Duration(nanoseconds=-1),
                on_clock_change=True,
            ),
            post_callback=lambda _: moved.trigger(),
        )
