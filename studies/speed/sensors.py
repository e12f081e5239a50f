# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frames a second of each shipped sensor, and what is left of a frame's time.

The sensor alone, without ROS: a ball of 4 mm radius presses at 5 mm/s into the middle of the skin,
to 30 % of the gel's thickness but 2 mm at most, and slides 4 mm there and back at 10 mm/s, in
frames of 40 ms, again and again. Gel and image are computed one after the other; `tactile_sim` does
the image in a second thread. Two rows each: the sensor's own solver (`exact`), and that of the
profile `realtime`. Headroom is the share of 40 ms that a frame leaves on average, negative where it
takes longer. The processor's time is that of all threads together: next to other work, frames wait
for the processor, but hardly take more of it.
"""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import cycle, islice
from typing import Any

from dotsim_ros.io.files import shipped_names
from dotsim_ros.nodes.tactile_sim.active_profile import ladder_of
from dotsim_ros.nodes.tactile_sim.profiles import EXACT, REALTIME
from dotsim_ros.sensor import FRAME_S
from dotsim_ros.specification import SensorSpecification, load_sensor
from dotsim_ros.view.sensors import motion, warm_sensor
from studies.run import expect_positive
from studies.timing import percentiles_ms

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
        times_s = [sum(times[part] for part in parts) for times in spent]
        found = percentiles_ms(times_s, (50, 95))
        figures |= {f"{name}_{key}": value for key, value in found.items()}
    return figures


def sensors(*, names: tuple[str, ...] = (), frames: int = 200) -> dict[str, Any]:
    """Frames a second of each shipped sensor, and what is left of a frame's time.

    Args:
        names: of the sensors, or files; all that are shipped where none is given.
        frames: of each.
    """
    expect_positive(frames=frames)
    found: dict[str, Any] = {}
    for name in names or shipped_names("sensors"):
        own = load_sensor(name)
        for profile in (EXACT, REALTIME):
            solver = ladder_of(profile.name, own)[0].solver
            found.setdefault(name, {})[profile.name] = measure(replace(own, solver=solver), frames)
    return {"sensors": found}
