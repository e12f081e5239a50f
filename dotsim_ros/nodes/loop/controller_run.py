# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A controller of the user's under test: the stand-ins of sensor and arm, in simulated time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped

import msg_adapters
from dotsim_ros.control.loop.judge import trial_start
from dotsim_ros.control.loop.recording import LoopRecording
from dotsim_ros.control.policy.demonstration import contact_of
from dotsim_ros.control.policy.paths import ReferencePath, reference_path
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.io.arrays import BoolArray, FloatArray
from dotsim_ros.nodes.common.processes import NodeProcess
from dotsim_ros.nodes.common.transport import stay_local
from dotsim_ros.nodes.loop.closed_loop import (
    ARM,
    SENSOR,
    ClosedLoop,
    LoopSetup,
    TimedFault,
    loop_parameters,
)
from dotsim_ros.nodes.loop.loop_time import SIMULATED
from dotsim_ros.nodes.loop.observer import LOOP_TOPICS
from dotsim_ros.nodes.simulated_time.participants import Participant, Publication
from dotsim_ros.nodes.simulated_time.protocol import NANOSECONDS_PER_SECOND
from dotsim_ros.nodes.simulated_time.stepper import StepperSettings
from dotsim_ros.specification import load_sensor

PLACES = "indenter/pose"
STANDING_M_S = 1e-4
"""Slower than this, the tool stands."""


@dataclass(frozen=True)
class Controller:
    """A node under test.

    Attributes:
        command: program and arguments that start it; ROS arguments are added.
        reads: topics that it reads.
        publishes: when it publishes on which topic: what simulated time waits for.
        parameters: of the node, next to use_sim_time.
    """

    name: str
    command: Sequence[str]
    reads: tuple[str, ...] = ("image_raw", "ee_pose")
    publishes: Mapping[str, Publication] = field(
        default_factory=lambda: {"cmd_vel": Publication(for_each="image_raw")}
    )
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class ControllerRun:
    """What a controller did.

    Attributes:
        begun_s: the stamp at which it began.
        time_s, place_m: (N,) and (N, 3) where the indenter was in the sensor's frame, whatever
            the arm told its controller.
    """

    recording: LoopRecording
    path: ReferencePath
    begun_s: float
    time_s: FloatArray
    place_m: FloatArray

    @property
    def path_error_m(self) -> float:
        """Return the mean distance of the indenter from the path."""
        return float(self.path.nearest(self.place_m)[0].mean())

    @property
    def laps(self) -> float:
        """Return how many laps of the path were made."""
        return self.path.laps(self.place_m)

    @property
    def largest_force_n(self) -> float:
        """Return the largest force on the indenter."""
        return float(np.linalg.norm(self.recording.force_n, axis=1).max(initial=0.0))

    @property
    def stops_s(self) -> tuple[float, ...]:
        """Return when the tool came to stand after it had moved, seconds since the run began."""
        moves = self._moves()
        stops = self.time_s[1:-1][moves[:-1] & ~moves[1:]]
        return tuple(float(time_s - self.begun_s) for time_s in stops)

    @property
    def stands_from_s(self) -> float:
        """Return since when the tool has stood at the end, seconds since the run began; infinite
        where it still moves."""
        moves = self._moves()
        if moves[-1]:
            return np.inf
        last = np.flatnonzero(moves)
        return float(self.time_s[last[-1] + 1 if len(last) else 0] - self.begun_s)

    def _moves(self) -> BoolArray:
        """Return (N - 1,) whether the tool moves from one pose to the next."""
        way_m = np.linalg.norm(np.diff(self.place_m, axis=0), axis=1)
        return np.asarray(way_m > STANDING_M_S * np.diff(self.time_s))


class ControllerLoop:
    """The stand-ins, and the controller again for each run; a context manager.

    Args:
        path: that it is to follow: line, arc, figure_eight or press.
        sensor: name or file of the simulated sensor, a dome; the paths are those on it.
        sensor_parameters, arm_parameters: of tactile_sim and xarm_sim.

    Raises:
        ValueError: the sensor is no dome, or its indenter no ball.
    """

    def __init__(
        self,
        controller: Controller,
        *,
        path: str = "line",
        sensor: str = "densetact2",
        sensor_parameters: Mapping[str, Any] | None = None,
        arm_parameters: Mapping[str, Any] | None = None,
        stepping: StepperSettings | None = None,
    ) -> None:
        stay_local()
        self._controller = controller
        indenter = (loop_parameters(SENSOR) | dict(sensor_parameters or {}))["indenter"]
        self._contact = contact_of(load_sensor(sensor), load_indenter(indenter))
        self._path = reference_path(path, self._contact)
        self._alone = LoopSetup(
            policy="",
            sensor=sensor,
            sensor_parameters=sensor_parameters or {},
            arm_parameters=arm_parameters or {},
            stepping=stepping or StepperSettings(),
        )
        self._loop = ClosedLoop(
            self._alone,
            contact=self._contact,
            topics={**LOOP_TOPICS, PLACES: PoseStamped},
            clock=SIMULATED,
        )

    def __enter__(self) -> ControllerLoop:
        self._loop.start_nodes(ARM, SENSOR)
        return self

    def __exit__(self, *_exception: object) -> None:
        self._loop.close()

    def run(
        self, seconds: float, *, faults: Sequence[TimedFault] = (), seed: int = 0
    ) -> ControllerRun:
        """Start the controller on its path, and return what it does.

        Args:
            seconds: of simulated time.
            seed: of where on the path, and how far next to it, it begins.

        Raises:
            OSError: it does not take part in simulated time; says why.
        """
        loop, controller = self._loop, self._controller
        loop.heal()
        loop.rest()
        loop.touch(trial_start(self._path, self._contact, seed=seed, number=0))
        process = NodeProcess(
            controller.name,
            {**controller.parameters, "use_sim_time": True},
            arguments=("-r", f"__node:={controller.name}"),
            command=controller.command,
        )
        try:
            loop.join({controller.name: Participant(controller.reads, controller.publishes)})
            loop.observer.forget()
            begun_s = loop.now_ns() / NANOSECONDS_PER_SECOND
            passed_s = 0.0
            for each in sorted(faults, key=lambda fault: fault.at_s):
                loop.time.go(each.at_s - passed_s)
                loop.inject(each.fault)
                passed_s = each.at_s
            loop.time.go(seconds - passed_s)
            recording = loop.recording({})
            places = [each.message for each in loop.observer.heard(PLACES)]
        finally:
            process.stop()
            loop.join({})
        stamps_ns = [msg_adapters.message_stamp_ns(message) for message in places]
        return ControllerRun(
            recording,
            self._path,
            begun_s,
            np.array(stamps_ns) / NANOSECONDS_PER_SECOND,
            np.array([msg_adapters.decode_pose_stamped(message)[0] for message in places]),
        )
