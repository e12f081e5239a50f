# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A sensor of this process under the page's indenter: one thread solves, another one sees.

The gel's thread takes the poses since its last frame, as soon as the time of a frame has passed,
and shows the skin at once; the camera's thread renders what it finds to be newest then. So a page
never waits for either, and nothing piles up. Where the gel comes later than the sensor's rate
asks for, the camera rests after each image as long as that took, and leaves the gel its core. Needs
no ROS.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dotsim_ros.geometry.indenter import Indenter, load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import Float32Array
from dotsim_ros.live.desk import LiveDesk
from dotsim_ros.live.moments import Picture, Scene, SkinMoment
from dotsim_ros.nodes.common.counters import RateMeter
from dotsim_ros.nodes.common.ingest import Fault, RefusedInputError
from dotsim_ros.nodes.tactile_sim.active_profile import Rung, ladder_of
from dotsim_ros.nodes.tactile_sim.motion import HELD_MOTIONS, MotionOrder
from dotsim_ros.nodes.tactile_sim.profiles import PROFILES, REALTIME
from dotsim_ros.nodes.tactile_sim.session import SensorMoment, SensorSession
from dotsim_ros.optics.depth import DepthConversion
from dotsim_ros.sensor import FRAME_S, TactileSensor
from dotsim_ros.specification import SensorSpecification

START_HEIGHT_M = 2e-3
"""Of the indenter above the apex."""
RATE_WINDOW_S = 2.0
STOP_S = 5.0

Ordered = tuple[Pose | None, int]
"""A pose, or None for away, and the number of its order."""


@dataclass(frozen=True)
class _Seen:
    """What the camera's thread is to show, and how: of the depth, what it is at rest."""

    moment: SensorMoment
    stamp_ns: int
    conversion: DepthConversion
    rest_depth_m: Float32Array


class SimulatedSubject:
    """A sensor that the pages press; see `desk.Subject`.

    Args:
        desk: shows what comes of it.
        sensors: to choose from, by name.
        own: indenters that are none of the shipped, or that press first, by name; the first one
            presses first.
        sensor: the first one.
        indenters: names to choose from: own and shipped ones.
        profile: the first one.
        frame_s: time of a frame at the sensor's rate.
    """

    def __init__(
        self,
        desk: LiveDesk,
        sensors: Mapping[str, SensorSpecification],
        own: Mapping[str, Indenter],
        *,
        sensor: str,
        indenters: Sequence[str],
        profile: str = REALTIME.name,
        frame_s: float = FRAME_S,
    ) -> None:
        self.title = ""
        self.sensors, self.indenters = sensors, indenters
        self._desk, self._frame_s = desk, frame_s
        self._own, self._profile = own, profile
        self._indenter = next(iter(own.values()))
        self._name = sensor
        self.profiles = _profiles_of(sensors[sensor], profile)
        self._wake = threading.Condition()
        self._is_stopping = False
        self._ordered: deque[Ordered] = deque(maxlen=HELD_MOTIONS)
        self._jobs: deque[Callable[[], None]] = deque()
        self._seen: _Seen | None = None
        self._number = 0
        self._spent_s: float | None = None
        self._rate = RateMeter(RATE_WINDOW_S)
        self._is_new_start, self._is_behind = True, False
        self._is_late = False
        self._threads = [
            threading.Thread(target=self._run, args=(work,), name=name, daemon=True)
            for name, work in (("gel", self._solve), ("camera", self._see))
        ]

    def start(self) -> None:
        """Make the sensor, on its own thread, and press from then on."""
        self._desk.tell_state(
            busy=f"making the gel of {self._name}; a first start may take minutes"
        )
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """End when the present frame is done; a gel that is being made is not awaited."""
        with self._wake:
            self._is_stopping = True
            self._wake.notify_all()
        for thread in self._threads:
            thread.join(STOP_S)

    def move(self, pose: Pose | None, number: int) -> None:
        with self._wake:
            if pose is None:
                self._ordered.clear()
            self._ordered.append((pose, number))
            self._wake.notify_all()

    def choose(self, what: str, name: str) -> None:
        change = {
            "sensor": self._change_sensor,
            "indenter": self._change_indenter,
            "profile": self._change_profile,
        }[what]
        self._do(lambda: change(name))

    def reset(self) -> None:
        self._do(lambda: self.move(None, self._number))

    def _do(self, job: Callable[[], None]) -> None:
        with self._wake:
            self._jobs.append(job)
            self._wake.notify_all()

    def _run(self, work: Callable[[], None]) -> None:
        """Say so where a thread fails, for a page that stands still explains nothing."""
        try:
            work()
        except Exception as error:
            self._desk.tell_state(can_press=False, busy="the sensor failed: start again")
            self._desk.tell(f"the sensor failed ({type(error).__name__}): {error}")
            with self._wake:
                self._is_stopping = True
                self._wake.notify_all()
            raise

    # The gel's thread.

    def _solve(self) -> None:
        self._make(self._name)
        due_s = time.monotonic()
        while True:
            job, ordered = self._awaited(due_s)
            if job is not None:
                job()
                self._desk.tell_state(busy="")
            elif self._is_stopping:
                return
            else:
                begun_s = time.monotonic()
                self._frame(ordered)
                self._is_late = time.monotonic() - begun_s > self._frame_s
                due_s = begun_s + self._frame_s

    def _make(self, name: str) -> None:
        """Make a sensor and show it; the one before stays in use until it is ready.

        Raises:
            ValueError: the indenter does not suit the sensor.
        """
        rung = self._rung(name, self._profile)
        specification = replace(self.sensors[name], solver=rung.solver)
        sensor = TactileSensor(specification, indenter=self._indenter)
        session = SensorSession(sensor, first_dt_s=self._frame_s, limit_m=rung.profile.move_m)
        session.warm_up()
        self._conversion = DepthConversion(sensor.camera)
        self._rest_depth_m = self._conversion.axial_m(session.moment.render().depth_m)
        self._sensor, self._session, self._name = sensor, session, name
        self.profiles = _profiles_of(self.sensors[name], self._profile)
        self._is_new_start, self._is_behind = True, False
        self._show_scene()
        with self._wake:
            # Poses that the sensor before was to show.
            self._ordered.clear()
        # Before a page may press: its first order must not be overwritten.
        self._move_to_start(0)
        self._desk.tell_state(
            busy="",
            can_press=True,
            sensor=name,
            profiles=dict(self.profiles),
            indenter=self._indenter.name,
            profile=self._profile,
        )

    def _move_to_start(self, number: int) -> None:
        self.move(Pose(self._sensor.skin.apex_m + np.array([0.0, 0.0, START_HEIGHT_M])), number)

    def _show_scene(self) -> None:
        skin = self._sensor.skin
        self._desk.show_scene(Scene(skin.rest_position_m, skin.triangles, self._indenter))

    def _awaited(self, due_s: float) -> tuple[Callable[[], None] | None, list[Ordered]]:
        """Wait for a job, or until a frame is due and there is something to show."""
        with self._wake:
            while not self._is_stopping:
                if self._jobs:
                    return self._jobs.popleft(), []
                left_s = due_s - time.monotonic()
                if left_s > 0.0:
                    self._wake.wait(left_s)
                    continue
                if self._ordered or self._goes_on():
                    ordered = list(self._ordered)
                    self._ordered.clear()
                    return None, ordered
                self._wake.wait()
        return None, []

    def _goes_on(self) -> bool:
        """Return whether the next frame differs from this one though nothing was ordered."""
        return self._is_behind or self._sensor.remembers

    def _frame(self, ordered: Sequence[Ordered]) -> None:
        begun_s = time.monotonic()
        try:
            moment = self._moment(ordered)
        except RefusedInputError as error:
            self._is_behind = False
            self._desk.tell(error)
            return
        self._rate.note(begun_s)
        gel = moment.gel
        shown = SkinMoment(
            time.time_ns(),
            gel.skin_position_m,
            gel.wrench.force_n,
            gel.wrench.torque_nm,
            moment.pose,
            number=self._number,
            spent_s=self._spent_s,
            rate_hz=self._rate.rate_hz(begun_s) or None,
            is_converged=gel.converged,
            is_behind=self._is_behind,
        )
        self._desk.show_skin(shown)
        with self._wake:
            self._seen = _Seen(moment, shown.stamp_ns, self._conversion, self._rest_depth_m)
            self._wake.notify_all()

    def _moment(self, ordered: Sequence[Ordered]) -> SensorMoment:
        """Return the moment of the next frame.

        Raises:
            RefusedInputError: the gel refuses a pose, or could not be solved.
        """
        before = self._session.behind
        for pose, self._number in ordered:
            if pose is None:
                self._session.reset()
                self._is_new_start = True
                continue
            try:
                # Refused here, the gel keeps what presses it now.
                self._sensor.check_depth(pose)
            except ValueError as error:
                raise RefusedInputError(Fault.GEL, str(error)) from error
            start = Fault.RESTART if self._is_new_start else None
            self._session.order(MotionOrder(pose, time.monotonic_ns(), start))
            self._is_new_start = False
        moment = self._session.advance()
        self._is_behind = self._session.behind > before
        return moment

    def _rung(self, sensor: str, profile: str) -> Rung:
        return ladder_of(profile, self.sensors[sensor])[0]

    def _change_sensor(self, name: str) -> None:
        if name == self._name:
            return
        self._desk.tell_state(
            can_press=False, busy=f"making the gel of {name}; its first start may take minutes"
        )
        try:
            self._make(name)
        except ValueError as error:
            self._desk.tell(error)
            self._desk.tell_state(can_press=True)

    def _change_indenter(self, name: str) -> None:
        self._desk.tell_state(busy=f"preparing {name}")
        try:
            indenter = self._own.get(name) or replace(load_indenter(name), name=name)
            self._session.change_indenter(indenter)
        except (ValueError, OSError) as error:
            self._desk.tell(error)
            return
        self._indenter = indenter
        self._show_scene()
        self._desk.tell_state(indenter=name)
        self._is_new_start = True
        self._move_to_start(self._number)

    def _change_profile(self, name: str) -> None:
        if name == self._profile:
            return
        rung = self._rung(self._name, name)
        self._desk.tell_state(busy=f"preparing the gel of {name}")
        try:
            self._session.change_solver(
                rung.solver, limit_m=rung.profile.move_m, largest_jump_m=np.inf
            )
        except ValueError as error:
            self._desk.tell(error)
            return
        self._profile = name
        self._desk.tell_state(profile=name)

    # The camera's thread.

    def _see(self) -> None:
        while True:
            with self._wake:
                while self._seen is None and not self._is_stopping:
                    self._wake.wait()
                if self._is_stopping:
                    return
                seen, self._seen = self._seen, None
            assert seen is not None
            begun_s = time.monotonic()
            frame = seen.moment.render()
            self._spent_s = sum(frame.timings_s.values())
            depth_m = seen.conversion.axial_m(frame.depth_m)
            self._desk.show_picture(Picture(seen.stamp_ns, frame.image, depth_m, seen.rest_depth_m))
            if self._is_late:
                spent_s = time.monotonic() - begun_s
                with self._wake:
                    self._wake.wait_for(lambda: self._is_stopping, spent_s)


def _profiles_of(specification: SensorSpecification, chosen: str) -> dict[str, str]:
    """Return the profiles that a sensor can be pressed in, and what each of them is."""
    # What a gel remembers no other solver could go on with.
    names = [chosen] if specification.remembers else list(PROFILES)
    return {name: PROFILES[name].summary for name in names}
