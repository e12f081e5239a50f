# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frame rate and latency of the running node over DDS, and where a frame's time goes.

python benchmarks/realtime.py --seconds 60 --json realtime.json

Four parts, one after the other, so that none disturbs another:
1. Starts of the node, from the command to "ready": cold, with no compiled kernel and no computed
   table on disk, and warm, with those that the cold start left. Files of the system may be in
   memory in both.
2. The node in a process of its own under poses at 100 Hz: presses at 5 mm/s and slides at 10 mm/s
   of a 4 mm sphere.
3. The sensor alone under the same motion, for a sphere, a box edge, a cone, a ring, two bumps and
   two flat faces, with how often the gel fits into a frame of the explicit reference; the same for
   a sphere with a learned image, with the share of a frame's time that is left at the median
   (headroom); then a batch of gels in processes of their own, by turns with one gel alone.
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

import argparse
import tempfile
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from reference import two_bumps

from dotsim_ros.files import write_json
from dotsim_ros.geometry.indenter import Indenter, load_indenter
from dotsim_ros.measured.motion import Motion
from dotsim_ros.measured.scripted import Site, in_sequence, press_hold_release, slide
from dotsim_ros.provenance import provenance
from dotsim_ros.specification import load_sensor

POSE_RATE_HZ = 100.0
START_TIMEOUT_S = 300.0
# Skipped at the start: caches, and a middleware that still discovers.
SETTLE_S = 2.0
CASES = ("sphere_4mm", "box_edge", "cone", "torus", "two_bumps", "flat_punch", "box_face")
LEARNED_SENSOR = "sensor_a"
BATCH_SIZE = 4
GEL_PARTS = ("contact", "solve")
OPTICS_PARTS = ("depth", "image")
EXPLICIT_SPACING_M = 1.2e-3
EXPLICIT_SUBSTEPS = 100
EXPLICIT_FRAMES = 2
CACHE_VARIABLES = ("DOTSIM_ROS_CACHE", "WARP_CACHE_PATH")

Point = tuple[float, float, float]


def benchmark_motion() -> Motion:
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


def quantiles_ms(seconds: list[float]) -> dict[str, float]:
    """Return the quantiles of times in seconds as milliseconds."""
    values = np.percentile(1e3 * np.asarray(seconds), [50, 95, 99])
    return dict(zip(("p50_ms", "p95_ms", "p99_ms"), values.round(2).tolist(), strict=True))


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

    def __init__(self, node: Any, *, seconds: float) -> None:
        super().__init__(daemon=True)
        from geometry_msgs.msg import PoseStamped

        self._node, self._seconds = node, seconds
        self._publisher = node.create_publisher(PoseStamped, "indenter/pose", 1)
        self._sent: list[tuple[NDArray[np.float64], float, int]] = []

    def is_heard(self) -> bool:
        """Return whether somebody reads the poses."""
        return bool(self._publisher.get_subscription_count() > 0)

    def sent(self) -> SentPath:
        """Return what was sent, once the player is done."""
        position_m, sent_s, stamp_ns = zip(*self._sent, strict=True)
        return SentPath(np.array(position_m), np.array(sent_s), np.array(stamp_ns))

    def run(self) -> None:
        import msg_adapters

        motion = benchmark_motion()
        begun_s = time.monotonic()
        for index in range(int(self._seconds * POSE_RATE_HZ)):
            pose = motion.at(index / POSE_RATE_HZ % motion.duration_s)
            # A picometre a message makes every position one of a kind.
            position = pose.position_m + np.array([1e-12 * index, 0.0, 0.0])
            wait_s = begun_s + index / POSE_RATE_HZ - time.monotonic()
            if wait_s > 0.0:
                time.sleep(wait_s)
            stamp_ns = self._node.get_clock().now().nanoseconds
            message = msg_adapters.encode_pose_stamped(
                position,
                pose.quaternion_xyzw,
                stamp_ns=stamp_ns,
                frame_id="densetact_base",
            )
            self._sent.append((position, time.monotonic(), stamp_ns))
            self._publisher.publish(message)


def measure_start_up() -> dict[str, float]:
    """Return how long the node takes to be ready, with empty caches and with full ones.

    Raises:
        OSError: the node does not start.
    """
    from dotsim_ros.nodes.common.processes import NodeProcess

    figures = {}
    with tempfile.TemporaryDirectory(prefix="dotsim_ros_cold_") as folder:
        environment = {name: str(Path(folder) / name.lower()) for name in CACHE_VARIABLES}
        for name in ("cold_s", "warm_s"):
            begun_s = time.monotonic()
            process = NodeProcess("tactile_sim", {}, environment=environment)
            try:
                process.wait_for_line("ready:", timeout_s=START_TIMEOUT_S)
                figures[name] = round(time.monotonic() - begun_s, 2)
            finally:
                process.stop()
    return figures


def measure_node(
    seconds: float, rate_hz: float, sensor: str, parameters: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return rate, latency and the node's own figures under the motion.

    Args:
        seconds: how long.
        rate_hz, sensor, parameters: parameters of the node.

    Raises:
        OSError: the node does not start.
        RuntimeError: no frames come.
    """
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import PoseStamped
    from rclpy.executors import SingleThreadedExecutor
    from sensor_msgs.msg import Image

    import msg_adapters
    from dotsim_ros.nodes.common.processes import NodeProcess

    begun_s = time.monotonic()
    process = NodeProcess(
        "tactile_sim", {"rate_hz": rate_hz, "sensor": sensor, **(parameters or {})}
    )
    try:
        process.wait_for_line("ready:", timeout_s=START_TIMEOUT_S)
        start_up_s = time.monotonic() - begun_s
        rclpy.init()
        node = rclpy.create_node("realtime_benchmark")
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
        player = PosePlayer(node, seconds=seconds + SETTLE_S)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not player.is_heard():
            executor.spin_once(timeout_sec=0.1)
        player.start()
        while player.is_alive():
            executor.spin_once(timeout_sec=0.1)
        node.destroy_node()
        rclpy.try_shutdown()
    finally:
        status = process.stop()
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
        "age_at_hand": quantiles_ms(
            ages_at_hand_s(latency_s, [arrived_s[stamp] for stamp in known])
        ),
        "latency_of_exact_frames": quantiles_ms(exact_s),
        "frames_without_pose": len(stamps) - len(latency_s),
        "lagging_share": round(len(lag_m) / len(latency_s), 4),
        "largest_lag_mm": round(1e3 * max(lag_m, default=0.0), 3),
        "longest_gap_ms": round(
            1e3 * max(np.diff([arrived_s[stamp] for stamp in stamps])).item(), 1
        ),
        "start_up_s": round(start_up_s, 2),
        "exit_status": status,
        "node": figures,
    }


def shape_of(name: str) -> Indenter:
    """Return the indenter of a case."""
    return two_bumps() if name == "two_bumps" else load_indenter(name)


def measure_sensor(
    name: str, indenter: str, frame_rate_hz: float, frame_count: int
) -> dict[str, Any]:
    """Return the times of a sensor's parts under the motion, for one indenter."""
    from dotsim_ros.sensor import TactileSensor

    sensor = TactileSensor(load_sensor(name), indenter=shape_of(indenter))
    motion = benchmark_motion()
    spent: list[dict[str, float]] = []
    total_s: list[float] = []
    unconverged = 0
    penetration_m = 0.0
    # The first round of frames warms up kernels and caches.
    for index in range(-10, frame_count):
        pose = motion.at(max(index, 0) / frame_rate_hz % motion.duration_s)
        begun_s = time.perf_counter()
        frame = sensor.step(pose, 1.0 / frame_rate_hz)
        if index >= 0:
            total_s.append(time.perf_counter() - begun_s)
            spent.append(frame.timings_s)
            unconverged += not frame.converged
            penetration_m = max(penetration_m, frame.max_penetration_m)
    gel = quantiles_ms([sum(parts[name] for name in GEL_PARTS) for parts in spent])
    return {
        "indenter": indenter,
        "frames": frame_count,
        "gel_p50_ms": gel["p50_ms"],
        "gel_p95_ms": gel["p95_ms"],
        "gel": gel,
        "optics": quantiles_ms([sum(parts[name] for name in OPTICS_PARTS) for parts in spent]),
        "total": quantiles_ms(total_s),
        "gel_mean_ms": round(
            1e3 * float(np.mean([sum(parts[name] for name in GEL_PARTS) for parts in spent])), 2
        ),
        **{
            name: quantiles_ms([parts[name] for parts in spent])
            for name in (*GEL_PARTS, *OPTICS_PARTS)
        },
        "frames_per_second": round(1.0 / float(np.mean(total_s)), 2),
        "max_penetration_um": round(1e6 * penetration_m, 2),
        "unconverged_frames": unconverged,
    }


def measure_batch(
    name: str, indenter: str, frame_rate_hz: float, frame_count: int
) -> dict[str, Any]:
    """Return the time of a batch of gels, for each environment and frame, and that of a gel alone.

    Every environment makes the same motion, each a part of it ahead of the one before. The gel
    alone makes it by turns with the batch, so that both meet the same machine.
    """
    from dotsim_ros.gel.batch import GelBatch
    from dotsim_ros.gel.make import make_gel_batch

    specification, shape = load_sensor(name), load_indenter(indenter)
    alone = make_gel_batch(specification, indenter=shape, environment_count=1)
    motion = benchmark_motion()
    spent_s: list[float] = []
    alone_s: list[float] = []
    unconverged = 0
    with GelBatch(specification, indenter=shape, environment_count=BATCH_SIZE) as gel:
        for index in range(-10, frame_count):
            time_s = max(index, 0) / frame_rate_hz
            poses = [
                motion.at((time_s + part * motion.duration_s / BATCH_SIZE) % motion.duration_s)
                for part in range(BATCH_SIZE)
            ]
            begun_s = time.perf_counter()
            states = gel.step(poses, 1.0 / frame_rate_hz)
            between_s = time.perf_counter()
            alone.step(poses[:1], 1.0 / frame_rate_hz)
            if index >= 0:
                spent_s.append((between_s - begun_s) / BATCH_SIZE)
                alone_s.append(time.perf_counter() - between_s)
                unconverged += sum(not state.converged for state in states)
    return {
        "indenter": indenter,
        "environments": BATCH_SIZE,
        "frames": frame_count,
        "gel_per_environment": quantiles_ms(spent_s),
        "mean_ms": round(1e3 * float(np.mean(spent_s)), 2),
        "alone_mean_ms": round(1e3 * float(np.mean(alone_s)), 2),
        "cost_ratio": round(float(np.mean(spent_s) / np.mean(alone_s)), 3),
        "unconverged_frames": unconverged,
    }


def main() -> None:
    """Measure, print the table, and write it as JSON where asked."""
    parser = argparse.ArgumentParser(
        description="Frame rate and latency of the running node, and where a frame's time goes.",
        epilog="example: python benchmarks/realtime.py --seconds 60 --json realtime.json",
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="time under load (60)")
    parser.add_argument("--rate-hz", type=float, default=25.0, help="rate of the node (25)")
    parser.add_argument(
        "--sensor", default="densetact2", help="sensor_a has a learned image (densetact2)"
    )
    parser.add_argument("--case-frames", type=int, default=200, help="frames an indenter (200)")
    parser.add_argument(
        "--skip-cold-start", action="store_true", help="leave out the starts, some minutes"
    )
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    arguments = parser.parse_args()

    from dotsim_ros.gel.explicit.gel import explicit_seconds_per_frame

    start_up = {} if arguments.skip_cold_start else measure_start_up()
    node = measure_node(arguments.seconds, arguments.rate_hz, arguments.sensor)
    latency_s = node.pop("latency_s")
    cases = {
        name: measure_sensor(arguments.sensor, name, 25.0, arguments.case_frames) for name in CASES
    }
    learned = measure_sensor(LEARNED_SENSOR, CASES[0], 25.0, arguments.case_frames)
    batch = measure_batch(arguments.sensor, CASES[0], 25.0, arguments.case_frames)
    explicit_s = explicit_seconds_per_frame(
        spacing_m=EXPLICIT_SPACING_M,
        substeps_per_frame=EXPLICIT_SUBSTEPS,
        frame_count=EXPLICIT_FRAMES,
    )
    for case in cases.values():
        case["gel_p95_speedup"] = round(1e3 * explicit_s / case["gel_p95_ms"], 1)
    latency = quantiles_ms(latency_s)
    figures = {
        "frames_per_second": node["frames_per_second"],
        "latency_p50_ms": latency["p50_ms"],
        "latency_p99_ms": latency["p99_ms"],
        "lagging_share": node["lagging_share"],
        "largest_lag_mm": node["largest_lag_mm"],
        "gel_p95_ms": float(node["node"].get("gel_p95_ms", "nan")),
        "optics_p95_ms": float(node["node"].get("optics_p95_ms", "nan")),
        "explicit_ratio": round(explicit_s * cases[CASES[0]]["frames_per_second"], 1),
        "explicit_frames_per_second": round(1.0 / explicit_s, 3),
        "batch_cost_ratio": batch["cost_ratio"],
        "headroom": round(1.0 - 1e-3 * learned["total"]["p50_ms"] * arguments.rate_hz, 3),
        "start_up": start_up,
        "node": node,
        "cases": cases,
        "learned": learned,
        "batch": batch,
        "provenance": provenance(),
    }
    print_table(figures)
    if arguments.json:
        write_json(arguments.json, figures)


def print_table(figures: dict[str, Any]) -> None:
    """Print what was measured."""
    node = figures["node"]
    print(f"\n{figures['provenance']['machine']}, commit {figures['provenance']['commit']}")
    for name, seconds in figures["start_up"].items():
        print(f"{name.removesuffix('_s')} start: ready after {seconds:.1f} s")
    print(
        f"node over DDS: {figures['frames_per_second']:.2f} frames/s at {node['rate_hz']:g} Hz, "
        f"latency {figures['latency_p50_ms']:.1f} ms median, {figures['latency_p99_ms']:.1f} ms "
        f"p99, age at hand {node['age_at_hand']['p50_ms']:.1f} ms median, "
        f"{node['age_at_hand']['p99_ms']:.1f} ms p99"
    )
    print(
        f"{node['node'].get('dropped', '?')} dropped, longest gap {node['longest_gap_ms']} ms, "
        f"ready after {node['start_up_s']} s"
    )
    print(
        f"lagging behind the newest pose: {100.0 * figures['lagging_share']:.1f} % of frames, by "
        f"{figures['largest_lag_mm']:.2f} mm at most; latency of the others "
        f"{node['latency_of_exact_frames']['p99_ms']:.1f} ms p99"
    )
    if node["frames_without_pose"]:
        print(f"{node['frames_without_pose']} frames came without their pose: not in the latency")
    parts = ("contact", "solve", "depth", "image", "publish", "gel", "optics")
    shares = ", ".join(f"{part} {node['node'].get(part + '_p95_ms', '?')}" for part in parts)
    print(f"in the node, p95 ms: {shares}")
    print(
        f"{'sensor alone':<14}{'gel p50':>9}{'p95':>8}{'optics p50':>12}{'p95':>8}{'frames/s':>10}"
        f"{'explicit/gel p95':>18}"
    )
    for name, case in figures["cases"].items():
        print(
            f"{name:<14}{case['gel']['p50_ms']:9.1f}{case['gel']['p95_ms']:8.1f}"
            f"{case['optics']['p50_ms']:12.1f}{case['optics']['p95_ms']:8.1f}"
            f"{case['frames_per_second']:10.1f}"
            f"{case['gel_p95_speedup']:12.1f}"
        )
    learned = figures["learned"]["total"]
    print(
        f"{LEARNED_SENSOR}, with a learned image: a frame takes {learned['p50_ms']:.1f} ms at the "
        f"median, {learned['p95_ms']:.1f} p95; {100.0 * figures['headroom']:.0f} % of it is left"
    )
    batch = figures["batch"]
    print(
        f"{batch['environments']} environments of {batch['indenter']}: gel per environment and "
        f"frame {batch['mean_ms']:.1f} ms on average, {batch['gel_per_environment']['p50_ms']:.1f} "
        f"p50, {batch['gel_per_environment']['p95_ms']:.1f} p95; alone "
        f"{batch['alone_mean_ms']:.1f} ms on average: {batch['cost_ratio']:.2f} times"
    )
    print(
        f"explicit reference: {figures['explicit_frames_per_second']:.2f} frames/s; the sensor "
        f"makes {figures['explicit_ratio']:.1f} times as many"
    )


if __name__ == "__main__":
    main()
