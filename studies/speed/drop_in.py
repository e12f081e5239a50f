# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Whether programs written for drivers of real DenseTact sensors run on the simulated one.

For each interface below params/drivers the sensors are started by the command that the file names,
and a reader that is written as users of that driver write theirs subscribes to its topics, by their
names, with their QoS, and without anything of this package: it decodes every message and ends with
an error where it finds what it could not use. Meanwhile an indenter is pressed into the gel, once
in two seconds. A rate is of messages that arrived, from the first to the last one.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Bool

from dotsim_ros.geometry.pose import Pose
from studies.run import FAILED, expect_known, expect_positive
from studies.speed.running_node import PosePublisher, running_sensors

PATIENCE_S = 60.0
POSE_HZ = 50.0
PERIOD_S = 2.0
"""Of the presses: away, down, held, up, a quarter each."""
DEPTH_M = 0.001
SETTLED_S = 0.25
"""After the indenter has come to rest the images of that are there."""
APEX_M = 0.01575
SENSOR_QOS = QoSProfile(
    depth=10, reliability=ReliabilityPolicy.BEST_EFFORT, history=HistoryPolicy.KEEP_LAST
)
"""That of the readers of compressed images."""


class Reader(Node):
    """A user's program: decodes what comes and keeps when it came.

    Attributes:
        arrived_s: by topic.
        seen: what the newest message was like, by topic.
        held_m: returns the depth at which the indenter was held at a time; NaN where it moved.
    """

    def __init__(self) -> None:
        super().__init__("reader")
        self.arrived_s: dict[str, list[float]] = {}
        self.seen: dict[str, dict[str, Any]] = {}
        self.held_m: Callable[[float], float] = lambda time_s: math.nan

    def begin_episode(self) -> None:
        """Do what is done once, in the middle of the run, while the indenter is held in the gel."""

    def read(
        self, kind: type, topic: str, take: Callable[[Any], dict[str, Any]], quality: Any
    ) -> None:
        """Subscribe to a topic; `take` uses a message and says what it was like."""
        self.arrived_s[topic] = []

        def hear(message: Any) -> None:
            self.seen[topic] = take(message)
            self.arrived_s[topic].append(time.monotonic())

        self.create_subscription(kind, topic, hear, quality)

    def check(self) -> None:
        """Raise a ValueError where what was seen over the run makes no sense."""


def time_s(stamp: Any) -> float:
    """Return a stamp in seconds."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def pixels_of(message: Image, encoding: str) -> np.ndarray[Any, Any]:
    """Return the pixels as cv_bridge's imgmsg_to_cv2 does, of an encoding that is expected."""
    if message.encoding != encoding:
        raise ValueError(f"encoding {message.encoding!r}, expected {encoding!r}")
    channels = 1 if encoding == "8UC1" else 3
    shape = (message.height, message.width, channels)
    pixels = np.ndarray(shape, np.uint8, bytes(message.data), strides=(message.step, channels, 1))
    return pixels[..., 0] if channels == 1 else pixels


def described(message: Any, pixels: np.ndarray[Any, Any], form: str) -> dict[str, Any]:
    """Return what an image was like."""
    return {
        "form": form,
        "width": pixels.shape[1],
        "height": pixels.shape[0],
        "frame_id": message.header.frame_id,
    }


class RunCameraReader(Reader):
    """As the touch node and the recorder of the ROS 1 driver: bgr8, depth in 8 bits, force."""

    lowest_mm, highest_mm = 12.23, 16.88

    def __init__(self) -> None:
        super().__init__()
        self._undeformed: np.ndarray[Any, Any] | None = None
        self.largest_dent_mm = 0.0
        self.largest_force_n = 0.0
        self.read(Image, "/RunCamera/image_raw_1", self._on_image, 1)
        self.read(CameraInfo, "/RunCamera/camera_info", self._on_info, 1)
        self.read(WrenchStamped, "/RunCamera/force", self._on_force, 1)
        self.read(Image, "/RunCamera/imgDepth", self._on_depth, 1)
        self.read(Image, "/RunCamera/imgDepth_show", self._on_shown, 1)

    def _on_image(self, message: Image) -> dict[str, Any]:
        return described(message, pixels_of(message, "bgr8"), "bgr8")

    def _on_shown(self, message: Image) -> dict[str, Any]:
        return described(message, pixels_of(message, "rgb8"), "rgb8")

    def _on_info(self, message: CameraInfo) -> dict[str, Any]:
        matrix = np.array(message.k).reshape(3, 3)
        if matrix[0, 0] <= 0.0 or len(message.d) < 4:
            raise ValueError("camera_info is not calibrated")
        return {"form": message.distortion_model, "width": message.width, "height": message.height}

    def _on_force(self, message: WrenchStamped) -> dict[str, Any]:
        self.largest_force_n = max(self.largest_force_n, message.wrench.force.z)
        return {"form": "wrench", "frame_id": message.header.frame_id}

    def _on_depth(self, message: Image) -> dict[str, Any]:
        depth = pixels_of(message, "8UC1").astype(float)
        radius_mm = depth / 256.0 * (self.highest_mm - self.lowest_mm) + self.lowest_mm
        if self._undeformed is None:
            self._undeformed = radius_mm
        dent_mm = float((self._undeformed - radius_mm)[310:330, 310:330].mean())
        self.largest_dent_mm = max(self.largest_dent_mm, dent_mm)
        return described(message, depth, "8UC1")

    def check(self) -> None:
        if not 0.5 < self.largest_dent_mm < 1.5:
            raise ValueError(f"a press of 1 mm is {self.largest_dent_mm:.2f} mm in imgDepth")
        if self.largest_force_n < 0.3:
            raise ValueError(f"a press of 1 mm gives {self.largest_force_n:.2f} N")


class CompressedReader(Reader):
    """As the policies and collectors of the ROS 2 driver: JPEG of both fingers, channels first."""

    def __init__(self) -> None:
        super().__init__()
        for number in (20, 22):
            topic = f"RunCamera/image_raw_{number}/compressed"
            self.read(CompressedImage, topic, self.on_image, SENSOR_QOS)

    def on_image(self, message: CompressedImage) -> dict[str, Any]:
        """Unpack an image as cv_bridge's compressed_imgmsg_to_cv2 does."""
        bgr = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_UNCHANGED)
        if bgr is None or bgr.shape != (180, 320, 3):
            raise ValueError(f"no colour image of 320 x 180: {None if bgr is None else bgr.shape}")
        first = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB).transpose(2, 0, 1)
        if "jpeg" not in message.format or first.shape != (3, 180, 320):
            raise ValueError(f"format {message.format!r}, expected jpeg")
        self.newest = first
        return described(message, bgr, "jpeg")


class DifferenceReader(CompressedReader):
    """As the collector with differences: a new reference at the start of an episode."""

    def __init__(self) -> None:
        super().__init__()
        self._reset = self.create_publisher(Bool, "reset_dt", 10)
        self._begun_s = math.inf
        self._brightness: dict[tuple[bool, bool], list[float]] = {}
        for number in (20, 22):
            topic = f"RunCamera/image_diff_{number}/compressed"
            self.read(CompressedImage, topic, self._on_difference, SENSOR_QOS)

    def begin_episode(self) -> None:
        self._begun_s = time_s(self.get_clock().now().to_msg())
        self._reset.publish(Bool(data=True))

    def _on_difference(self, message: CompressedImage) -> dict[str, Any]:
        seen = self.on_image(message)
        stamp_s = time_s(message.header.stamp)
        held_m = self.held_m(stamp_s)
        # The reference is another one a little later than it was asked for.
        if not (math.isnan(held_m) or 0.0 < stamp_s - self._begun_s < SETTLED_S):
            key = stamp_s > self._begun_s, held_m > 0.0
            self._brightness.setdefault(key, []).append(float(self.newest.mean()))
        return seen

    def check(self) -> None:
        mean = {key: float(np.median(values)) for key, values in self._brightness.items()}
        if len(mean) < 4:
            raise ValueError(f"only {len(mean)} of 4 states were seen in the differences")
        away, pressed = mean[False, False], mean[False, True]
        away_later, pressed_later = mean[True, False], mean[True, True]
        if not (pressed > 2.0 * away and away_later > 2.0 * pressed_later):
            raise ValueError(
                f"mean differences: untouched {away:.1f} and pressed {pressed:.1f} before "
                f"reset_dt, {away_later:.1f} and {pressed_later:.1f} after it, which came while "
                "pressed"
            )


class RawReader(Reader):
    """As readers of the raw driver: bgr8 of both fingers, a queue of 20."""

    def __init__(self) -> None:
        super().__init__()
        for number in (8, 10):
            self.read(Image, f"RunCamera/image_raw_{number}", self._on_image, 20)

    def _on_image(self, message: Image) -> dict[str, Any]:
        pixels = pixels_of(message, "bgr8")
        if pixels.shape != (180, 320, 3):
            raise ValueError(f"image of {pixels.shape}, expected (180, 320, 3)")
        return described(message, pixels, "bgr8")


@dataclass(frozen=True)
class Interface:
    """A driver's interface.

    Attributes:
        reader: of it.
        rate_hz: of its images.
        namespaces: of the sensors, "" for none.
    """

    reader: type[Reader]
    rate_hz: float
    namespaces: tuple[str, ...] = field(default=("left", "right"))


INTERFACES = {
    "run_camera": Interface(RunCameraReader, 30.0, ("",)),
    "dual_compressed": Interface(CompressedReader, 30.0),
    "dual_difference": Interface(DifferenceReader, 30.0),
    "dual_raw": Interface(RawReader, 20.0),
}


class Press:
    """Presses the indenters of sensors into their gel, again and again.

    Args:
        node: publishes the poses.
        namespaces: of the sensors.
    """

    def __init__(self, node: Node, namespaces: tuple[str, ...]) -> None:
        self._node = node
        self._publishers = [PosePublisher(node, namespace=name, quality=10) for name in namespaces]
        node.create_timer(1.0 / POSE_HZ, self._send)

    def has_readers(self) -> bool:
        """Return whether every sensor reads its poses."""
        return all(publisher.has_reader() for publisher in self._publishers)

    @staticmethod
    def depth_m(time_s: float) -> tuple[float, float]:
        """Return the depth at a time, and for how long the indenter was held there; 0: it moved."""
        quarter, along_s = divmod(time_s % PERIOD_S, 0.25 * PERIOD_S)
        along = along_s / (0.25 * PERIOD_S)
        share = (0.0, along, 1.0, 1.0 - along)[min(int(quarter), 3)]
        return DEPTH_M * (2.0 * share - 1.0), along_s if quarter in (0.0, 2.0) else 0.0

    def held_m(self, time_s: float) -> float:
        """Return the depth that the indenter had been held at for a while; NaN where it moved."""
        depth_m, held_s = self.depth_m(time_s)
        return depth_m if held_s > SETTLED_S else math.nan

    def _send(self) -> None:
        depth_m, _ = self.depth_m(time_s(self._node.get_clock().now().to_msg()))
        for publisher in self._publishers:
            publisher.send(Pose(np.array([0.0, 0.0, APEX_M - depth_m])))


def measure(name: str, seconds: float) -> dict[str, Any]:
    """Return what a reader of an interface got, and what it stumbled over.

    Args:
        name: of `INTERFACES`.
        seconds: for which it reads.

    Raises:
        OSError: a sensor does not start.
    """
    interface = INTERFACES[name]
    file = ["--params-file", f"drivers/{name}.yaml"]
    with running_sensors(namespaces=interface.namespaces, arguments=file):
        rclpy.init()
        try:
            return _read(interface, seconds)
        finally:
            rclpy.try_shutdown()


def _read(interface: Interface, seconds: float) -> dict[str, Any]:
    errors: list[str] = []
    reader = interface.reader()
    press = Press(reader, interface.namespaces)
    reader.held_m = press.held_m
    executor = SingleThreadedExecutor()
    executor.add_node(reader)
    patience_s = time.monotonic() + PATIENCE_S
    while not (press.has_readers() and all(reader.arrived_s.values())):
        _spin(executor, errors)
        if time.monotonic() > patience_s or len(errors) > 3:
            missing = [topic for topic, arrived in reader.arrived_s.items() if not arrived]
            errors.append(f"nothing came on {', '.join(missing) or 'indenter/pose'}")
            break
    for arrived_s in reader.arrived_s.values():
        del arrived_s[:]
    middle_s, end_s = time.monotonic() + 0.5 * seconds, time.monotonic() + seconds
    has_begun = bool(errors)
    while time.monotonic() < end_s and not errors:
        now_s = time_s(reader.get_clock().now().to_msg())
        if not has_begun and time.monotonic() > middle_s and press.held_m(now_s) > 0.0:
            has_begun = True
            reader.begin_episode()
        _spin(executor, errors)
    if not errors:
        try:
            reader.check()
        except ValueError as error:
            errors.append(str(error))
    topics = {topic: _row(reader, topic) for topic in reader.arrived_s}
    reader.destroy_node()
    return {"rate_hz": interface.rate_hz, "topics": topics, "errors": errors}


def _spin(executor: SingleThreadedExecutor, errors: list[str]) -> None:
    try:
        executor.spin_once(timeout_sec=0.1)
    except Exception as error:
        errors.append(f"{type(error).__name__}: {error}")


def _row(reader: Reader, topic: str) -> dict[str, Any]:
    arrived_s = np.array(reader.arrived_s[topic])
    gaps_s = np.diff(arrived_s)
    rate_hz = len(gaps_s) / (arrived_s[-1] - arrived_s[0]) if len(gaps_s) else 0.0
    return {
        **reader.seen.get(topic, {}),
        "messages": len(arrived_s),
        "messages_per_second": round(float(rate_hz), 2),
        "longest_gap_ms": round(1e3 * float(gaps_s.max(initial=0.0)), 1),
    }


def drop_in(
    *, seconds: float = 60.0, interfaces: tuple[str, ...] = tuple(INTERFACES)
) -> dict[str, Any]:
    """Whether programs written for drivers of real sensors run on the simulated one.

    Args:
        seconds: of each interface.
        interfaces: of run_camera, dual_compressed, dual_difference, dual_raw.
    """
    expect_positive(seconds=seconds)
    expect_known("interface", interfaces, INTERFACES)
    found = {name: measure(name, seconds) for name in interfaces}
    return {
        "seconds": seconds,
        "interfaces": found,
        FAILED: [f"{name}: {error}" for name in found for error in found[name]["errors"]],
    }
