# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`time_stepper`: moves simulated time on for nodes that the user launches.

docs/simulated_time.md describes the nodes that take part, the services and the faults.
"""

from __future__ import annotations

import time
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.node import NodeNameNonExistentError
from std_srvs.srv import SetBool, Trigger

from dotsim_ros.nodes.common.declare import declare
from dotsim_ros.nodes.common.health import statuses_of
from dotsim_ros.nodes.common.node import BROKEN, WorkingNode
from dotsim_ros.nodes.common.spin import run_node
from dotsim_ros.nodes.simulated_time.protocol import NANOSECONDS_PER_SECOND
from dotsim_ros.nodes.simulated_time.stepper import (
    SpeedLimit,
    Stepper,
    StepperSettings,
    SteppingError,
)
from dotsim_ros.nodes.time_stepper.control import StepControl, Turn
from dotsim_ros.nodes.time_stepper.parameters import TimeStepperParameters
from dotsim_ros.nodes.time_stepper.standard_services import (
    Outcome,
    StepperActions,
    has_standard_services,
    offer_standard_services,
)
from msg_adapters import Level, Status

RESET = "~/reset"
RESET_TYPE = "std_srvs/srv/Trigger"
LOG_EVERY_S = 5.0


class TimeStepper(WorkingNode):
    """Steps its participants until it is stopped or one of them fails."""

    def __init__(self) -> None:
        super().__init__("time_stepper")
        if self.is_simulated:
            raise ValueError(
                "use_sim_time is set, and time_stepper is what makes the simulated time: unset it "
                "on this node"
            )
        self._settings = settings = declare(self, TimeStepperParameters)
        self._participants = settings.awaited()
        self._stepper = Stepper(
            self,
            self._participants,
            StepperSettings(
                period_s=settings.period_s,
                start_s=settings.start_s,
                speed=settings.speed,
                patience_s=settings.patience_s,
            ),
        )
        self._control = StepControl(is_paused=settings.paused)
        self._has_joined = False
        self._fault = ""
        self._steps = 0
        self._reported = (time.monotonic(), self._stepper.time_ns)
        self._clients_of_reset: dict[str, Any] = {}
        # What a thread has done goes on in the executor at once.
        self._turned = self.create_guard_condition(lambda: None)
        self.create_service(Trigger, "~/step", self._on_step)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(Trigger, RESET, self._on_reset)
        if has_standard_services():
            offer_standard_services(
                self,
                StepperActions(
                    lambda: self._control.is_paused,
                    self._control.pause,
                    self._take_steps,
                    self._reset,
                    rclpy.try_shutdown,
                ),
            )
        self._report = self.report_health(
            settings.diagnostics_period_s, self._health, "diagnostics have no time"
        )

    def begin(self) -> None:
        """Start to step."""
        self.start_thread("steps", self._run, "stepping failed")
        self.get_logger().info(
            f"ready: steps of {self._settings.period_s:g} s from {self._settings.start_s:g} s on, "
            f"with {', '.join(self._participants)}"
        )

    def destroy_node(self) -> None:
        """Let nothing wait any more, and take the node down."""
        self._control.end()
        self._stepper.cancel()
        super().destroy_node()

    def _run(self) -> None:
        try:
            self._stepper.join()
            self._has_joined = True
            self.get_logger().info(
                f"simulated time begins{', paused' if self._control.is_paused else ''}: all "
                "participants are there"
            )
            self._take_turns()
        except SteppingError as error:
            if self.stopping.is_set() or not self.context.ok():
                return
            self._fault = str(error)
            self.get_logger().fatal(self._fault)
            self._report()
            self.exit_status = BROKEN
            rclpy.try_shutdown()

    def _take_turns(self) -> None:
        limit: SpeedLimit | None = None
        while (turn := self._control.begin_step()) is not Turn.END:
            if turn is Turn.ASKED:
                limit = None
            elif limit is None:
                limit = SpeedLimit(self._settings.speed, now_s=time.monotonic())
            self._stepper.step()
            self._steps += 1
            self._control.end_step(turn)
            self._turned.trigger()
            if limit is not None:
                self._control.rest(limit.delay_s(self._settings.period_s, time.monotonic()))
            if self._control.is_paused:
                limit = None

    async def _on_step(self, _request: Any, response: Any) -> Any:
        response.success, response.message = await self._take_steps(self._settings.steps_per_call)
        return response

    def _on_pause(self, request: Any, response: Any) -> Any:
        self._control.pause(request.data)
        response.success = True
        response.message = "paused" if request.data else "running"
        return response

    async def _on_reset(self, _request: Any, response: Any) -> Any:
        response.success, response.message = await self._reset()
        return response

    async def _take_steps(self, count: int) -> Outcome:
        """Take steps while time is paused; return that it is done, or why not."""
        try:
            await self._control.ask(count)
        except ValueError as error:
            return False, str(error)
        return True, f"at {self._time_s:.3f} s"

    async def _reset(self) -> Outcome:
        """Reset the participants that can be, between two steps."""
        await self._control.hold()
        try:
            services = self._services_of_reset()
            refusals = [
                f"{name}: {reason}"
                for name, service in services.items()
                if (reason := await self._reset_one(service))
            ]
        finally:
            self._control.release()
        if not services:
            return False, f"no participant has a service {RESET} ({RESET_TYPE})"
        if refusals:
            return False, "; ".join(refusals)
        return True, f"reset {', '.join(services)}; time goes on from {self._time_s:.3f} s"

    def _services_of_reset(self) -> dict[str, str]:
        """Return the service of each participant that can be reset, by the participant's name."""
        found = {}
        for given in self._participants:
            full = self.resolve_topic_name(given)
            namespace, _, name = full.rpartition("/")
            try:
                offered = self.get_service_names_and_types_by_node(name, namespace or "/")
            except NodeNameNonExistentError:
                continue
            if (f"{full}/reset", [RESET_TYPE]) in offered:
                found[given] = f"{full}/reset"
        return found

    async def _reset_one(self, service: str) -> str:
        """Call a service; return why it does not do what it should, empty where it does."""
        if service not in self._clients_of_reset:
            self._clients_of_reset[service] = self.create_client(Trigger, service)
        future = self._clients_of_reset[service].call_async(Trigger.Request())
        # A future that is cancelled is done, without an answer.
        end = self.create_timer(
            self._settings.patience_s, future.cancel, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        answer = await future
        self.destroy_timer(end)
        if answer is None:
            return f"no answer within {self._settings.patience_s:g} s"
        return "" if answer.success else str(answer.message) or "refused without a reason"

    @property
    def _time_s(self) -> float:
        return self._stepper.time_ns / NANOSECONDS_PER_SECOND

    def _health(self) -> list[Status]:
        waiting_for = self._stepper.waiting_for
        level, state = Level.OK, "paused" if self._control.is_paused else "running"
        if self._fault:
            level, state = Level.ERROR, "ended"
        elif not self._has_joined or waiting_for:
            level, state = Level.WARN, "waiting"
            if waiting_for:
                self.get_logger().info(f"waiting: {waiting_for}", throttle_duration_sec=LOG_EVERY_S)
        values = {
            "state": state,
            "time_s": f"{self._time_s:.3f}",
            "speed_factor": f"{self._speed_factor():.3g}",
            "steps": str(self._steps),
            "waiting_for": waiting_for,
        }
        message = self._fault or (waiting_for if state == "waiting" else "") or state
        return statuses_of(self.label, "", {"time": (level, message, values)})

    def _speed_factor(self) -> float:
        """Return the simulated seconds for each real one, since the last report."""
        before_s, before_ns = self._reported
        self._reported = now_s, now_ns = time.monotonic(), self._stepper.time_ns
        return (now_ns - before_ns) / NANOSECONDS_PER_SECOND / max(now_s - before_s, 1e-9)


def main() -> int:
    """Run the node until it is stopped; return the exit status."""
    return run_node(TimeStepper)


if __name__ == "__main__":
    raise SystemExit(main())
