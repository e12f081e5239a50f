# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`tactile_policy`: leads an arm by touch.

Tactile images and the arm's pose go in, velocity commands come out. In real time there are three
threads: the executor's receives, one runs the policy 25 times a second, one controls the arm 100
times a second. In simulated time the executor's does all of it, in the order of the times.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped
from numpy.typing import NDArray
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_srvs.srv import SetBool, Trigger

from dotsim_ros.control.arm.command import zero_twist
from dotsim_ros.control.policy.network import Policy, load_policy
from dotsim_ros.control.safety_layer.arm_control import ArmControl
from dotsim_ros.control.safety_layer.limits import CONTROL_RATE_HZ, POLICY_RATE_HZ, State
from dotsim_ros.io.documents import value_text
from dotsim_ros.nodes.common.beat import Beat
from dotsim_ros.nodes.common.declare import declare
from dotsim_ros.nodes.common.health import statuses_of
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.priority import take_priority
from dotsim_ros.nodes.common.spin import run_node
from dotsim_ros.nodes.tactile_policy.files import policy_folder, read_image
from dotsim_ros.nodes.tactile_policy.inputs import NO_FORCE, NO_FORCE_LIMIT, PolicyInputs
from dotsim_ros.nodes.tactile_policy.loops import INFERENCE_BROKEN, ControlLoop, InferenceLoop
from dotsim_ros.nodes.tactile_policy.parameters import TactilePolicyParameters
from msg_adapters import Status

COMMAND_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
IMAGE_MARGIN_S = 0.005
TOUCHED_N = 0.1
"""A force above this means that the sensor is not at rest."""
CONTROL_BROKEN = "control failed: the arm stops when no command comes"
SWITCH_INTERVAL_S = 0.0005
"""How long Python lets a thread run before another one that waits: the control loop has little time
to wait for the interpreter; the default is 5 ms."""

Loader = Callable[[Path, str], Policy]


class TactilePolicy(WorkingNode):
    """The node; parameters, topics and services as docs/run.md lists them.

    Args:
        load: opens the policy of a folder and one of its paths.
    """

    def __init__(self, load: Loader = load_policy) -> None:
        super().__init__("tactile_policy")
        self._settings = declare(self, TactilePolicyParameters)
        self._policy = load(policy_folder(self._settings.policy), self._settings.path)
        if abs(self._policy.rate_hz - POLICY_RATE_HZ) > 0.01:
            raise ValueError(
                f"the policy {value_text(self._policy.name)} was trained for "
                f"{self._policy.rate_hz} Hz, expected {POLICY_RATE_HZ:g} Hz"
            )
        self._control = ArmControl(self._settings.limits, self._settings.control)
        self._inputs = PolicyInputs(self, self._settings, latch=self._control.latch)
        self._commands = self.open_publisher(TwistStamped, "~/cmd_vel", COMMAND_QOS)
        beat = Beat(
            1.0 / POLICY_RATE_HZ,
            ticks=round(CONTROL_RATE_HZ / POLICY_RATE_HZ),
            start_s=self.now_s(),
            margin_s=IMAGE_MARGIN_S,
        )
        shared = self, self._settings, self._inputs, self._control, beat
        self._inference = InferenceLoop(*shared, self._policy)
        self._loop = ControlLoop(*shared, self._inference, self._commands)
        if self._settings.idle_image:
            idle = read_image(Path(self._settings.idle_image))
            # Refuses one that the policy cannot use.
            self._policy(idle, idle)
            self._inference.idle = idle
        self.report_health(
            self._settings.diagnostics_period_s,
            self._health,
            without_clock="stamps cannot be compared with it",
        )
        self.create_service(SetBool, "~/set_enabled", self._on_set_enabled)
        self.create_service(Trigger, "~/calibrate_idle", self._on_calibrate_idle)

    def begin(self) -> None:
        """Do once what takes longest the first time, then start the loops.

        Raises:
            ValueError: the system does not give the priority that is asked for.
        """
        take_priority(self._settings.realtime_priority)
        blank = np.zeros((*self._policy.image_shape, 3), dtype=np.uint8)
        self._policy.image_distance(blank, blank)
        self._policy(blank, blank)
        if not self.is_simulated:
            self._loop.publish(zero_twist(), self.time_ns())
        # Before the loops: the first line of a log takes its time as well.
        self.get_logger().info(
            f"ready: {self._policy.name}, path {self._policy.path}, "
            f"{self._settings.control.command_rate_hz:g} commands a second on "
            f"{self._commands.topic_name}; disabled until it is enabled by"
        )
        name = self.get_fully_qualified_name()
        if not self._settings.idle_image:
            self.get_logger().info(f"ros2 service call {name}/calibrate_idle std_srvs/srv/Trigger")
        self.get_logger().info(
            f'ros2 service call {name}/set_enabled std_srvs/srv/SetBool "{{data: true}}"'
        )
        if not self._inputs.hears_force:
            self.get_logger().warning(f"{NO_FORCE_LIMIT}; set it for a sensor that measures force")
        self._inference.begin(self.now_s())
        self._loop.begin(self.now_s())
        self.start_work("inference", self._inference, INFERENCE_BROKEN)
        self.start_work("control", self._loop, CONTROL_BROKEN)

    def _health(self) -> list[Status]:
        now_s = self.now_s()
        reports = {
            "control": self._loop.report(now_s),
            "inference": self._inference.report(self._loop, now_s),
            "input": self._inputs.report(now_s),
        }
        return statuses_of(self.label, self._policy.name, reports, self._crowds())

    def _crowds(self) -> dict[str, str]:
        """Return which topics have more than one publisher, by part of the diagnostics."""
        crowds = {}
        for part, topics in (
            ("control", [self._commands.topic_name]),
            ("input", self._inputs.topics),
        ):
            for topic in topics:
                count = self.count_publishers(topic)
                if count > 1:
                    crowds[part] = f"{topic} has {count} publishers, expected one"
        return crowds

    def _on_set_enabled(self, request: Any, response: Any) -> Any:
        if not request.data:
            self._control.disable()
            response.success, response.message = True, "disabled: the commands are zero"
            return response
        try:
            self._check_start()
            self._control.enable(self._inputs.readings(self.now_s()))
        except ValueError as error:
            response.success, response.message = False, f"not enabled: {error}"
        else:
            response.success, response.message = True, "enabled: the arm moves"
        return response

    def _check_start(self) -> None:
        if self._control.state not in (State.DISABLED, State.LATCHED):
            raise ValueError("it is enabled already")
        if self._inference.idle is None:
            raise ValueError("no idle image: call calibrate_idle with the sensor untouched")
        if self._inputs.hears_force and not self._inputs.force.count:
            raise ValueError(NO_FORCE)
        for crowd in self._crowds().values():
            raise ValueError(f"{crowd}: two senders would mix")

    def _on_calibrate_idle(self, _request: Any, response: Any) -> Any:
        try:
            self._inference.idle = self._image_at_rest()
        except ValueError as error:
            response.success, response.message = False, f"no idle image taken: {error}"
        else:
            response.success, response.message = True, "the newest image is the idle image now"
        return response

    def _image_at_rest(self) -> NDArray[np.uint8]:
        if self._control.wants_commands():
            raise ValueError("the arm may be moving: disable first")
        readings, image = self._inputs.readings(self.now_s()), self._inputs.newest_image()
        if image is None or readings.image.age_s > 1.0:
            raise ValueError(
                f"no image has come within the last second on {self._inputs.topics[0]}"
            )
        if readings.force_n > TOUCHED_N:
            raise ValueError(
                f"the force is {readings.force_n:.2f} N: lift the sensor, or tare its force"
            )
        crop = image.pixels().copy()
        self._policy(crop, crop)
        return crop


def main() -> int:
    """Run the node until it is stopped; return the exit status."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    return run_node(TactilePolicy)


if __name__ == "__main__":
    raise SystemExit(main())
