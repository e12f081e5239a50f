# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frame rate and latency of the running node over DDS, and where a frame's time goes.

Four parts, one after the other, so that none disturbs another:
1. Starts of the node, from the command to "ready": cold, with no compiled kernel and no computed
   table on disk, and warm, with those that the cold start left. Files of the system may be in
   memory in both.
2. The node in a process of its own under poses at 100 Hz: presses at 5 mm/s and slides at 10 mm/s
   of a 4 mm sphere.
3. The sensor alone under the same motion, for a sphere, a box edge, a cone, a ring, two bumps and
   two flat faces, with how often the gel fits into a frame of the explicit reference; the same for
   a sphere with a learned image, with the share of a frame's time that is left at the median
   (headroom).
4. The explicit reference of the paper: 100 substeps a frame at 1.2 mm.

Latency is measured to the newest sent pose that an Image has reached: from the publication of that
pose to the arrival of the Image, by one process's clock. Every frame counts.
Most frames show a sent pose exactly, and that is the pose they have reached. The others lag: the
node limits the motion of a frame, and they show the indenter on a short cut towards a newer pose. A
lagging frame has reached no pose that lies further along the sent path than the shown indenter has
moved since the last exact frame. A short cut is never longer than the path that it cuts, so this
takes too old a pose rather than one too new: the latency of a lagging frame is an upper bound.
Lengths are those of the way of the indenter's tip; the motion never turns in place.

Frames are fewest where they take longest, so latency by frame weighs slow moments less than fast
ones. The age at hand weighs every moment alike: it is the time since the newest sent pose that the
last Image has reached was published, sampled evenly in time, as a controller at a fixed rate would
see it.

The lag of a lagging frame is the distance from where it shows the tip to the newest pose that was
sent before the frame's stamp.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import Image, PointCloud2

import msg_adapters
from dotsim_ros.data.motion import Motion
from dotsim_ros.data.scripted import Site, in_sequence, press_hold_release, slide
from dotsim_ros.geometry.indenter import Indenter, load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import load_sensor
from studies.reference.study import two_bumps
from studies.run import expect_positive
from studies.speed.device_check import explicit_ms
from studies.speed.running_node import PosePublisher, observing_node, running_sensors
from studies.timing import percentiles_ms

POSE_RATE_HZ = 100.0
# Skipped at the start: caches, and a middleware that still discovers.
SETTLE_S = 2.0
CASES = ("sphere_4mm", "box_edge", "cone", "torus", "two_bumps", "flat_punch", "box_face")
LEARNED_SENSOR = "sensor_a"
GEL_PARTS = ("contact", "solve")
OPTICS_PARTS = ("depth", "image")
EXPLICIT_FRAMES = 2
FRAME_RATE_HZ = 25.0
WARM_FRAMES = 10
"""Before the clock starts: kernels and caches."""
CACHE_VARIABLES = ("DOTSIM_ROS_CACHE", "WARP_CACHE_PATH")

Point = tuple[float, float, float]


def motion_under_load() -> Motion:
    """Return the press at 5 mm/s and the slide at 10 mm/s, with the ways between them."""
    press = press_hold_release(Site(), depth_m=0.002, hold_s=0.0, speed_m_s=0.005)
    across = slide(
        Site(tilt_rad=np.deg2rad(12.0)),
        depth_m=0.0015,
        distance_m=0.0066,
        heading_rad=np.pi,
        speed_m_s=0.005,
        slide_speed_m_s=0.01,
    )
    return in_sequence([press, across])


@dataclass(frozen=True)
class SentPath:
    """The poses that were sent, in order.

    Attributes:
        position_m: (N, 3) of the indenter's tip; each differs from all others.
        sent_s: (N,) when each was published, by the clock that times the arrivals.
        stamp_ns: (N,) its stamp.
    """

    position_m: NDArray[np.float64]
    sent_s: NDArray[np.float64]
    stamp_ns: NDArray[np.int64]

    def travelled_m(self) -> NDArray[np.float64]:
        """Return (N,) the length of the path up to each pose."""
        steps = np.linalg.norm(np.diff(self.position_m, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])


@dataclass(frozen=True)
class FrameAges:
    """Latencies of frames, as the head of this file defines them.

    Attributes:
        latency_s: by stamp.
        lag_m: of the frames that lag, by stamp.
    """

    latency_s: dict[int, float]
    lag_m: dict[int, float]


def frame_ages(
    sent: SentPath, shown_m: Mapping[int, Point], arrived_s: Mapping[int, float]
) -> FrameAges:
    """Return the latencies of the frames whose image arrived.

    Args:
        sent: the poses.
        shown_m: where each frame shows the tip, by stamp; also of frames whose image was lost.
        arrived_s: when the images arrived, by stamp.
    """
    travelled_m = sent.travelled_m()
    number = {tuple(position): index for index, position in enumerate(sent.position_m.tolist())}
    ages = FrameAges({}, {})
    reached, way_m, before = 0, 0.0, sent.position_m[0]
    for stamp_ns in sorted(shown_m):
        here = np.array(shown_m[stamp_ns])
        newest = max(0, int(np.searchsorted(sent.stamp_ns, stamp_ns, side="right")) - 1)
        exact = number.get(shown_m[stamp_ns])
        if exact is not None:
            reached, way_m = exact, float(travelled_m[exact])
        else:
            way_m += float(np.linalg.norm(here - before))
            along = int(np.searchsorted(travelled_m, way_m, side="right")) - 1
            reached = min(along, newest)
            if stamp_ns in arrived_s:
                ages.lag_m[stamp_ns] = float(np.linalg.norm(sent.position_m[newest] - here))
        before = here
        if stamp_ns in arrived_s:
            ages.latency_s[stamp_ns] = arrived_s[stamp_ns] - float(sent.sent_s[reached])
    return ages


def ages_at_hand_s(latency_s: list[float], arrived_s: list[float]) -> list[float]:
    """Return the age of the last image at each millisecond between the first and the last.

    Args:
        latency_s: of each image.
        arrived_s: when it came, in order.
    """
    moment_s = np.arange(arrived_s[0], arrived_s[-1], 1e-3)
    last = np.searchsorted(arrived_s, moment_s, side="right") - 1
    ages = np.asarray(latency_s)[last] + moment_s - np.asarray(arrived_s)[last]
    return [float(age) for age in ages]


class PosePlayer(threading.Thread):
    """Publishes the motion over and over, and remembers when it sent which pose."""

    def __init__(self, node: Node, motion: Motion, *, seconds: float) -> None:
        super().__init__(daemon=True)
        self._motion, self._seconds = motion, seconds
        self.publisher = PosePublisher(node)
        self._sent: list[tuple[NDArray[np.float64], float, int]] = []

    def sent(self) -> SentPath:
        """Return what was sent, once the player is done."""
        position_m, sent_s, stamp_ns = zip(*self._sent, strict=True)
        return SentPath(np.array(position_m), np.array(sent_s), np.array(stamp_ns))

    def run(self) -> None:
        motion = self._motion
        begun_s = time.monotonic()
        for index in range(int(self._seconds * POSE_RATE_HZ)):
            pose = motion.at(index / POSE_RATE_HZ % motion.duration_s)
            # A picometre a message makes every position one of a kind.
            position = pose.position_m + np.array([1e-12 * index, 0.0, 0.0])
            wait_s = begun_s + index / POSE_RATE_HZ - time.monotonic()
            if wait_s > 0.0:
                time.sleep(wait_s)
            sent_s = time.monotonic()
            stamp_ns = self.publisher.send(Pose(position, pose.quaternion_xyzw))
            self._sent.append((position, sent_s, stamp_ns))


def measure_start_up() -> dict[str, float]:
    """Return how long the node takes to be ready, with empty caches and with full ones.

    Raises:
        OSError: the node does not start.
    """
    figures = {}
    with tempfile.TemporaryDirectory(prefix="dotsim_ros_cold_") as folder:
        environment = {name: str(Path(folder) / name.lower()) for name in CACHE_VARIABLES}
        for name in ("cold_s", "warm_s"):
            begun_s = time.monotonic()
            with running_sensors(environment=environment):
                figures[name] = round(time.monotonic() - begun_s, 2)
    return figures


def measure_node(
    seconds: float,
    rate_hz: float,
    sensor: str,
    parameters: Mapping[str, Any] | None = None,
    *,
    motion: Motion | None = None,
) -> dict[str, Any]:
    """Return rate, latency and the node's own figures under a motion.

    Args:
        seconds: how long.
        rate_hz, sensor, parameters: parameters of the node.
        motion: again and again; None for that under load.

    Raises:
        OSError: the node does not start.
        RuntimeError: no frames come.
    """
    begun_s = time.monotonic()
    with (
        running_sensors({"rate_hz": rate_hz, "sensor": sensor, **(parameters or {})}) as (process,),
        observing_node("realtime") as (node, executor),
    ):
        start_up_s = time.monotonic() - begun_s
        arrived_s: dict[int, float] = {}
        shown_m: dict[int, Point] = {}
        figures: dict[str, str] = {}

        def on_image(message: Image) -> None:
            arrived_s[msg_adapters.message_stamp_ns(message)] = time.monotonic()

        def on_state(message: PoseStamped) -> None:
            position, _ = msg_adapters.decode_pose_stamped(message)
            x, y, z = position.tolist()
            shown_m[msg_adapters.message_stamp_ns(message)] = (x, y, z)

        def on_diagnostics(message: DiagnosticArray) -> None:
            for status in msg_adapters.decode_diagnostics(message):
                figures.update(status.values)

        node.create_subscription(Image, "image_raw", on_image, 5)
        node.create_subscription(PoseStamped, "indenter/state", on_state, 50)
        node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
        # Where the skin has printed markers.
        node.create_subscription(PointCloud2, "markers", lambda _: None, 5)
        moves = motion or motion_under_load()
        player = PosePlayer(node, moves, seconds=seconds + SETTLE_S)
        while not player.publisher.has_reader():
            executor.spin_once(timeout_sec=0.1)
        player.start()
        while player.is_alive():
            executor.spin_once(timeout_sec=0.1)
    sent = player.sent()
    first_s = sent.sent_s[0] + SETTLE_S
    stamps = [stamp for stamp in sorted(arrived_s) if arrived_s[stamp] >= first_s]
    ages = frame_ages(sent, shown_m, arrived_s)
    known = [stamp for stamp in stamps if stamp in ages.latency_s]
    latency_s = [ages.latency_s[stamp] for stamp in known]
    lag_m = [ages.lag_m[stamp] for stamp in stamps if stamp in ages.lag_m]
    exact = ages.latency_s.keys() - ages.lag_m.keys()
    exact_s = [ages.latency_s[stamp] for stamp in stamps if stamp in exact]
    if len(exact_s) < 2:
        raise RuntimeError(f"{len(stamps)} frames came in {seconds} s; the node's log says why")
    span_s = arrived_s[stamps[-1]] - arrived_s[stamps[0]]
    return {
        "rate_hz": rate_hz,
        "frames": len(stamps),
        "frames_per_second": round((len(stamps) - 1) / span_s, 3),
        "latency_s": latency_s,
        "age_at_hand": percentiles_ms(
            ages_at_hand_s(latency_s, [arrived_s[stamp] for stamp in known])
        ),
        "latency_of_exact_frames": percentiles_ms(exact_s),
        "frames_without_pose": len(stamps) - len(latency_s),
        "lagging_share": round(len(lag_m) / len(latency_s), 4),
        "largest_lag_mm": round(1e3 * max(lag_m, default=0.0), 3),
        "longest_gap_ms": round(
            1e3 * max(np.diff([arrived_s[stamp] for stamp in stamps])).item(), 1
        ),
        "start_up_s": round(start_up_s, 2),
        "exit_status": process.stop(),
        "node": figures,
    }


def shape_of(name: str) -> Indenter:
    """Return the indenter of a case."""
    return two_bumps() if name == "two_bumps" else load_indenter(name)


def measure_sensor(name: str, indenter: str, frame_count: int) -> dict[str, Any]:
    """Return the times of a sensor's parts under the motion, for one indenter."""
    sensor = TactileSensor(load_sensor(name), indenter=shape_of(indenter))
    motion = motion_under_load()
    spent: list[dict[str, float]] = []
    total_s: list[float] = []
    unconverged = 0
    penetration_m = 0.0
    for index in range(-WARM_FRAMES, frame_count):
        pose = motion.at(max(index, 0) / FRAME_RATE_HZ % motion.duration_s)
        begun_s = time.perf_counter()
        frame = sensor.step(pose, 1.0 / FRAME_RATE_HZ)
        if index >= 0:
            total_s.append(time.perf_counter() - begun_s)
            spent.append(frame.timings_s)
            unconverged += not frame.converged
            penetration_m = max(penetration_m, frame.max_penetration_m)
    gel_s = [sum(parts[name] for name in GEL_PARTS) for parts in spent]
    gel = percentiles_ms(gel_s)
    return {
        "indenter": indenter,
        "frames": frame_count,
        "gel_p50_ms": gel["p50_ms"],
        "gel_p95_ms": gel["p95_ms"],
        "gel": gel,
        "optics": percentiles_ms([sum(parts[name] for name in OPTICS_PARTS) for parts in spent]),
        "total": percentiles_ms(total_s),
        "gel_mean_ms": round(1e3 * float(np.mean(gel_s)), 2),
        **{
            name: percentiles_ms([parts[name] for parts in spent])
            for name in (*GEL_PARTS, *OPTICS_PARTS)
        },
        "frames_per_second": round(1.0 / float(np.mean(total_s)), 2),
        "max_penetration_um": round(1e6 * penetration_m, 2),
        "unconverged_frames": unconverged,
    }


def headroom(sensor_figures: Mapping[str, Any], rate_hz: float) -> float:
    """Return the share of a frame's time that a sensor leaves at the median."""
    return round(1.0 - 1e-3 * float(sensor_figures["total"]["p50_ms"]) * rate_hz, 3)


def speedup(case: Mapping[str, Any], explicit_frame_ms: float) -> float | None:
    """Return how often the gel of a case fits into a frame of the explicit reference, at the 95th
    percentile; None where so few frames were taken that none was in contact."""
    gel_ms = float(case["gel_p95_ms"])
    return round(explicit_frame_ms / gel_ms, 1) if gel_ms else None


def realtime(
    *,
    seconds: float = 60.0,
    rate_hz: float = FRAME_RATE_HZ,
    sensor: str = "densetact2",
    case_frames: int = 200,
    start_up: bool = True,
) -> dict[str, Any]:
    """Frame rate and latency of the running node, and where a frame's time goes.

    Args:
        seconds: under load.
        rate_hz: of the node.
        sensor: name or file; sensor_a has a learned image.
        case_frames: frames of each indenter.
        start_up: time the starts too, which takes some minutes.
    """
    expect_positive(seconds=seconds, rate_hz=rate_hz, case_frames=case_frames)
    starts = measure_start_up() if start_up else {}
    node = measure_node(seconds, rate_hz, sensor)
    latency = percentiles_ms(node.pop("latency_s"))
    cases = {name: measure_sensor(sensor, name, case_frames) for name in CASES}
    learned = measure_sensor(LEARNED_SENSOR, CASES[0], case_frames)
    explicit_frame_ms = explicit_ms("cpu", EXPLICIT_FRAMES)
    for case in cases.values():
        case["gel_p95_speedup"] = speedup(case, explicit_frame_ms)
    return {
        "frames_per_second": node["frames_per_second"],
        "latency_p50_ms": latency["p50_ms"],
        "latency_p99_ms": latency["p99_ms"],
        "lagging_share": node["lagging_share"],
        "largest_lag_mm": node["largest_lag_mm"],
        "gel_p95_ms": float(node["node"].get("gel_p95_ms", "nan")),
        "optics_p95_ms": float(node["node"].get("optics_p95_ms", "nan")),
        "explicit_ratio": round(1e-3 * explicit_frame_ms * cases[CASES[0]]["frames_per_second"], 1),
        "explicit_frames_per_second": round(1e3 / explicit_frame_ms, 3),
        "headroom": headroom(learned, rate_hz),
        "start_up": starts,
        "node": node,
        "cases": cases,
        "learned": learned,
    }
