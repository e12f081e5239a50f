# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The nodes of the closed loop as processes, led through one trial after the other.

The sensor, the policy and the arm are the executables that a user starts, with the parameters of
`params/closed_loop.yaml`; everything goes over DDS.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from dotsim_ros.control.arm.kinematics import check_pinocchio
from dotsim_ros.control.loop.recording import LoopPlaces, LoopRecording, recording_of
from dotsim_ros.control.policy.paths import DomeContact
from dotsim_ros.control.safety_layer.limits import SafetyLimits
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import read_yaml
from dotsim_ros.io.files import parameter_path
from dotsim_ros.nodes.common.parameters import from_values
from dotsim_ros.nodes.common.processes import NodeProcess
from dotsim_ros.nodes.loop.loop_time import REALTIME, SIMULATED, RealTime, SteppedTime
from dotsim_ros.nodes.loop.observer import LOOP_TOPICS, LoopObserver
from dotsim_ros.nodes.simulated_time.participants import Participant
from dotsim_ros.nodes.simulated_time.stepper import StepperSettings
from dotsim_ros.nodes.tactile_policy.parameters import TactilePolicyParameters
from dotsim_ros.nodes.xarm_sim.parameters import XarmSimParameters

SENSOR, ARM, POLICY, RECORDER = "tactile_sim", "xarm_sim", "tactile_policy", "tactile_record"
COMPOSED = "closed_loop"
"""The executable of arm, sensor and policy in one process."""
START_TIMEOUT_S = 300.0
"""A first start compiles the gel's kernels and computes its tables."""
DIAGNOSTICS_PERIOD_S = 0.2
FAR_M = np.array([0.0, 0.0, 0.06])
"""Where the indenter is while the sensor is at rest: so far from anywhere else that it counts as a
new start, which brings the gel to rest."""
LIFTED_DEPTH_M = -0.5e-3
APPROACH_POINTS = 4
SETTLE_FRAMES = 4
ENABLE_TIMEOUT_S = 15.0
RECORDER_POLL_S = 0.02
ASK_EVERY_POSES = 100
POSE_DELAY_S = 0.3


@dataclass(frozen=True)
class LoopSetup:
    """Parameters of the nodes of a loop, next to `params/closed_loop.yaml`.

    Attributes:
        policy: folder of the policy, or a name below params/policies.
        policy_code: Python code to run in place of the policy's module.
        one_process: arm, sensor and policy run in one process; then only `start` starts them.

    Raises:
        ValueError: what the arm needs is not installed.
    """

    policy: str
    sensor: str = "densetact2"
    policy_parameters: Mapping[str, Any] = field(default_factory=dict)
    sensor_parameters: Mapping[str, Any] = field(default_factory=dict)
    arm_parameters: Mapping[str, Any] = field(default_factory=dict)
    policy_code: str = ""
    stepping: StepperSettings = field(default_factory=StepperSettings)
    one_process: bool = False

    def __post_init__(self) -> None:
        check_pinocchio()

    def limits(self) -> SafetyLimits:
        """Return what the policy's node lets the arm do."""
        given = loop_parameters(POLICY) | dict(self.policy_parameters)
        return from_values(TactilePolicyParameters, given).limits

    def places(self) -> LoopPlaces:
        """Return where the arm starts."""
        settings = from_values(XarmSimParameters, loop_parameters(ARM) | dict(self.arm_parameters))
        return LoopPlaces(settings.pose("start_pose"), settings.pose("tool_from_sensor"))


def loop_parameters(executable: str) -> dict[str, Any]:
    """Return the parameters of a node in `params/closed_loop.yaml`."""
    content = read_yaml(parameter_path("closed_loop.yaml"))
    given = content[f"/**/{executable}"]["ros__parameters"]
    return {key: tuple(v) if isinstance(v, list) else v for key, v in given.items()}


class LoopFault(StrEnum):
    """What may fail in a loop, on request."""

    IMAGES_CUT = "images cut"
    SENSOR_STOPPED = "sensor stopped"
    POSE_CUT = "pose cut"
    POSE_DELAYED = "pose delayed"
    ARM_STOPPED = "arm stopped"
    EMERGENCY_STOP = "emergency stop"


@dataclass(frozen=True)
class TimedFault:
    """Something that fails at a time, in seconds since the loop is led."""

    at_s: float
    fault: LoopFault


class RefusedError(OSError):
    """A node refuses a request."""


class ClosedLoop:
    """The processes of a loop and what they are observed by; a context manager.

    Args:
        setup: parameters of the nodes; may be replaced between two starts.
        contact: of the ball on the dome.
        topics: what to keep of what they publish.
        clock: SIMULATED, in steps that all nodes take together, or REALTIME.

    Attributes:
        led_speed_factor: seconds of the loop's time for each real one, while the policy led last.
    """

    def __init__(
        self,
        setup: LoopSetup,
        *,
        contact: DomeContact | None = None,
        topics: Mapping[str, type] = LOOP_TOPICS,
        clock: str = REALTIME,
    ) -> None:
        self.setup = setup
        self.contact = contact or DomeContact()
        self.places = setup.places()
        self.led_speed_factor = 1.0
        self._processes: dict[str, NodeProcess] = {}
        self._others: dict[str, Participant] = {}
        self._indenter = self.places.indenter(FAR_M)
        self.observer = LoopObserver(topics, is_stepped=clock == SIMULATED)
        self.time: RealTime | SteppedTime = (
            SteppedTime(self.observer, setup.stepping, DIAGNOSTICS_PERIOD_S)
            if clock == SIMULATED
            else RealTime(self.observer)
        )

    def __enter__(self) -> ClosedLoop:
        return self

    def __exit__(self, *_exception: object) -> None:
        self.close()

    def close(self) -> dict[str, int]:
        """Stop everything; return the nodes' exit statuses."""
        statuses = {name: node.stop() for name, node in reversed(self._processes.items())}
        self._processes.clear()
        self.observer.close()
        return statuses

    def process(self, executable: str) -> NodeProcess:
        """Return a node's process."""
        return self._processes[executable]

    def start(self, path: str, *, order: Sequence[str] = (ARM, SENSOR, POLICY)) -> None:
        """Start nodes in an order, the policy for a path, in place of those that run, and show it
        the sensor at rest."""
        if self.setup.one_process:
            parameters = {
                f"{node}:{name}": value
                for node in order
                for name, value in self._parameters(node, path).items()
            }
            self._launch(COMPOSED, parameters, remap=f"{POLICY}:~/cmd_vel:=cmd_vel")
            for executable in order:
                self._await(COMPOSED, f"[{executable}]: ready:")
            self._expect()
        else:
            self.start_nodes(*order, path=path)
        self.rest()
        self.calibrate_idle()

    def start_nodes(self, *executables: str, path: str = "") -> None:
        """Start nodes at once, in place of those that run; the policy for a path."""
        for executable in executables:
            is_policy = executable == POLICY
            self._launch(
                executable,
                self._parameters(executable, path),
                remap="~/cmd_vel:=cmd_vel" if is_policy else "",
                code=self.setup.policy_code if is_policy else "",
            )
        for executable in executables:
            self._await(executable)
        self._expect()

    def inject(self, fault: LoopFault) -> None:
        """Let something fail from now on, until `heal`.

        Raises:
            OSError: a node refuses, or does not answer.
        """
        match fault:
            case LoopFault.IMAGES_CUT:
                self._set(SENSOR, fail_drop_images=True)
            case LoopFault.SENSOR_STOPPED:
                self.observer.call(SetBool, f"{SENSOR}/set_enabled", data=False)
            case LoopFault.POSE_CUT:
                self.set_arm(fail_drop_feedback=True)
            case LoopFault.POSE_DELAYED:
                self.set_arm(fail_delay_s=POSE_DELAY_S)
            case LoopFault.ARM_STOPPED:
                self.set_arm(fail_stop=True)
            case LoopFault.EMERGENCY_STOP:
                self._trigger(f"{ARM}/emergency_stop")

    def heal(self) -> None:
        """End whatever `inject` brought about; the arm is at its start then.

        Raises:
            OSError: a node refuses, or does not answer.
        """
        self._set(SENSOR, fail_drop_images=False)
        self.observer.call(SetBool, f"{SENSOR}/set_enabled", data=True)
        self.set_arm(fail_drop_feedback=False, fail_delay_s=0.0, fail_stop=False)
        self._trigger(f"{ARM}/reset")

    def _parameters(self, executable: str, path: str) -> Mapping[str, Any]:
        setup = self.setup
        if executable == ARM:
            return setup.arm_parameters
        if executable == SENSOR:
            return {"sensor": setup.sensor, **setup.sensor_parameters}
        return {
            "policy": setup.policy,
            "path": path,
            "diagnostics_period_s": DIAGNOSTICS_PERIOD_S,
            **setup.policy_parameters,
        }

    def _launch(
        self, executable: str, parameters: Mapping[str, Any], *, remap: str = "", code: str = ""
    ) -> None:
        self.stop(executable)
        self.observer.diagnostics.clear()
        self._processes[executable] = NodeProcess(
            executable,
            {**parameters, **self.time.parameters},
            arguments=(
                "--params-file",
                str(parameter_path("closed_loop.yaml")),
                *(("-r", remap) if remap else ()),
            ),
            code=code,
        )

    def join(self, others: Mapping[str, Participant]) -> None:
        """Let nodes of the user's take part in the loop's time, in place of those before.

        Raises:
            OSError: they do not; says why.
        """
        self._others = dict(others)
        self._expect()

    def now_ns(self) -> int:
        """Return the loop's time, which messages are stamped with."""
        return self.time.now_ns()

    def _expect(self) -> None:
        """Let the nodes that run take part in the loop's time."""
        nodes = [
            node
            for executable in self._processes
            for node in ((ARM, SENSOR, POLICY) if executable == COMPOSED else (executable,))
        ]
        self.time.expect({**dict.fromkeys(nodes, Participant()), **self._others})

    def _await(self, executable: str, line: str = "ready:") -> None:
        """Wait until a node has said so."""
        self._processes[executable].wait_for_line(line, timeout_s=START_TIMEOUT_S)

    def stop(self, executable: str) -> None:
        """Stop a node, if it runs."""
        node = self._processes.pop(executable, None)
        if node is not None:
            node.stop()

    def place_indenter(self, pose: Pose) -> None:
        """Put the indenter somewhere in the base.

        Raises:
            OSError: the arm's node refuses.
        """
        numbers = [*pose.position_m.tolist(), *pose.quaternion_xyzw.tolist()]
        self.set_arm(indenter_pose=numbers)
        self._indenter = pose

    def set_arm(self, **values: Any) -> None:
        """Change parameters of the arm.

        Raises:
            OSError: the node refuses.
        """
        self._set(ARM, **values)

    def _set(self, executable: str, **values: Any) -> None:
        parameters = [Parameter(k, value=v).to_parameter_msg() for k, v in values.items()]
        answer = self.observer.call(
            SetParametersAtomically,
            f"{executable}/set_parameters_atomically",
            parameters=parameters,
        )
        if not answer.result.successful:
            raise OSError(f"{executable}: {answer.result.reason}")

    def rest(self) -> None:
        """Stop the arm, bring it to its start, and take the indenter away from the sensor."""
        self.disable()
        self.place_indenter(self.places.indenter(FAR_M))
        self._trigger(f"{ARM}/reset")
        self.wait_frames(SETTLE_FRAMES)

    def wait_frames(self, count: int) -> None:
        """Wait for frames of the sensor."""
        before = self.observer.count("wrench")
        self.time.wait(lambda: self.observer.count("wrench") >= before + count, f"{count} frames")

    def calibrate_idle(self) -> None:
        """Show the policy the sensor at rest."""
        self._retry(lambda: self.observer.call(Trigger, f"{POLICY}/calibrate_idle"))

    def touch(self, start_m: FloatArray) -> None:
        """Bring sensor and indenter together.

        Args:
            start_m: (3,) where the indenter shall be in the sensor's frame; the way there leads
                along the dome's normal.
        """
        tilt, depth = self.contact.tilt_and_depth(start_m)
        for point in np.linspace(LIFTED_DEPTH_M, float(depth), APPROACH_POINTS):
            self.place_indenter(self.places.indenter(self.contact.position_m(tilt, point)))
            self.wait_frames(SETTLE_FRAMES)

    def enable(self) -> None:
        """Let the policy lead.

        Raises:
            RefusedError: it refuses for a long time; with its reason.
            OSError: it does not answer.
        """
        self._retry(lambda: self.observer.call(SetBool, f"{POLICY}/set_enabled", data=True))

    def disable(self) -> None:
        """Stop the arm, where there is a policy."""
        if POLICY in self._processes or COMPOSED in self._processes:
            self.observer.call(SetBool, f"{POLICY}/set_enabled", data=False)

    def state(self) -> tuple[str, str]:
        """Return the policy's state and its reason, empty where nothing has been received."""
        values = self.observer.values(f"{POLICY}: control")
        return values.get("state", ""), values.get("reason", "")

    def stops(self) -> dict[str, int]:
        """Return how often the policy's node stopped the arm since it started, by reason."""
        text = self.observer.values(f"{POLICY}: control").get("stops", "none")
        if text == "none":
            return {}
        pairs = (entry.rsplit(" ", 1) for entry in text.split(", "))
        return {reason: int(count) for reason, count in pairs}

    def trial(
        self,
        start_m: FloatArray,
        seconds: float,
        *,
        bag: Path | None = None,
        is_done: Callable[[LoopRecording], bool] | None = None,
        faults: Sequence[TimedFault] = (),
    ) -> LoopRecording:
        """Return what the loop does from a place on, for a time or until it is latched; nothing
        where the policy refuses to lead, which the notes say.

        Args:
            start_m: (3,) of the indenter in the sensor's frame.
            seconds: how long the policy leads.
            bag: folder for a bag of it by `tactile_record`; None for none.
            is_done: asked about once a second whether what was done so far is enough.
            faults: what fails meanwhile, and stays so until `heal`.
        """
        self.rest()
        self.touch(start_m)
        if bag is not None:
            self._launch(RECORDER, {"output": bag})
            self._await(RECORDER, "recording /")
            self._expect()
            for topic in loop_parameters(RECORDER)["topics"]:
                self.time.wait_for_line(
                    self._processes[RECORDER],
                    f"receiving /{topic.split('=')[0]}",
                    START_TIMEOUT_S,
                )
        self.wait_diagnostics()
        before = self.stops()
        self.observer.forget()
        enabled_s = 1e-9 * self.now_ns()
        try:
            self.enable()
        except RefusedError as error:
            state, reason, detail = "refused", "refused", str(error)
        else:
            begun_ns, begun_s = self.now_ns(), time.monotonic()
            state, reason, detail = self._watch(seconds, is_done, faults)
            led_s = 1e-9 * (self.now_ns() - begun_ns)
            self.led_speed_factor = led_s / (time.monotonic() - begun_s)
        self.disable()
        self.wait_diagnostics()
        after = self.stops()
        if bag is not None:
            self._finish_bag()
        return self.recording(
            {
                "stops": dict(Counter(after) - Counter(before)),
                "state": state,
                "reason": reason,
                "detail": detail,
                "seconds": seconds,
                "enabled_s": enabled_s,
            }
        )

    def _watch(
        self,
        seconds: float,
        is_done: Callable[[LoopRecording], bool] | None,
        faults: Sequence[TimedFault],
    ) -> tuple[str, str, str]:
        """Return state, reason and details after a time, or when the loop is latched or done."""
        asked = 0

        def is_over() -> bool:
            nonlocal asked
            if self.state()[0] == "latched":
                return True
            count = self.observer.count("ee_pose")
            if is_done is None or count < asked + ASK_EVERY_POSES:
                return False
            asked = count
            return is_done(self.recording({}))

        passed_s, part = 0.0, f"{POLICY}: control"
        for each in sorted(faults, key=lambda fault: fault.at_s):
            self.time.watch(part, each.at_s - passed_s, is_over)
            self.inject(each.fault)
            passed_s = each.at_s
        self.time.watch(part, seconds - passed_s, is_over)
        state, reason = self.state()
        status = self.observer.diagnostics.get(f"{POLICY}: control")
        return state, reason, status.message if status is not None and state == "latched" else ""

    def _finish_bag(self) -> None:
        # What the last step sent is heard in the next.
        self.time.go(RECORDER_POLL_S)
        status = self._processes.pop(RECORDER).stop()
        self._expect()
        if status:
            raise OSError(f"{RECORDER} ended with status {status}")

    def recording(self, notes: Mapping[str, Any]) -> LoopRecording:
        """Return what has been received since the observer was last cleared."""
        heard = {name: [each.message for each in self.observer.heard(name)] for name in LOOP_TOPICS}
        return recording_of(
            heard,
            indenter=self._indenter,
            tool_from_sensor=self.places.tool_from_sensor,
            notes=notes,
        )

    def wait_diagnostics(self) -> None:
        """Wait for diagnostics that are newer than now."""
        self.time.resubscribe(f"{POLICY}: control")

    def _trigger(self, name: str) -> None:
        answer = self.observer.call(Trigger, name)
        if not answer.success:
            raise OSError(f"{name}: {answer.message}")

    def _retry(self, call: Callable[[], Any]) -> None:
        """Call a service until it does what it should; streams may need a moment to come."""
        end_s = time.monotonic() + ENABLE_TIMEOUT_S
        while not (answer := call()).success:
            if time.monotonic() > end_s:
                raise RefusedError(str(answer.message))
            self.time.go(0.1)


def policy_name(folder: Path | str) -> str:
    """Return the parameter that names a policy to its node: an absolute folder, or a name."""
    path = Path(folder)
    return str(path.absolute()) if path.is_dir() else str(folder)
