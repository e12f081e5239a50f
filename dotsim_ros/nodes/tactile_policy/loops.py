# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What `tactile_policy` does next to receiving: inference and control."""

from __future__ import annotations

from collections import Counter
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import msg_adapters
from dotsim_ros.control.arm.command import ANGULAR, LINEAR, Twist
from dotsim_ros.control.safety_layer.arm_control import ArmControl, Order
from dotsim_ros.control.safety_layer.limits import Reason, State
from dotsim_ros.nodes.common.beat import Beat
from dotsim_ros.nodes.common.counters import MissCounter, RateMeter, Spread, milliseconds
from dotsim_ros.nodes.common.health import Report
from dotsim_ros.nodes.simulated_time.latency import Latency
from msg_adapters import Level

if TYPE_CHECKING:
    from rclpy.publisher import Publisher

    from dotsim_ros.control.policy.network import Policy
    from dotsim_ros.nodes.common.node import WorkingNode
    from dotsim_ros.nodes.tactile_policy.inputs import HeardImage, PolicyInputs
    from dotsim_ros.nodes.tactile_policy.parameters import TactilePolicyParameters

WAIT_SHARE = 0.6
"""Share of a period that a cycle waits for an image that is not there at its deadline."""
LOG_PERIOD_S = 1.0
INFERENCE_BROKEN = "inference failed: the arm stops when no command comes"

LEVELS = {
    State.DISABLED: Level.OK,
    State.STARTING: Level.OK,
    State.RUNNING: Level.OK,
    State.RETREATING: Level.WARN,
    State.STOPPED: Level.WARN,
    State.LATCHED: Level.ERROR,
}

Fault = tuple[Reason, str]
"""Why the arm must stop for good, also in words."""


class InferenceLoop:
    """Asks the policy once a cycle, with the newest image.

    Attributes:
        largest_distance: images less like those of the training are another sensor's.
        idle: (H, W, 3) the image at rest, or None where it is not known.
        origin: the image that the newest command answers.
        distance: of the newest image from those of the training.
        without_image: cycles in which no new image came.
    """

    def __init__(
        self,
        node: WorkingNode,
        settings: TactilePolicyParameters,
        inputs: PolicyInputs,
        control: ArmControl,
        beat: Beat,
        policy: Policy,
    ) -> None:
        self._node, self._policy = node, policy
        self._inputs, self._control, self._beat = inputs, control, beat
        self._latency = Latency(settings.inference_latency_s, seed=settings.latency_seed)
        self.largest_distance = settings.maximum_image_distance or policy.largest_distance
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
            if image is None and (now_s := self._node.now_s()) < until_s:
                self._look_s = min(now_s + beat.period_s / beat.ticks, until_s)
                return
            self._cycle(image, deadline_s)
        elif (image := self._inputs.newest_image()) is not None and image is not self._last:
            # So that the first command needs no time to find its place.
            self._last = image
            beat.lean(deadline_s - image.arrival_s)
        self._look_s = None
        now_s = self._node.now_s()
        late_s = now_s - deadline_s - beat.period_s
        if late_s > 0.0:
            note_miss(self._node, self.misses, late_s, now_s)
        # A cycle that begins late is better than none; those that have passed are left out.
        self._index += 1 + max(0, int(late_s / beat.period_s))

    def _cycle(self, image: HeardImage | None, deadline_s: float) -> None:
        if image is None:
            self.without_image += 1
            return
        self._last = image
        self._beat.lean(deadline_s - image.arrival_s)
        ask = partial(self._answer, image, self.idle)
        take = partial(self._take, image, self._node.now_s())
        self._node.compute(self._latency, ask, take, INFERENCE_BROKEN)

    def _answer(
        self, image: HeardImage, idle: NDArray[np.uint8] | None
    ) -> tuple[float, Twist | Fault | ValueError]:
        """Return the distance of an image from those of the training (the last one where it is not
        known), and the command (6,), a fault, or why the image cannot be read."""
        assert idle is not None
        distance = self.distance
        try:
            pixels = image.pixels()
        except ValueError as error:
            return distance, error
        try:
            distance = self._policy.image_distance(pixels, idle)
            if not distance <= self.largest_distance:
                return distance, (
                    Reason.WRONG_SENSOR,
                    f"the image is {distance:.1f} away from those of the training, at most "
                    f"{self.largest_distance:.1f} is usual: another sensor, a damaged one, or "
                    "an idle image that does not go with it",
                )
            return distance, self._policy(pixels, idle)
        except ValueError as error:
            return distance, (Reason.WRONG_SENSOR, str(error))
        except Exception as error:
            # Whatever a network's runtime may raise: the arm must not go on with the last command.
            return distance, (Reason.POLICY_FAILED, f"the policy failed: {error!r}")

    def _take(
        self, image: HeardImage, begun_s: float, answer: tuple[float, Twist | Fault | ValueError]
    ) -> None:
        now_s = self._node.now_s()
        self.spent_s.note(now_s - begun_s)
        self.distance, found = answer
        if isinstance(found, ValueError):
            self._inputs.refuse("image", found)
        elif isinstance(found, tuple):
            self._control.latch(*found)
        else:
            self.rate.note(now_s)
            if self._control.put(found, now_s, image_s=image.arrival_s):
                self.origin = image
                self.taken += 1

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
            **miss_values(self.misses),
        }
        if self.idle is None:
            why = "no idle image: call calibrate_idle with the sensor untouched"
            return Level.WARN, why, values
        return Level.OK, "ready", values


class ControlLoop:
    """Publishes the orders: one a tick or one a cycle, and every one that stops the arm.

    Attributes:
        stops: how often the arm was stopped, or retreated, by reason.
        rate, ticks, misses: of published commands, and of the loop.
        arrival_age_s, stamp_age_s: of the image that a new command answers, when it is published.
    """

    def __init__(
        self,
        node: WorkingNode,
        settings: TactilePolicyParameters,
        inputs: PolicyInputs,
        control: ArmControl,
        beat: Beat,
        inference: InferenceLoop,
        publisher: Publisher,
    ) -> None:
        self._node, self._publisher = node, publisher
        self._inputs, self._control, self._beat = inputs, control, beat
        self._inference = inference
        self._frame_id = settings.control.command_frame
        self._every_tick = settings.control.interpolates
        self._index = 0
        self._cycle = -1
        self._taken = 0
        self._logged_s: dict[tuple[State, Reason], float] = {}
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
        if late_s > tick_s:
            note_miss(self._node, self.misses, late_s, now_s)
        # What is late is done at once; the deadlines that have passed as well are left out.
        self._index += max(0, int(late_s / tick_s))
        self._tick(self._index)
        self._index += 1

    def publish(self, twist: Twist, stamp_ns: int) -> None:
        """Send a command (6,) to the arm."""
        self._publisher.publish(
            msg_adapters.encode_twist_stamped(
                twist[LINEAR], twist[ANGULAR], stamp_ns=stamp_ns, frame_id=self._frame_id
            )
        )

    def _tick(self, tick: int) -> None:
        # The stamp is of the time that the limits of acceleration count from.
        now_s, stamp_ns = self._node.now_s(), self._node.time_ns()
        order = self._control.tick(self._inputs.readings(now_s))
        before, self.order = self.order, order
        if before is None or (before.state, before.reason) != (order.state, order.reason):
            if order.reason is not Reason.NONE:
                self.stops[order.reason] += 1
            self._log_change(order)
        cycle, place = divmod(tick, self._beat.ticks)
        taken = self._inference.taken
        # At the policy's rate: as soon as its command is there, at the latest as the cycle ends.
        is_due = cycle != self._cycle and (taken != self._taken or place == self._beat.ticks - 1)
        if not (self._every_tick or is_due or order.is_urgent):
            return
        self.publish(order.twist, stamp_ns)
        self._cycle = cycle
        sent_s = self._node.now_s()
        self.rate.note(sent_s)
        origin = self._inference.origin
        if taken != self._taken and origin is not None and order.state is State.RUNNING:
            self.arrival_age_s.note(sent_s - origin.arrival_s)
            self.stamp_age_s.note(sent_s - now_s + 1e-9 * (stamp_ns - origin.stamp_ns))
        self._taken = taken

    def _log_change(self, order: Order) -> None:
        now_s, key, logger = (
            self._node.now_s(),
            (order.state, order.reason),
            self._node.get_logger(),
        )
        is_latched = order.state is State.LATCHED
        if not is_latched and now_s - self._logged_s.get(key, -np.inf) < LOG_PERIOD_S:
            return
        self._logged_s[key] = now_s
        if is_latched:
            logger.error(f"{_text(order)} [{order.reason}]; call set_enabled once it is safe")
        elif order.detail:
            logger.warning(f"{_text(order)} [{order.reason}]")
        else:
            logger.info(_text(order))

    def report(self, now_s: float) -> Report:
        """Return the state of the loop, for the diagnostics."""
        order = self.order
        if order is None:
            return Level.OK, "not begun", {}
        stops = ", ".join(f"{reason} {count}" for reason, count in self.stops.copy().items())
        values = {
            "state": order.state.value,
            "reason": order.reason.value,
            "stops": stops or "none",
            "command_rate_hz": f"{self.rate.rate_hz(now_s):.2f}",
            "control_rate_hz": f"{self.ticks.rate_hz(now_s):.2f}",
            **miss_values(self.misses),
        }
        advice = "; call set_enabled once it is safe" if order.state is State.LATCHED else ""
        return LEVELS[order.state], f"{_text(order)}{advice}", values


def _text(order: Order) -> str:
    return f"{order.state.value}: {order.detail}" if order.detail else order.state.value


def note_miss(node: WorkingNode, misses: MissCounter, late_s: float, now_s: float) -> None:
    """Count a missed deadline, and log it where it is worth a line."""
    miss = misses.note(late_s, now_s)
    if miss is not None:
        before = f"; {miss.unlogged} more since the last such line" if miss.unlogged else ""
        node.get_logger().warning(
            f"{miss.loop}: a deadline was missed by {1e3 * miss.late_s:.0f} ms{before}"
        )


def miss_values(misses: MissCounter) -> dict[str, str]:
    """Return what is known of missed deadlines, for the diagnostics."""
    return {
        "deadline_misses": str(misses.count),
        "deadline_misses_over_40_ms": str(misses.reported),
        "latest_ms": milliseconds(misses.worst_s),
    }
