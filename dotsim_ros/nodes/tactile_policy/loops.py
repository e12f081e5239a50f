# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What `tactile_policy` does next to receiving: inference and control.

Needs no ROS and no clock: what they ask, publish and log goes through functions that are handed in.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.control.arm.command import Twist
from dotsim_ros.control.safety_layer.arm_control import ArmControl, Order
from dotsim_ros.control.safety_layer.limits import Reason, State
from dotsim_ros.nodes.common.beat import Beat
from dotsim_ros.nodes.common.counters import Miss, MissCounter, RateMeter, Spread, milliseconds
from dotsim_ros.nodes.common.health import Report
from msg_adapters import Level

if TYPE_CHECKING:
    from dotsim_ros.control.policy.network import Policy
    from dotsim_ros.nodes.tactile_policy.inputs import HeardImage, PolicyInputs

WAIT_SHARE = 0.6
"""Share of a period that a cycle waits for an image that is not there at its deadline."""

LEVELS = {
    State.DISABLED: Level.OK,
    State.STARTING: Level.OK,
    State.RUNNING: Level.OK,
    State.RETREATING: Level.WARN,
    State.STOPPED: Level.WARN,
    State.LATCHED: Level.ERROR,
}


@dataclass(frozen=True)
class PolicyAnswer:
    """What comes of asking the policy: the distance of the image from those of the training (the
    last one where it is not known), and the command (6,), why the image cannot be read, or why the
    arm must stop for good."""

    distance: float
    command: Twist | None = None
    refused: ValueError | None = None
    fault: tuple[Reason, str] | None = None


class InferenceLoop:
    """Asks the policy once a cycle, with the newest image.

    Args:
        largest_distance: images less like those of the training are another sensor's.
        compute: does work, and hands over what comes out when it is there.
        report: called with a missed deadline that is worth a line in the log.

    Attributes:
        idle: (H, W, 3) the image at rest, or None where it is not known.
        origin: the image that the newest command answers.
        distance: of the newest image from those of the training.
        without_image: cycles in which no new image came.
    """

    def __init__(
        self,
        policy: Policy,
        *,
        largest_distance: float,
        inputs: PolicyInputs,
        control: ArmControl,
        beat: Beat,
        now_s: Callable[[], float],
        compute: Callable[[Callable[[], PolicyAnswer], Callable[[PolicyAnswer], None]], None],
        report: Callable[[Miss], None],
    ) -> None:
        self._policy = policy
        self.largest_distance = largest_distance
        self._inputs = inputs
        self._control = control
        self._beat = beat
        self._now_s = now_s
        self._compute = compute
        self._report = report
        self._index = 0
        self._look_s: float | None = None
        self._last: HeardImage | None = None
        self.idle: NDArray[np.uint8] | None = None
        self.origin: HeardImage | None = None
        self.distance = np.nan
        self.taken = 0
        self.without_image = 0
        self.rate = RateMeter()
        self.spent_s = Spread()
        self.misses = MissCounter("inference")

    def begin(self, now_s: float) -> None:
        """Let the first cycle be the next one."""
        self._index = self._beat.next_cycle(now_s)

    def deadline_s(self) -> float:
        """Return when to look for an image next."""
        if self._look_s is not None:
            return self._look_s
        return self._beat.cycle_s(self._index)

    def run(self, now_s: float) -> None:
        """Begin a cycle, or go on with one whose image was not there."""
        beat = self._beat
        deadline_s = beat.cycle_s(self._index)
        if self._control.wants_commands():
            until_s = deadline_s + WAIT_SHARE * beat.period_s
            image = self._inputs.image_after(self._last, until_s)
            if image is None and (now_s := self._now_s()) < until_s:
                self._look_s = min(now_s + beat.period_s / beat.ticks, until_s)
                return
            self._cycle(image, deadline_s)
        elif (image := self._inputs.newest_image()) is not None and image is not self._last:
            # So that the first command needs no time to find its place.
            self._last = image
            beat.lean(deadline_s - image.arrival_s)
        self._look_s = None
        now_s = self._now_s()
        late_s = now_s - deadline_s - beat.period_s
        if late_s > 0.0 and (miss := self.misses.note(late_s, now_s)) is not None:
            self._report(miss)
        # A cycle that begins late is better than none; those that have passed are left out.
        self._index += 1 + max(0, int(late_s / beat.period_s))

    def _cycle(self, image: HeardImage | None, deadline_s: float) -> None:
        if image is None:
            self.without_image += 1
            return
        self._last = image
        self._beat.lean(deadline_s - image.arrival_s)
        begun_s = self._now_s()
        self._compute(partial(self._command, image, self.idle), partial(self._take, image, begun_s))

    def _take(self, image: HeardImage, begun_s: float, answer: PolicyAnswer) -> None:
        now_s = self._now_s()
        self.spent_s.note(now_s - begun_s)
        self.distance = answer.distance
        if answer.refused is not None:
            self._inputs.refuse("image", answer.refused)
        elif answer.fault is not None:
            self._control.latch(*answer.fault)
        elif answer.command is not None:
            self.rate.note(now_s)
            if self._control.put(answer.command, now_s, image_s=image.arrival_s):
                self.origin = image
                self.taken += 1

    def _command(self, image: HeardImage, idle: NDArray[np.uint8] | None) -> PolicyAnswer:
        assert idle is not None
        distance = self.distance
        try:
            pixels = image.pixels()
        except ValueError as error:
            return PolicyAnswer(distance, refused=error)
        try:
            distance = self._policy.image_distance(pixels, idle)
            if not distance <= self.largest_distance:
                return PolicyAnswer(
                    distance,
                    fault=(
                        Reason.WRONG_SENSOR,
                        f"the image is {distance:.1f} away from those of the training, at most "
                        f"{self.largest_distance:.1f} is usual: another sensor, a damaged one, or "
                        "an idle image that does not go with it",
                    ),
                )
            return PolicyAnswer(distance, command=self._policy(pixels, idle))
        except ValueError as error:
            return PolicyAnswer(distance, fault=(Reason.WRONG_SENSOR, str(error)))
        except Exception as error:
            # Whatever a network's runtime may raise: the arm must not go on with the last command.
            return PolicyAnswer(
                distance, fault=(Reason.POLICY_FAILED, f"the policy failed: {error!r}")
            )

    def report(self, control: ControlLoop, now_s: float) -> Report:
        """Return the state of the inference, for the diagnostics."""
        arrival_s = control.arrival_age_s.percentiles(50.0, 99.0)
        stamp_s = control.stamp_age_s.percentiles(50.0, 99.0)
        values = {
            "rate_hz": f"{self.rate.rate_hz(now_s):.2f}",
            "commands": str(self.taken),
            "cycles_without_image": str(self.without_image),
            "time_p50_p95_p99_max_ms": milliseconds(
                *self.spent_s.percentiles(50.0, 95.0, 99.0, 100.0)
            ),
            "image_age_at_command_p50_p99_ms": milliseconds(*stamp_s),
            "image_age_since_arrival_p50_p99_ms": milliseconds(*arrival_s),
            "image_distance": f"{self.distance:.2f}",
            "largest_distance": f"{self.largest_distance:.2f}",
            "deadline_misses": str(self.misses.count),
            "deadline_misses_over_40_ms": str(self.misses.reported),
            "latest_ms": milliseconds(self.misses.worst_s),
        }
        if self.idle is None:
            return (
                Level.WARN,
                "no idle image: call calibrate_idle with the sensor untouched",
                values,
            )
        return Level.OK, "ready", values


class ControlLoop:
    """Publishes the orders: one a tick or one a cycle, and every one that stops the arm.

    Args:
        every_tick: publish at the rate of the ticks.
        now_s, clock_ns: the time that the node acts by, and the one that stamps are of.
        publish: sends a command with its stamp.
        changed: called with each order of a new state or reason.
        report: called with a missed deadline that is worth a line in the log.

    Attributes:
        stops: how often the arm was stopped, or retreated, by reason.
        rate, ticks, misses: of published commands, and of the loop.
        arrival_age_s, stamp_age_s: of the image that a new command answers, when it is published.
    """

    def __init__(
        self,
        control: ArmControl,
        *,
        inputs: PolicyInputs,
        inference: InferenceLoop,
        beat: Beat,
        every_tick: bool,
        now_s: Callable[[], float],
        clock_ns: Callable[[], int],
        publish: Callable[[Twist, int], None],
        changed: Callable[[Order], None],
        report: Callable[[Miss], None],
    ) -> None:
        self._control = control
        self._inputs = inputs
        self._inference = inference
        self._beat = beat
        self._every_tick = every_tick
        self._now_s = now_s
        self._clock_ns = clock_ns
        self._publish = publish
        self._changed = changed
        self._report = report
        self._index = 0
        self._cycle = -1
        self._taken = 0
        self.order: Order | None = None
        self.stops: Counter[Reason] = Counter()
        self.rate = RateMeter()
        self.ticks = RateMeter()
        self.arrival_age_s = Spread()
        self.stamp_age_s = Spread()
        self.misses = MissCounter("control")

    def begin(self, now_s: float) -> None:
        """Let the first tick be that of the next cycle."""
        self._index = self._beat.ticks * self._beat.next_cycle(now_s)

    def deadline_s(self) -> float:
        """Return when the next tick is due."""
        return self._beat.tick_s(self._index)

    def run(self, now_s: float) -> None:
        """Do a tick."""
        tick_s = self._beat.period_s / self._beat.ticks
        self.ticks.note(now_s)
        late_s = now_s - self.deadline_s()
        if late_s > tick_s and (miss := self.misses.note(late_s, now_s)) is not None:
            self._report(miss)
        # What is late is done at once; the deadlines that have passed as well are left out.
        self._index += max(0, int(late_s / tick_s))
        self._tick(self._index)
        self._index += 1

    def _tick(self, tick: int) -> None:
        # The stamp is of the time that the limits of acceleration count from.
        now_s, stamp_ns = self._now_s(), self._clock_ns()
        order = self._control.tick(self._inputs.readings(now_s))
        before, self.order = self.order, order
        if before is None or (before.state, before.reason) != (order.state, order.reason):
            if order.reason is not Reason.NONE:
                self.stops[order.reason] += 1
            self._changed(order)
        cycle, place = divmod(tick, self._beat.ticks)
        taken = self._inference.taken
        # At the policy's rate: as soon as its command is there, at the latest as the cycle ends.
        is_due = cycle != self._cycle and (taken != self._taken or place == self._beat.ticks - 1)
        if not (self._every_tick or is_due or order.is_urgent):
            return
        self._publish(order.twist, stamp_ns)
        self._cycle = cycle
        sent_s = self._now_s()
        self.rate.note(sent_s)
        origin = self._inference.origin
        if taken != self._taken and origin is not None and order.state is State.RUNNING:
            self.arrival_age_s.note(sent_s - origin.arrival_s)
            self.stamp_age_s.note(sent_s - now_s + 1e-9 * (stamp_ns - origin.stamp_ns))
        self._taken = taken

    def report(self, now_s: float) -> Report:
        """Return the state of the loop, for the diagnostics."""
        order = self.order
        if order is None:
            return Level.OK, "not begun", {}
        values = {
            "state": order.state.value,
            "reason": order.reason.value,
            "stops": ", ".join(f"{reason} {count}" for reason, count in self.stops.copy().items())
            or "none",
            "command_rate_hz": f"{self.rate.rate_hz(now_s):.2f}",
            "control_rate_hz": f"{self.ticks.rate_hz(now_s):.2f}",
            "deadline_misses": str(self.misses.count),
            "deadline_misses_over_40_ms": str(self.misses.reported),
            "latest_ms": milliseconds(self.misses.worst_s),
        }
        message = f"{order.state.value}: {order.detail}" if order.detail else order.state.value
        if order.state is State.LATCHED:
            message += "; call set_enabled once it is safe"
        return LEVELS[order.state], message, values
