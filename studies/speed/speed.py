# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The figures of speed in one record, of the studies that take them in full.

The node over DDS and the sensor alone for each indenter are measured as in realtime.py, a batch as
in batch.py, the environment as in environments.py; the loop is `dotsim_ros demo-loop`, once in
real time and once in simulated time. Where there is a CUDA device, many sensors are simulated
there together, as in many_on_device.py; with `--device cuda` nothing else is measured, and
`--device cpu --worlds 1 2` is that run's rehearsal.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

from dotsim_ros.cli.main import main as run_command
from dotsim_ros.control.policy.rollout import APPROACH_S
from dotsim_ros.io.warp_runtime import wp
from dotsim_ros.specification import load_sensor
from studies.run import FAILED, expect_positive
from studies.speed.batch import batch
from studies.speed.device_check import explicit_ms
from studies.speed.environments import steps_per_second
from studies.speed.many_on_device import on_device
from studies.speed.realtime import (
    CASES,
    EXPLICIT_FRAMES,
    FRAME_RATE_HZ,
    LEARNED_SENSOR,
    headroom,
    measure_node,
    measure_sensor,
    speedup,
)
from studies.timing import percentiles_ms

SENSOR = "densetact2"
CUDA = "cuda"
BATCH_SIZE = 64


def node_figures(sensor: str, seconds: float) -> dict[str, float]:
    """Return rate and latency of the running node."""
    node = measure_node(seconds, FRAME_RATE_HZ, sensor)
    latency = percentiles_ms(node["latency_s"])
    return {
        "frames_per_second": node["frames_per_second"],
        "latency_p50_ms": latency["p50_ms"],
        "latency_p99_ms": latency["p99_ms"],
    }


def demo_loop(clock: str, laps: float) -> dict[str, Any]:
    """Return the report of `dotsim_ros demo-loop`.

    Raises:
        OSError: it does not end well.
    """
    with tempfile.TemporaryDirectory() as folder:
        options = ["--out", folder, "--clock", clock, "--laps", str(laps)]
        if status := run_command(["demo-loop", *options]):
            raise OSError(f"dotsim_ros demo-loop --clock {clock} ended with status {status}")
        report: dict[str, Any] = json.loads((Path(folder) / "report.json").read_text("utf-8"))
    return report


def loop_figures(laps: float) -> dict[str, float | None]:
    """Return rate and stops of the closed loop in real time, None where it ended within the
    approach to the path, and how fast simulated time goes."""
    report = demo_loop("realtime", laps)
    led_s = report["seconds"] + APPROACH_S if "seconds" in report else None
    return {
        "frames_per_second": report["frames_per_second"],
        "stops_per_minute": led_s and round(60.0 * sum(report["stops"].values()) / led_s, 2),
        "simulated_seconds_per_second": demo_loop("simulated", laps)["speed_factor"],
    }


def only_device(device: str, worlds: tuple[int, ...], seconds: float) -> dict[str, Any]:
    """Return the figures of a device under its kind, cpu or cuda."""
    figures = on_device(device, load_sensor(SENSOR), worlds, seconds)
    return {FAILED: figures.pop(FAILED), device.partition(":")[0]: figures}


def speed(
    *,
    seconds: float = 60.0,
    case_frames: int = 200,
    steps: int = 200,
    laps: float = 2.0,
    device: str = "",
    worlds: tuple[int, ...] = (1, 64, 1024, 4096),
    device_seconds: float = 450.0,
) -> dict[str, Any]:
    """Frames a second of node, gel, environment and loop, in one record.

    Args:
        seconds: that each node is under load.
        case_frames: frames of each indenter.
        steps: of the environment.
        laps: of the loop, in real time and in simulated time.
        device: the only thing to measure, by torch's name; none: all, a CUDA device too if there.
        worlds: numbers of sensors that a device simulates together.
        device_seconds: that it takes at most.
    """
    expect_positive(
        seconds=seconds,
        case_frames=case_frames,
        steps=steps,
        laps=laps,
        fewest_worlds=min(worlds),
        device_seconds=device_seconds,
    )
    if device:
        return only_device(device, worlds, device_seconds)
    explicit_frame_ms = explicit_ms("cpu", EXPLICIT_FRAMES)
    cases = {name: measure_sensor(SENSOR, name, case_frames) for name in CASES}
    learned = measure_sensor(LEARNED_SENSOR, CASES[0], case_frames)
    figures: dict[str, Any] = {
        **node_figures(SENSOR, seconds),
        "headroom": headroom(cases[CASES[0]], FRAME_RATE_HZ),
        "explicit_ms": round(explicit_frame_ms, 1),
        "cases": {
            name: {
                "gel_p50_ms": case["gel_p50_ms"],
                "gel_p95_ms": case["gel_p95_ms"],
                "speedup": speedup(case, explicit_frame_ms),
            }
            for name, case in cases.items()
        },
        "learned": {
            **node_figures(LEARNED_SENSOR, seconds),
            "headroom": headroom(learned, FRAME_RATE_HZ),
        },
        "batch": {"count": BATCH_SIZE, **batch(counts=(BATCH_SIZE,))[str(BATCH_SIZE)]},
        "environments_steps_per_second": round(steps_per_second(1, steps), 1),
        "loop": loop_figures(laps),
    }
    if wp.is_cuda_available():
        figures |= only_device(CUDA, worlds, device_seconds)
    return figures
