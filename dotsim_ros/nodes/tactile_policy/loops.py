"""The two threads of `tactile_policy` beside the one that receives: inference and control.

Needs no ROS: what they publish and log goes through functions that are handed in.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from threading import Event
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.nodes.common.beat import Beat
from dotsim_ros.nodes.common.counters import Miss, MissCounter, RateMeter, Spread
from dotsim_ros.tasks.arm.command import Twist
from dotsim_ros.tasks.control.arm_control import ArmControl, Order
from dotsim_ros.tasks.control.safety import Reason, State

if TYPE_CHECKING:
    from dotsim_ros.nodes.tactile_policy.inputs import HeardImage, PolicyInputs
    from dotsim_ros.tasks.policy.network import Policy

WAIT_SHARE = 0.6
"""Share of a period that a cycle waits for an image that is not there at its deadline."""


class InferenceLoop:
    """Asks the policy once a cycle, with the newest image.

    Args:
        policy: gives the commands.
        largest_distance: images less like those of the training are another sensor's.
        inputs: the images.
        control: takes the commands.
        beat: the cycles.
        report: called with a missed deadline that is worth a line in the log.

    Attributes:
        idle: (H, W, 3) the image at rest, or None where it is not known.
        origin: the image that the newest command answers.
        distance: of the newest image from those of the training.
        taken: commands that were taken.
        without_image: cycles in which no new image came.
        rate, spent_s, misses: figures of the loop.
    """

    def __init__(
        self,
        policy: Policy,
        *,
        largest_distance: float,
        inputs: PolicyInputs,
        control: ArmControl,
        beat: Beat,
        report: Callable[[Miss], None],
    ) -> None:
        self._policy = policy
        self.largest_distance = largest_distance
        self._inputs = inputs
        self._control = control
        self._beat = beat
        self._report = report
        self._last: HeardImage | None = None
        self.idle: NDArray[np.uint8] | None = None
        self.origin: HeardImage | None = None
        self.distance = np.nan
        self.taken = 0
        self.without_image = 0
        self.rate = RateMeter()
        self.spent_s = Spread()
        self.misses = MissCounter("inference")

    def run(self, stop: Event) -> None:
        """Run until stopped."""
        beat = self._beat
        index = beat.next_cycle(time.monotonic())
        while not stop.wait(max(0.0, beat.cycle_s(index) - time.monotonic())):
            deadline_s = beat.cycle_s(index)
            if self._control.wants_commands():
                self._cycle(deadline_s)
            elif (image := self._inputs.newest_image()) is not None and image is not self._last:
                # So that the first command needs no time to find its place.
                self._last = image
                self._beat.lean(deadline_s - image.arrival_s)
            now_s = time.monotonic()
            late_s = now_s - deadline_s - beat.period_s
            if late_s > 0.0 and (miss := self.misses.note(late_s, now_s)) is not None:
                self._report(miss)
            # A cycle that begins late is better than none; those that have passed are left out.
            index += 1 + max(0, int(late_s / beat.period_s))

    def _cycle(self, deadline_s: float) -> None:
        until_s = deadline_s + WAIT_SHARE * self._beat.period_s
        image = self._inputs.image_after(self._last, until_s=until_s)
        if image is None:
            self.without_image += 1
            return
        self._last = image
        self._beat.lean(deadline_s - image.arrival_s)
        begun_s = time.monotonic()
        command = self._command(image)
        now_s = time.monotonic()
        self.spent_s.note(now_s - begun_s)
        if command is None:
            return
        self.rate.note(now_s)
        if self._control.put(command, now_s, image_s=image.arrival_s):
            self.origin = image
            self.taken += 1

    def _command(self, image: HeardImage) -> Twist | None:
        try:
            pixels = image.pixels()
        except ValueError as error:
            self._inputs.refuse("image", error)
            return None
        idle = self.idle
        assert idle is not None
        try:
            self.distance = self._policy.image_distance(pixels, idle)
            if not self.distance <= self.largest_distance:
                self._control.latch(
                    Reason.WRONG_SENSOR,
                    f"the image is {self.distance:.1f} away from those of the training, at most "
                    f"{self.largest_distance:.1f} is usual: another sensor, a damaged one, or an "
                    "idle image that does not go with it",
                )
                return None
            return self._policy(pixels, idle)
        except ValueError as error:
            self._control.latch(Reason.WRONG_SENSOR, str(error))
        except Exception as error:
            # Whatever a network's runtime may raise: the arm must not go on with the last command.
            self._control.latch(Reason.POLICY_FAILED, f"the policy failed: {error!r}")
        return None


class ControlLoop:
    """Publishes the orders: one a tick or one a cycle, and every one that stops the arm.

    Args:
        control: gives the orders.
        inputs: what is known of the arm.
        inference: where the commands come from.
        beat: the ticks.
        every_tick: publish at the rate of the ticks.
        clock_ns: the time that stamps are of.
        publish: sends a command with its stamp.
        changed: called with each order of a new state or reason.
        report: called with a missed deadline that is worth a line in the log.

    Attributes:
        order: the newest.
        stops: how often the arm was stopped, or retreated, by reason.
        rate: of published commands.
        ticks: of the loop.
        arrival_age_s, stamp_age_s: of the image that a new command answers, when it is published.
        misses: of the ticks.
    """

    def __init__(
        self,
        control: ArmControl,
        *,
        inputs: PolicyInputs,
        inference: InferenceLoop,
        beat: Beat,
        every_tick: bool,
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
        self._clock_ns = clock_ns
        self._publish = publish
        self._changed = changed
        self._report = report
        self._cycle = -1
        self._taken = 0
        self.order: Order | None = None
        self.stops: Counter[Reason] = Counter()
        self.rate = RateMeter()
        self.ticks = RateMeter()
        self.arrival_age_s = Spread()
        self.stamp_age_s = Spread()
        self.misses = MissCounter("control")

    def run(self, stop: Event) -> None:
        """Run until stopped."""
        beat = self._beat
        tick_s = beat.period_s / beat.ticks
        index = beat.ticks * beat.next_cycle(time.monotonic())
        while not stop.wait(max(0.0, beat.tick_s(index) - time.monotonic())):
            now_s = time.monotonic()
            self.ticks.note(now_s)
            late_s = now_s - beat.tick_s(index)
            if late_s > tick_s and (miss := self.misses.note(late_s, now_s)) is not None:
                self._report(miss)
            # What is late is done at once; the deadlines that have passed as well are left out.
            index += max(0, int(late_s / tick_s))
            self._tick(index)
            index += 1

    def _tick(self, tick: int) -> None:
        # The stamp is of the time that the limits of acceleration count from.
        now_s, stamp_ns = time.monotonic(), self._clock_ns()
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
        sent_s = time.monotonic()
        self.rate.note(sent_s)
        origin = self._inference.origin
        if taken != self._taken and origin is not None and order.state is State.RUNNING:
            self.arrival_age_s.note(sent_s - origin.arrival_s)
            self.stamp_age_s.note(sent_s - now_s + 1e-9 * (stamp_ns - origin.stamp_ns))
        self._taken = taken
