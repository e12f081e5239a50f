# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The figures of speed in one record, of the studies that take them in full.

The node over DDS, the sensor alone for each indenter, and a batch are measured as in realtime.py,
the environment as in environments.py; the loop is `dotsim_ros demo-loop`, once in real time and
once in simulated time. On a CUDA device the gels of many worlds are solved together.
"""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import Any

from dotsim_ros.cli.main import main as run_command
from dotsim_ros.control.policy.rollout import APPROACH_S
from dotsim_ros.gel.make import make_gel_batch
from dotsim_ros.io.warp_runtime import wp
from dotsim_ros.specification import load_sensor
from studies.run import expect_positive
from studies.speed.device_check import explicit_ms
from studies.speed.environments import steps_per_second
from studies.speed.realtime import (
    BATCH_SIZE,
    CASES,
    EXPLICIT_FRAMES,
    FRAME_RATE_HZ,
    LEARNED_SENSOR,
    headroom,
    measure_batch,
    measure_node,
    measure_sensor,
    motion_under_load,
    shape_of,
    speedup,
)
from studies.timing import percentiles_ms

SENSOR = "densetact2"
DEVICE = "cuda:0"
LONGEST_S = 20.0
"""After which no further frame of many worlds is begun."""


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


def gel_frames_per_second(count: int, frame_count: int) -> float:
    """Return the frames a second of the gels of many worlds, together, on the CUDA device."""
    gel = make_gel_batch(
        load_sensor(SENSOR),
        indenter=shape_of(CASES[0]),
        environment_count=count,
        device=DEVICE,
    )
    motion = motion_under_load()
    done, begun_s = -1, 0.0
    while done < 1 or (done < frame_count and time.perf_counter() - begun_s < LONGEST_S):
        # The first frame compiles the kernels.
        if done == 0:
            begun_s = time.perf_counter()
        pose = motion.at(max(done, 0) / FRAME_RATE_HZ % motion.duration_s)
        gel.step([pose] * count, 1.0 / FRAME_RATE_HZ)
        done += 1
    return round(count * done / (time.perf_counter() - begun_s), 1)


def speed(
    *,
    seconds: float = 60.0,
    case_frames: int = 200,
    steps: int = 200,
    laps: float = 2.0,
    worlds: tuple[int, ...] = (1, 64, 1024),
    cuda_frames: int = 10,
) -> dict[str, Any]:
    """Frames a second of node, gel, environment and loop, in one record.

    Args:
        seconds: that each node is under load.
        case_frames: frames of each indenter.
        steps: of the environment.
        laps: of the loop, in real time and in simulated time.
        worlds: numbers of gels that are solved together, where there is a CUDA device.
        cuda_frames: frames of each number of worlds.
    """
    expect_positive(
        seconds=seconds,
        case_frames=case_frames,
        steps=steps,
        laps=laps,
        fewest_worlds=min(worlds),
        cuda_frames=cuda_frames,
    )
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
        "batch": {
            "count": BATCH_SIZE,
            "cost_ratio": measure_batch(SENSOR, CASES[0], case_frames)["cost_ratio"],
        },
        "environments_steps_per_second": round(steps_per_second(1, steps), 1),
        "loop": loop_figures(laps),
    }
    if wp.is_cuda_available():
        figures["cuda"] = {
            "device": wp.get_device(DEVICE).name,
            **{
                str(count): {"gel_frames_per_second": gel_frames_per_second(count, cuda_frames)}
                for count in worlds
            },
        }
    return figures
