# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a configured `tactile_sim` holds: the simulated sensor, its topics and its services.

The real-time clock has one thread that presses, renders and publishes. Two, one for the gel and one
for the camera, were measured: on two cores, which the readers of the images need as well, they slow
each other down, and every image comes later. Within a frame the camera uses the second core where
it is free, see `optics.bands`.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import RLock
from typing import Any

from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

from dotsim_ros.effects.effect import Active, specification_with_effects
from dotsim_ros.effects.library import load_effects
from dotsim_ros.effects.overlay import active_effects, described, read_overlay
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.nodes.common.clock_watch import ClockJump
from dotsim_ros.nodes.common.health import Report, statuses_of
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.pace import FramePace
from dotsim_ros.nodes.simulated_time.latency import Latency
from dotsim_ros.nodes.tactile_sim.active_profile import ladder_of, make_active_profile
from dotsim_ros.nodes.tactile_sim.camera_calibration import CalibrationStore
from dotsim_ros.nodes.tactile_sim.external_wrench import ENTITY_WRENCH, ExternalWrenches
from dotsim_ros.nodes.tactile_sim.force_drive import ForceDrive
from dotsim_ros.nodes.tactile_sim.health import FrameCounter, gel_report, lag_text
from dotsim_ros.nodes.tactile_sim.motion import (
    NANOSECONDS_PER_SECOND,
    MotionOrder,
    MotionQueue,
)
from dotsim_ros.nodes.tactile_sim.motion_input import MotionInput
from dotsim_ros.nodes.tactile_sim.parameters import BY_FORCE, TF, TactileSimParameters
from dotsim_ros.nodes.tactile_sim.profiles import resolve_profile
from dotsim_ros.nodes.tactile_sim.publishers import FramePublishers, publish_static_frame
from dotsim_ros.nodes.tactile_sim.session import SensorMoment, SensorSession
from dotsim_ros.nodes.tactile_sim.transform_input import TRANSFORMS
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import NoiseSpecification, SensorSpecification, load_sensor
from msg_adapters import Level, Status, message_class

FRAMES_BROKEN = "the loop of frames failed"
FORCE_LOG_S = 5.0
DROPPED_SHARE = 0.01
"""Of the frames; where more are dropped, the machine is too slow for the rate."""


class ConfiguredSensor:
    """Simulates the sensor that parameters describe, and publishes its frames while it is active.

    Args:
        node: owns the publishers, subscriptions and services.
        settings: in force, with the names of frames as they are published.

    Attributes:
        settings: in force.

    Raises:
        ValueError, OSError: parameters, or files that they name, do not work.
    """

    def __init__(self, node: WorkingNode, settings: TactileSimParameters) -> None:
        self._node, self.settings = node, settings
        _check_messages(settings)
        self._lock = RLock()
        self._is_enabled, self._is_active = True, False
        self._end_frames: Callable[[], None] | None = None
        self._static_frame: Any = None
        time_of, self._is_realtime = settings.time, settings.time.is_realtime
        period_s = 1.0 / time_of.rate_hz
        specification = load_sensor(settings.sensor.sensor)
        effects = self._load_effects(specification.name)
        self._effect_names = described(effects)
        profile = resolve_profile(
            settings.sensor.profile,
            is_lockstep=not self._is_realtime,
            is_simulated_time=node.is_simulated,
        )
        specification = specification_with_effects(specification, effects)
        spacing_m = settings.sensor.grid_spacing_m
        ladder = ladder_of(profile, specification, grid_spacing_m=spacing_m)
        self._sensor = self._make_sensor(replace(specification, solver=ladder[0].solver))
        self._drive: ForceDrive | None = None
        if settings.motion.control == BY_FORCE:
            self._drive = ForceDrive(self._sensor, lambda pose: self._input.normal_force_n(pose))
        self._session = SensorSession(
            self._sensor,
            first_dt_s=period_s,
            limit_m=ladder[0].profile.move_m,
            effects=effects,
            drive=self._drive,
        )
        node.get_logger().info("warming up: the first start compiles the kernels")
        self._warm_up_s = self._session.warm_up()
        _give_back_memory()
        self._profile = make_active_profile(
            ladder,
            self._sensor,
            self._session,
            asked=settings.sensor.profile,
            period_s=period_s,
            report=node.get_logger().info,
        )
        self._latency = Latency(
            [0.5 * time_of.exposure_s + delay_s for delay_s in time_of.image_latency_s],
            seed=time_of.latency_seed,
        )
        self._counter = FrameCounter()
        self._motions = MotionQueue()
        self._frame_ns: int | None = None
        self._pace = FramePace(rate_hz=time_of.rate_hz, start_s=node.now_s())
        self._outputs = FramePublishers(node, self._sensor, settings, noise=specification.noise)
        self._calibration = CalibrationStore(
            node,
            settings.topics.camera_info_url,
            camera_name=node.label.replace("/", "_"),
            check=self._outputs.check_calibration,
            on_change=self._outputs.take_calibration,
        )
        self._input = MotionInput(
            node,
            settings,
            on_motion=self._motions.put if self._is_realtime else self._lockstep_frame,
        )
        self._external_wrenches = ExternalWrenches(
            node, settings, world_rotation=self._input.world_rotation
        )
        node.on_clock_jump(self._on_clock_jump)
        node.report_health(
            time_of.diagnostics_period_s, self._health, without_clock="frames cannot be stamped"
        )
        node.create_subscription(
            Bool, settings.topics.reference_topic, self._on_reset_reference, 10
        )
        node.create_service(Trigger, "~/reset", self._on_reset)
        node.create_service(Trigger, "~/calibrate_idle", self._on_calibrate_idle)
        node.create_service(SetBool, "~/set_enabled", self._on_set_enabled)

    def activate(self) -> None:
        """Start the frames."""
        if self.settings.frames.publish_tf and self._static_frame is None:
            self._static_frame = publish_static_frame(
                self._node,
                self._sensor.camera.pose,
                parent=self.settings.frames.base_frame,
                child=self.settings.frames.optical_frame,
            )
        with self._lock:
            self._is_active = True
            self._start_pace()
        if self._is_realtime:
            self._end_frames = self._node.start_paced(
                "frames", lambda: self._pace, self._realtime_frame, FRAMES_BROKEN
            )
        self._node.get_logger().info(
            f"ready: {self.settings.sensor.sensor}, {self.settings.sensor.indenter}, "
            f"{self.settings.time.clock}, profile {self._profile.name}, "
            f"warmed up in {self._warm_up_s:.1f} s"
        )

    def deactivate(self) -> None:
        """Stop the frames; the next ones begin at rest."""
        if self._end_frames is not None:
            self._end_frames()
            self._end_frames = None
        with self._lock:
            self._is_active = False
            self._forget_motion()
            self._session.restart()

    def _load_effects(self, sensor_name: str) -> tuple[Active, ...]:
        place, folder = self.settings.sensor.effects, self.settings.sensor.effects_folder
        if not place:
            return ()
        overlay = read_overlay(place)
        library = load_effects(
            (folder,) if folder else (),
            names=[found.name for found in overlay.effects],
            announce=self._node.get_logger().warning,
        )
        effects = active_effects(overlay, library, place=place)
        if overlay.sensor != sensor_name:
            self._node.get_logger().warning(
                f"{place} was found on the sensor {overlay.sensor!r}, this one is {sensor_name!r}: "
                "search its own data"
            )
        self._node.get_logger().info(f"effects: {', '.join(described(effects)) or 'none'}")
        return effects

    def _make_sensor(self, specification: SensorSpecification) -> TactileSensor:
        known = self.settings.sensor
        if known.idle_image:
            idle_image = str(Path(known.idle_image).absolute())
            camera = replace(specification.camera, idle_image=idle_image)
            specification = replace(specification, camera=camera)
        sensor = TactileSensor(
            # Noise is drawn by the stamp as an image is published, after the effects: an image that
            # stands still has new noise, too.
            replace(specification, noise=NoiseSpecification()),
            indenter=load_indenter(known.indenter),
            device=known.device,
            progress=self._log_progress,
        )
        if sensor.device != "cpu":
            self._node.get_logger().warning(
                f"device {sensor.device} is experimental: no node has been shown to run there; "
                "`python -m studies device_check` compares it with the CPU"
            )
        return sensor

    def _log_progress(self, share: float) -> None:
        self._node.get_logger().info(
            f"computing the gel's tables, once for each sensor: {100.0 * share:.0f} %",
            throttle_duration_sec=2.0,
        )

    def _makes_frames(self) -> bool:
        return self._is_active and self._is_enabled

    def _start_pace(self) -> None:
        self._pace = self._pace.resumed(
            rate_hz=self.settings.time.rate_hz, start_s=self._node.now_s()
        )

    def _realtime_frame(self) -> None:
        stamp_ns = self._node.time_ns()
        if stamp_ns == 0:
            return
        begun_s = time.monotonic()
        with self._lock:
            if not self._makes_frames():
                return
            passed_s = self._passed_s(stamp_ns)
            self._input.integrate(stamp_ns, passed_s)
            self._node.compute(
                self._latency,
                partial(self._simulated, self._motions.take(), passed_s),
                partial(self._publish, stamp_ns),
                FRAMES_BROKEN,
            )
            self._profile.end_frame(begun_s, period_s=1.0 / self.settings.time.rate_hz)

    def _passed_s(self, stamp_ns: int) -> float:
        """Return the time since the frame before, which may be some periods: frames are dropped."""
        last_ns, self._frame_ns = self._frame_ns, stamp_ns
        if last_ns is None or stamp_ns <= last_ns:
            return 1.0 / self.settings.time.rate_hz
        passed_s = (stamp_ns - last_ns) / NANOSECONDS_PER_SECOND
        # As long as a velocity holds: after a clock's leap nothing moves through what it left out.
        return min(passed_s, self.settings.motion.input_timeout_s)

    def _simulated(self, motions: Sequence[MotionOrder], passed_s: float) -> SensorMoment:
        """Return the next moment: of the motions since the last one, or of the gel that goes on."""
        with self._lock:
            for motion in motions:
                self._input.guard(partial(self._session.order, motion))
            self._input.guard(lambda: self._session.advance(passed_s))
            return self._rendered(self._session.moment)

    def _lockstep_frame(self, motion: MotionOrder) -> None:
        with self._lock:
            if not self._makes_frames():
                return
            try:
                self._session.follow(motion)
            finally:
                # Refused, too: who sent the pose waits for an answer, which is the last frame.
                self._publish(motion.stamp_ns, self._rendered(self._session.moment))

    def _rendered(self, moment: SensorMoment) -> SensorMoment:
        if self._outputs.shows_image():
            moment.render()
        return moment

    def _publish(self, stamp_ns: int, moment: SensorMoment) -> None:
        with self._lock:
            if not self._makes_frames():
                return
            begun_s = time.perf_counter()
            self._outputs.publish(moment, stamp_ns)
            self._external_wrenches.publish(moment.gel.wrench, moment.pose, stamp_ns)
            self._counter.note(
                self._node.now_s(),
                {**moment.timings_s, "publish": time.perf_counter() - begun_s},
                converged=moment.gel.converged,
            )

    def _health(self) -> list[Status]:
        # Not under the lock: poses would wait here until a frame ends, and the next frame would
        # begin with an old one.
        now_s = self._node.now_s()
        reports = {
            "frames": self._frames_report(now_s),
            "input": self._input.report(),
            "gel": gel_report(self._session.moment.gel, self._effect_names, self._counter, now_s),
        }
        if self._drive is not None:
            reports["force"] = level, message, _ = self._drive.report()
            if level is Level.WARN:
                self._node.get_logger().warning(
                    f"force: {message}", throttle_duration_sec=FORCE_LOG_S
                )
        namespace = self._node.get_namespace().strip("/")
        hardware_id = f"{namespace}/{self.settings.sensor.sensor}".strip("/")
        return statuses_of(self._node.label, hardware_id, reports)

    def _frames_report(self, now_s: float) -> Report:
        rate = self._counter.rate
        lag_m = self._session.take_largest_lag_m()
        values = {
            "frames": str(rate.count),
            "rate_hz": f"{rate.rate_hz(now_s):.2f}",
            "dropped": str(self._pace.dropped),
            "late": str(self._pace.late + self._session.behind),
            "lag_m": f"{lag_m:.6f}",
            **self._profile.values(),
            **{f"{part}_p95_ms": f"{ms:.2f}" for part, ms in self._counter.p95_ms().items()},
        }
        lag = ""
        if lag_m > self.settings.motion.maximum_lag_m:
            lag = lag_text(lag_m, self.settings.motion.maximum_lag_m)
            self._node.get_logger().warning(lag, once=True)
        is_too_slow = self._is_realtime and self._pace.dropped_share > DROPPED_SHARE
        warnings = (
            "" if self._is_active else "inactive: activate the node to continue",
            "" if self._is_enabled else "disabled: call set_enabled to continue",
            self._node.clock_silence(),
            self._outputs.rivals(),
            "frames are dropped: the machine is too slow for this rate" if is_too_slow else "",
            lag,
        )
        for warning in filter(None, warnings):
            return Level.WARN, warning, values
        return Level.OK, "running", values

    def _forget_motion(self) -> None:
        self._motions.take()
        self._frame_ns = None
        self._input.forget()

    def _on_clock_jump(self, jump: ClockJump) -> None:
        with self._lock:
            self._frame_ns = None
            if jump.is_restart:
                self._motions.take()
                self._session.restart()
                self._input.restart(before_ns=jump.before_ns)
            else:
                self._input.leap()

    def _on_reset(self, _request: Any, response: Any) -> Any:
        with self._lock:
            self._forget_motion()
            self._session.reset()
        return _answered(response, "the gel is at rest")

    def _on_calibrate_idle(self, _request: Any, response: Any) -> Any:
        with self._lock:
            if not self._is_active:
                why = "the node is inactive, and publishes nothing: activate it"
                return _answered(response, why, success=False)
            if self._session.is_touched():
                why = "the indenter touches the gel: lift it, then calibrate"
                return _answered(response, why, success=False)
            self._outputs.publish_idle(self._session.relax().render(), self._node.time_ns())
        place = f"{self._node.get_fully_qualified_name()}/idle_image"
        return _answered(response, f"the image at rest is on {place}")

    def _on_reset_reference(self, message: Any) -> None:
        if message.data:
            with self._lock:
                self._outputs.take_reference(self._session.moment.render().image)

    def _on_set_enabled(self, request: Any, response: Any) -> Any:
        with self._lock:
            self._is_enabled = request.data
            self._forget_motion()
            self._session.restart()
        return _answered(response, "enabled" if request.data else "disabled: no frames")

    def change(self, changed: TactileSimParameters) -> None:
        """Take changed parameters, all or none.

        Raises:
            ValueError, OSError: one does not work; those before stay.
        """
        indenter = None
        if changed.sensor.indenter != self.settings.sensor.indenter:
            indenter = load_indenter(changed.sensor.indenter)
        # All that may be refused comes before anything is changed, and what takes long (ten seconds
        # for the largest mesh) before the frames have to wait for it.
        self._outputs.framing_of(changed)
        if indenter is not None and indenter.mesh is not None:
            indenter.distance_grid()
        with self._lock:
            self._outputs.configure(changed)
            if indenter is not None:
                self._session.change_indenter(indenter)
                self._input.forget()
            self._input.configure(changed)
            has_new_rate = changed.time.rate_hz != self.settings.time.rate_hz
            self.settings = changed
            if has_new_rate:
                self._start_pace()
                self._session.first_dt_s = 1.0 / changed.time.rate_hz


def _give_back_memory() -> None:
    """Give what is free back to the system: to compute the gel's tables takes some times their
    size, and glibc keeps that for the process, as long as a node runs."""
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)


def _answered(response: Any, message: str, *, success: bool = True) -> Any:
    response.success, response.message = success, message
    return response


def _check_messages(settings: TactileSimParameters) -> None:
    """Raise ValueError where messages are not installed, before the sensor is made, which takes
    long."""
    needed = {}
    if settings.motion.pose_source == TF:
        needed[TRANSFORMS] = (
            "pose_source is tf",
            "ros-jazzy-tf2-msgs, not with the wheels of PyPI: there set pose_source to topic or "
            "odometry",
        )
    if settings.links.entity_indenter or settings.links.entity_sensor:
        needed[ENTITY_WRENCH] = (
            "entity_indenter or entity_sensor is set",
            "ros-jazzy-ros-gz-interfaces: without it read external_wrench/indenter and "
            "external_wrench/sensor",
        )
    for name, (why, where) in needed.items():
        try:
            message_class(name)
        except (ImportError, ValueError) as error:
            raise ValueError(f"{why}, but {error}; it comes with apt's {where}") from None
