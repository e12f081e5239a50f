# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Memory and lost frames of the node over a long run in lockstep, at 25 poses a second.

python benchmarks/soak.py --minutes 30 --json soak.json

Every pose must come back as one Image with its stamp. Memory is the node's resident set, sampled
once a second; its growth is the last tenth of the run against the second tenth (the first one
fills caches).
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import HistoryPolicy, QoSProfile
from sensor_msgs.msg import Image

import msg_adapters
from dotsim_ros.files import write_json
from dotsim_ros.measured.scripted import Site, press_hold_release
from dotsim_ros.nodes.common.processes import NodeProcess
from dotsim_ros.provenance import provenance

RATE_HZ = 25.0
START_TIMEOUT_S = 300.0
DISCOVERY_TIMEOUT_S = 30.0
LAST_FRAME_TIMEOUT_S = 10.0
# The publisher keeps five images for a slow reader.
MOST_IN_FLIGHT = 4
LARGEST_GROWTH = 0.02


def resident_bytes(pid: int) -> int:
    """Return the resident set of a process."""
    for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmRSS:"):
            return 1024 * int(line.split()[1])
    raise OSError(f"process {pid} has no resident set: it has ended")


def growth(samples: list[int]) -> float:
    """Return the relative growth from the second tenth of the samples to the last tenth."""
    tenth = max(1, len(samples) // 10)
    before, after = np.mean(samples[tenth : 2 * tenth]), np.mean(samples[-tenth:])
    return float(after / before - 1.0)


def soak(minutes: float) -> dict[str, Any]:
    """Run the node under presses and return what was counted.

    Raises:
        OSError: the node does not start, or ends.
    """
    process = NodeProcess("tactile_sim", {"clock": "lockstep"})
    try:
        process.wait_for_line("ready:", timeout_s=START_TIMEOUT_S)
        rclpy.init()
        node = rclpy.create_node("soak")
        waiting: dict[int, float] = {}
        latency_s: list[float] = []

        def on_image(message: Image) -> None:
            sent_s = waiting.pop(msg_adapters.message_stamp_ns(message), None)
            if sent_s is not None:
                latency_s.append(time.monotonic() - sent_s)

        node.create_subscription(Image, "image_raw", on_image, 5)
        publisher = node.create_publisher(
            PoseStamped, "indenter/pose", QoSProfile(history=HistoryPolicy.KEEP_ALL)
        )
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        given_up_s = time.monotonic() + DISCOVERY_TIMEOUT_S
        while publisher.get_subscription_count() == 0:
            executor.spin_once(timeout_sec=0.1)
            if time.monotonic() > given_up_s:
                raise OSError(
                    "the poses have no subscriber: the node is ready, but not found; check "
                    "ROS_DOMAIN_ID and the network settings of both"
                )
        time.sleep(1.0)

        press = press_hold_release(Site(), depth_m=0.002, hold_s=0.2)
        memory: list[int] = []
        begun_s = time.monotonic()
        count = int(60.0 * minutes * RATE_HZ)
        for index in range(count):
            due_s = begun_s + index / RATE_HZ
            given_up_s = max(due_s, time.monotonic()) + LAST_FRAME_TIMEOUT_S
            while time.monotonic() < due_s or len(waiting) >= MOST_IN_FLIGHT:
                executor.spin_once(timeout_sec=max(0.0, min(0.02, due_s - time.monotonic())))
                if time.monotonic() > given_up_s:
                    break
            pose = press.at(index / RATE_HZ % press.duration_s)
            stamp_ns = node.get_clock().now().nanoseconds
            waiting[stamp_ns] = time.monotonic()
            publisher.publish(
                msg_adapters.encode_pose_stamped(
                    pose.position_m,
                    pose.quaternion_xyzw,
                    stamp_ns=stamp_ns,
                    frame_id="densetact_base",
                )
            )
            if index % int(RATE_HZ) == 0:
                memory.append(resident_bytes(process.pid))
            if index % int(60 * RATE_HZ) == 0:
                print(
                    f"minute {index / (60 * RATE_HZ):.0f}: {memory[-1] / 2**20:.1f} MiB, "
                    f"{len(latency_s)} frames, {len(waiting)} waited for",
                    flush=True,
                )
        end_s = time.monotonic() + LAST_FRAME_TIMEOUT_S
        while waiting and time.monotonic() < end_s:
            executor.spin_once(timeout_sec=0.1)
        elapsed_s = time.monotonic() - begun_s
        node.destroy_node()
        rclpy.try_shutdown()
    finally:
        status = process.stop()
    return {
        "minutes": round(elapsed_s / 60.0, 2),
        "poses": count,
        "frames": len(latency_s),
        "lost": len(waiting),
        "frames_per_second": round(len(latency_s) / elapsed_s, 2),
        "latency_p99_ms": round(1e3 * float(np.percentile(latency_s, 99)), 1),
        "memory_mib": [round(sample / 2**20, 1) for sample in memory[:: max(1, len(memory) // 60)]],
        "memory_growth": round(growth(memory), 5),
        "exit_status": status,
        "provenance": provenance(),
    }


def main() -> int:
    """Run, print, write; return 1 where memory grew or a frame was lost."""
    parser = argparse.ArgumentParser(
        description="Memory and lost frames of the node over a long run in lockstep.",
        epilog="example: python benchmarks/soak.py --minutes 30 --json soak.json",
    )
    parser.add_argument("--minutes", type=float, default=30.0, help="how long (30)")
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    arguments = parser.parse_args()
    figures = soak(arguments.minutes)
    if arguments.json:
        write_json(arguments.json, figures)
    print(
        f"{figures['frames']} of {figures['poses']} frames in {figures['minutes']} min, "
        f"{figures['lost']} lost, memory {100 * figures['memory_growth']:+.2f} %, exit status "
        f"{figures['exit_status']}"
    )
    is_good = (
        figures["lost"] == 0
        and figures["memory_growth"] <= LARGEST_GROWTH
        and figures["exit_status"] == 0
    )
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
