# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Memory and lost frames of the node over a long run in lockstep, at 25 poses a second.

Every pose must come back as one Image with its stamp. Memory is the node's resident set, sampled
once a second; its growth is the last tenth of the run against the second tenth (the first one
fills caches).
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.qos import HistoryPolicy, QoSProfile
from sensor_msgs.msg import Image

import msg_adapters
from dotsim_ros.data.scripted import Site, press_hold_release
from studies.run import FAILED
from studies.speed.running_node import PosePublisher, observing_node, running_sensors
from studies.timing import percentiles_ms

RATE_HZ = 25.0
DISCOVERY_TIMEOUT_S = 30.0
LAST_FRAME_TIMEOUT_S = 10.0
# The publisher keeps five images for a slow reader.
MOST_IN_FLIGHT = 4
LARGEST_GROWTH = 0.02
SHORTEST_MINUTES = 0.1


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


def soak(*, minutes: float = 30.0) -> dict[str, Any]:
    """Memory and lost frames of the node over a long run in lockstep.

    Args:
        minutes: how long.
    """
    if minutes < SHORTEST_MINUTES:
        raise ValueError(
            f"minutes is {minutes:g}, expected {SHORTEST_MINUTES:g} or more: memory is sampled "
            "once a second"
        )
    waiting: dict[int, float] = {}
    latency_s: list[float] = []
    memory: list[int] = []
    press = press_hold_release(Site(), depth_m=0.002, hold_s=0.2)
    count = int(60.0 * minutes * RATE_HZ)

    def on_image(message: Image) -> None:
        sent_s = waiting.pop(msg_adapters.message_stamp_ns(message), None)
        if sent_s is not None:
            latency_s.append(time.monotonic() - sent_s)

    with (
        running_sensors({"clock": "lockstep"}) as (process,),
        observing_node("soak") as (node, executor),
    ):
        node.create_subscription(Image, "image_raw", on_image, 5)
        publisher = PosePublisher(node, quality=QoSProfile(history=HistoryPolicy.KEEP_ALL))
        given_up_s = time.monotonic() + DISCOVERY_TIMEOUT_S
        while not publisher.has_reader():
            executor.spin_once(timeout_sec=0.1)
            if time.monotonic() > given_up_s:
                raise OSError(
                    "the poses have no subscriber: the node is ready, but not found; check "
                    "ROS_DOMAIN_ID and the network settings of both"
                )
        time.sleep(1.0)
        begun_s = time.monotonic()
        for index in range(count):
            due_s = begun_s + index / RATE_HZ
            given_up_s = max(due_s, time.monotonic()) + LAST_FRAME_TIMEOUT_S
            while time.monotonic() < due_s or len(waiting) >= MOST_IN_FLIGHT:
                executor.spin_once(timeout_sec=max(0.0, min(0.02, due_s - time.monotonic())))
                if time.monotonic() > given_up_s:
                    break
            sent_s = time.monotonic()
            waiting[publisher.send(press.at(index / RATE_HZ % press.duration_s))] = sent_s
            if index % int(RATE_HZ) == 0:
                memory.append(resident_bytes(process.pid))
        end_s = time.monotonic() + LAST_FRAME_TIMEOUT_S
        while waiting and time.monotonic() < end_s:
            executor.spin_once(timeout_sec=0.1)
        elapsed_s = time.monotonic() - begun_s
    status, grown = process.stop(), growth(memory)
    faults = {
        f"{len(waiting)} frames lost": bool(waiting),
        f"memory grew by {grown:.1%}": grown > LARGEST_GROWTH,
        f"the node ended with status {status}": status != 0,
    }
    return {
        "minutes": round(elapsed_s / 60.0, 2),
        "poses": count,
        "frames": len(latency_s),
        "lost": len(waiting),
        "frames_per_second": round(len(latency_s) / elapsed_s, 2),
        "latency_p99_ms": percentiles_ms(latency_s)["p99_ms"] if latency_s else None,
        "memory_mib": [round(sample / 2**20, 1) for sample in memory[:: max(1, len(memory) // 60)]],
        "memory_growth": round(grown, 5),
        "exit_status": status,
        FAILED: [fault for fault, is_met in faults.items() if is_met],
    }
