# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frames a second of each shipped sensor, and what is left of a frame's time.

python benchmarks/sensors.py --json sensors.json

The sensor alone, without ROS: a ball of 4 mm radius presses at 5 mm/s into the middle of the skin,
to 30 % of the gel's thickness but 2 mm at most, and slides 4 mm there and back at 10 mm/s, in
frames of 40 ms, again and again. Gel and image are computed one after the other; `tactile_sim` does
the image in a second thread. Two rows each: the sensor's own solver (`exact`), and that of the
profile `realtime`. Headroom is the share of 40 ms that a frame leaves on average, negative where it
takes longer. The processor's time is that of all threads together: beside other work, frames wait
for the processor, but hardly take more of it.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.files import shipped_names, write_json
from dotsim_ros.nodes.tactile_sim.profile_in_force import ladder_of
from dotsim_ros.nodes.tactile_sim.profiles import EXACT, REALTIME
from dotsim_ros.provenance import provenance
from dotsim_ros.sensor import FRAME_S
from dotsim_ros.specification import SensorSpecification, load_sensor
from dotsim_ros.view.frame_rate import motion, warm_sensor

GEL_PARTS, OPTICS_PARTS = ("contact", "solve"), ("depth", "image")


def measure(sensor: SensorSpecification, frame_count: int) -> dict[str, float]:
    """Return rate, headroom and times of a sensor's frames."""
    poses = motion(sensor)
    made = warm_sensor(sensor, poses)
    spent: list[dict[str, float]] = []
    unconverged = 0
    begun_s, worked_s = time.perf_counter(), time.process_time()
    for pose in islice(cycle(poses), frame_count):
        frame = made.step(pose)
        spent.append(frame.timings_s)
        unconverged += not frame.converged
    frame_s = (time.perf_counter() - begun_s) / frame_count
    processor_s = (time.process_time() - worked_s) / frame_count
    figures = {
        "frames_per_second": round(1.0 / frame_s, 1),
        "headroom": round(1.0 - frame_s / FRAME_S, 3),
        "processor_ms": round(1e3 * processor_s, 1),
        "unconverged_frames": unconverged,
    }
    for name, parts in (("gel", GEL_PARTS), ("optics", OPTICS_PARTS)):
        times_ms = [1e3 * sum(times[part] for part in parts) for times in spent]
        p50, p95 = np.percentile(times_ms, [50, 95]).round(1).tolist()
        figures |= {f"{name}_p50_ms": p50, f"{name}_p95_ms": p95}
    return figures


def main() -> None:
    """Measure, print the table, and write it as JSON where asked."""
    parser = argparse.ArgumentParser(
        description="Frames a second of each shipped sensor, and what is left of a frame's time.",
        epilog="example: python benchmarks/sensors.py digit gelslim --frames 200",
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="sensors (all that are shipped)")
    parser.add_argument("--frames", type=int, default=200, help="frames of each (200)")
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    arguments = parser.parse_args()
    print(
        f"{'sensor':<22}{'profile':<10}{'frames/s':>9}{'headroom':>10}{'processor ms':>14}"
        f"{'gel p50':>9}{'p95':>7}{'optics p50':>12}{'p95':>7}{'unconverged':>13}"
    )
    figures: dict[str, Any] = {}
    for name in arguments.names or shipped_names("sensors"):
        own = load_sensor(name)
        for profile in (EXACT, REALTIME):
            solver = ladder_of(profile.name, own)[0].solver
            found = measure(replace(own, solver=solver), arguments.frames)
            figures.setdefault(name, {})[profile.name] = found
            print(
                f"{name:<22}{profile.name:<10}{found['frames_per_second']:9.1f}"
                f"{100.0 * found['headroom']:8.0f} %"
                f"{found['processor_ms']:14.1f}{found['gel_p50_ms']:9.1f}"
                f"{found['gel_p95_ms']:7.1f}{found['optics_p50_ms']:12.1f}"
                f"{found['optics_p95_ms']:7.1f}{found['unconverged_frames']:13d}",
                flush=True,
            )
    if arguments.json:
        write_json(arguments.json, {"sensors": figures, "provenance": provenance()})


if __name__ == "__main__":
    main()
