"""Frame rate and latency of the running node over DDS, and where a frame's time goes.

python benchmarks/realtime.py --seconds 60 --json realtime.json

Three parts, one after the other, so that none disturbs another:
1. The node in a process of its own under poses at 100 Hz: presses at 5 mm/s and slides at 10 mm/s
   of a 4 mm sphere. Latency is from the publication of the pose that a frame shows to the arrival
   of its Image, in the same process's clock.
2. The sensor alone under the same motion, for a sphere, a box edge and a flat punch.
3. The explicit reference of the paper: 100 substeps a frame at 1.2 mm.
"""

from __future__ import annotations

import argparse
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.evaluation.provenance import provenance, write_json
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.specification import load_sensor
from dotsim_ros.measured.motion import Motion
from dotsim_ros.measured.scripted import Site, in_sequence, press_hold_release, slide

POSE_RATE_HZ = 100.0
START_TIMEOUT_S = 300.0
# Skipped at the start: caches, and a middleware that still discovers.
SETTLE_S = 2.0
CASES = ("sphere_4mm", "box_edge", "flat_punch")
GEL_PARTS = ("contact", "solve")
OPTICS_PARTS = ("depth", "image")
EXPLICIT_SPACING_M = 1.2e-3
EXPLICIT_SUBSTEPS = 100
EXPLICIT_FRAMES = 2


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


class PosePlayer(threading.Thread):
    """Publishes the motion over and over, and remembers when it sent which pose."""

    def __init__(self, node: Any, *, seconds: float) -> None:
        super().__init__(daemon=True)
        from geometry_msgs.msg import PoseStamped

        self._node, self._seconds = node, seconds
        self._publisher = node.create_publisher(PoseStamped, "indenter/pose", 1)
        self.sent_s: dict[tuple[float, ...], float] = {}

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
            message = msg_adapters.encode_pose_stamped(
                position,
                pose.quaternion_xyzw,
                stamp_ns=self._node.get_clock().now().nanoseconds,
                frame_id="densetact_base",
            )
            self.sent_s[tuple(position.tolist())] = time.monotonic()
            self._publisher.publish(message)


def measure_node(seconds: float, rate_hz: float) -> dict[str, Any]:
    """Return rate, latency and the node's own figures under the motion.

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
    from dotsim_ros.nodes.processes import NodeProcess

    begun_s = time.monotonic()
    process = NodeProcess("tactile_sim", {"rate_hz": rate_hz})
    try:
        process.wait_for_line("ready:", timeout_s=START_TIMEOUT_S)
        start_up_s = time.monotonic() - begun_s
        rclpy.init()
        node = rclpy.create_node("realtime_benchmark")
        arrived_s: dict[int, float] = {}
        shown: dict[int, tuple[float, ...]] = {}
        figures: dict[str, str] = {}

        def on_image(message: Image) -> None:
            arrived_s[msg_adapters.message_stamp_ns(message)] = time.monotonic()

        def on_state(message: PoseStamped) -> None:
            position, _ = msg_adapters.decode_pose_stamped(message)
            shown[msg_adapters.message_stamp_ns(message)] = tuple(position.tolist())

        def on_diagnostics(message: DiagnosticArray) -> None:
            for status in msg_adapters.decode_diagnostics(message):
                figures.update(status.values)

        node.create_subscription(Image, "image_raw", on_image, 5)
        node.create_subscription(PoseStamped, "indenter/state", on_state, 50)
        node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
        player = PosePlayer(node, seconds=seconds + SETTLE_S)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while player._publisher.get_subscription_count() == 0:
            executor.spin_once(timeout_sec=0.1)
        player.start()
        while player.is_alive():
            executor.spin_once(timeout_sec=0.1)
        node.destroy_node()
        rclpy.try_shutdown()
    finally:
        status = process.stop()
    first_s = min(player.sent_s.values()) + SETTLE_S
    stamps = [stamp for stamp in sorted(arrived_s) if arrived_s[stamp] >= first_s]
    latency_s = [
        arrived_s[stamp] - player.sent_s[shown[stamp]]
        for stamp in stamps
        if shown.get(stamp) in player.sent_s
    ]
    if len(latency_s) < 2:
        raise RuntimeError(f"{len(stamps)} frames came in {seconds} s; the node's log says why")
    span_s = arrived_s[stamps[-1]] - arrived_s[stamps[0]]
    return {
        "rate_hz": rate_hz,
        "frames": len(stamps),
        "frames_per_second": round((len(stamps) - 1) / span_s, 3),
        "latency_s": latency_s,
        "longest_gap_ms": round(
            1e3 * max(np.diff([arrived_s[stamp] for stamp in stamps])).item(), 1
        ),
        "start_up_s": round(start_up_s, 2),
        "exit_status": status,
        "node": figures,
    }


def measure_sensor(indenter: str, frame_rate_hz: float, frame_count: int) -> dict[str, Any]:
    """Return the times of a sensor's parts under the motion, for one indenter."""
    from dotsim_ros.sensor import TactileSensor

    sensor = TactileSensor(load_sensor("densetact2"), indenter=load_indenter(indenter))
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
    return {
        "indenter": indenter,
        "frames": frame_count,
        "gel": quantiles_ms([sum(parts[name] for name in GEL_PARTS) for parts in spent]),
        "optics": quantiles_ms([sum(parts[name] for name in OPTICS_PARTS) for parts in spent]),
        "total": quantiles_ms(total_s),
        **{
            name: quantiles_ms([parts[name] for parts in spent])
            for name in (*GEL_PARTS, *OPTICS_PARTS)
        },
        "frames_per_second": round(1.0 / float(np.mean(total_s)), 2),
        "max_penetration_um": round(1e6 * penetration_m, 2),
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
    parser.add_argument("--case-frames", type=int, default=200, help="frames an indenter (200)")
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    arguments = parser.parse_args()

    from dotsim_ros.gel.explicit import explicit_seconds_per_frame

    node = measure_node(arguments.seconds, arguments.rate_hz)
    latency_s = node.pop("latency_s")
    cases = [measure_sensor(name, 25.0, arguments.case_frames) for name in CASES]
    explicit_s = explicit_seconds_per_frame(
        spacing_m=EXPLICIT_SPACING_M,
        substeps_per_frame=EXPLICIT_SUBSTEPS,
        frame_count=EXPLICIT_FRAMES,
    )
    latency = quantiles_ms(latency_s)
    figures = {
        "frames_per_second": node["frames_per_second"],
        "latency_p50_ms": latency["p50_ms"],
        "latency_p99_ms": latency["p99_ms"],
        "gel_p95_ms": float(node["node"].get("gel_p95_ms", "nan")),
        "optics_p95_ms": float(node["node"].get("optics_p95_ms", "nan")),
        "explicit_ratio": round(explicit_s * cases[0]["frames_per_second"], 1),
        "explicit_frames_per_second": round(1.0 / explicit_s, 3),
        "node": node,
        "cases": cases,
        "provenance": provenance(),
    }
    print_table(figures)
    if arguments.json:
        write_json(arguments.json, figures)


def print_table(figures: dict[str, Any]) -> None:
    """Print what was measured."""
    node = figures["node"]
    print(f"\n{figures['provenance']['machine']}, commit {figures['provenance']['commit']}")
    print(
        f"node over DDS: {figures['frames_per_second']:.2f} frames/s at {node['rate_hz']:g} Hz, "
        f"latency {figures['latency_p50_ms']:.1f} ms median, {figures['latency_p99_ms']:.1f} ms "
        f"p99, {node['node'].get('dropped', '?')} dropped, ready after {node['start_up_s']} s"
    )
    parts = ("contact", "solve", "depth", "image", "publish", "gel", "optics")
    shares = ", ".join(f"{part} {node['node'].get(part + '_p95_ms', '?')}" for part in parts)
    print(f"in the node, p95 ms: {shares}")
    print(
        f"{'sensor alone':<14}{'gel p50':>9}{'p95':>8}{'optics p50':>12}{'p95':>8}{'frames/s':>10}"
    )
    for case in figures["cases"]:
        print(
            f"{case['indenter']:<14}{case['gel']['p50_ms']:9.1f}{case['gel']['p95_ms']:8.1f}"
            f"{case['optics']['p50_ms']:12.1f}{case['optics']['p95_ms']:8.1f}"
            f"{case['frames_per_second']:10.1f}"
        )
    print(
        f"explicit reference: {figures['explicit_frames_per_second']:.2f} frames/s; the sensor "
        f"makes {figures['explicit_ratio']:.1f} times as many"
    )


if __name__ == "__main__":
    main()
