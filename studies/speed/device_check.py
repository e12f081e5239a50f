# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Does a device compute what the CPU computes? Every kernel that can run there, in one command.

The shipped sensor and a coarse one whose gel relaxes press and slide, their images are drawn, the
loss of a press is differentiated, and a few frames of the explicit method are run, on the CPU and
on the device. The largest difference of each result is a share of its own range. A
result of a single precision sum may differ in another order of its terms, and a few colours be
rounded to the next grey level; more is a fault. Kernels of the package that the device did not run
are listed: some work on a CPU by design.
Frames of the shipped sensor and of the explicit method are timed on both, in one run.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.gel.adjoint.backward import trajectory_gradient
from dotsim_ros.gel.adjoint.gradient import LossGradient
from dotsim_ros.gel.adjoint.recorder import Recorder
from dotsim_ros.gel.body import Dome
from dotsim_ros.gel.explicit.gel import (
    PAPER_FRAME_S,
    ExplicitGel,
    ExplicitSettings,
    explicit_seconds_per_frame,
)
from dotsim_ros.gel.make import make_gel_batch
from dotsim_ros.gel.material import NeoHookean
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.io.warp_runtime import wp
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import SensorSpecification, load_sensor
from studies.run import FAILED, expect_known

TOLERANCE = 2e-3
RADIUS_M, SPACING_M, SKIN_M = 0.01575, 4.8e-3, 1.0e-3
WAYS_M = ((0.0, 0.001), (0.0, -0.0008), (0.0, -0.0014), (0.0006, -0.0014))
"""Of the ball's tip: aside, and above the apex."""
FRAME_S, PRESS_SPEED_M_S = 0.04, 0.005
WARM_FRAMES = 5
"""Before the clock starts."""
Results = dict[str, NDArray[Any]]


def poses() -> list[Pose]:
    """Return a press and a slide."""
    return [Pose(np.array([x, 0.0, RADIUS_M + above])) for x, above in WAYS_M]


def coarse(**material: Any) -> SensorSpecification:
    """Return the shipped sensor with a coarse gel, skin and camera."""
    own = load_sensor("densetact2")
    return replace(
        own,
        gel=replace(own.gel, skin_spacing_m=SKIN_M),
        material=replace(own.material, **material),
        solver=replace(own.solver, grid_spacing_m=SPACING_M, refined=False),
    )


def sensor_results(device: str) -> Results:
    """Return what a coarse, relaxing sensor publishes at the end of a slide."""
    return published(coarse(prony_shares=(0.2,), prony_times_s=(0.5,)), device)


def shipped_results(device: str) -> Results:
    """Return what the shipped sensor publishes at the end of a slide."""
    return published(load_sensor("densetact2"), device)


def published(specification: SensorSpecification, device: str) -> Results:
    """Return what a sensor publishes at the end of a slide."""
    sensor = TactileSensor(specification, indenter=sphere(0.004), device=device)
    for pose in poses():
        frame = sensor.step(pose, 0.04)
    return {
        "skin, m": frame.skin_position_m,
        "force, N": frame.wrench.force_n,
        "depth, m": np.nan_to_num(frame.depth_m),
        "normals": np.nan_to_num(frame.normal),
        "image": frame.image.astype(np.float64),
    }


def gradient_results(device: str) -> Results:
    """Return the derivatives of the last normal force."""
    specification = coarse()
    gel = make_gel_batch(specification, indenter=sphere(0.004), environment_count=1, device=device)
    recorder = Recorder(gel)
    none = np.zeros_like(gel.skin.rest_position_m)
    losses = []
    for pose in poses():
        recorder.step([pose], 0.04)
        losses.append(LossGradient(none, np.zeros(3), np.zeros(3)))
    losses[-1] = LossGradient(none, np.array([0.0, 0.0, 1.0]), np.zeros(3))
    found = trajectory_gradient(gel, recorder.trajectories[0], losses)
    return {
        "dF/d(law)": np.array(list(found.by_law(gel.material.law).values())),
        "dF/d(friction)": np.array([found.friction_coefficient]),
    }


def explicit_results(device: str) -> Results:
    """Return the skin after two frames of the explicit method."""
    gel = ExplicitGel(
        Dome(RADIUS_M, 0.006),
        dome_skin(RADIUS_M, SKIN_M),
        material=NeoHookean(27_575.0, 0.303),
        density_kg_m3=1070.0,
        friction_coefficient=0.4,
        indenter=sphere(0.004),
        settings=ExplicitSettings(spacing_m=2.4e-3, substeps_per_frame=100, softness=30.0),
        device=device,
    )
    for depth_m in (0.0, 2e-4, 4e-4):
        state = gel.step(Pose(np.array([0.0, 0.0, RADIUS_M - depth_m])), PAPER_FRAME_S)
    return {"skin, m": state.skin_position_m, "force, N": state.force_n}


CASES: dict[str, Callable[[str], Results]] = {
    "sensor": sensor_results,
    "shipped": shipped_results,
    "adjoint": gradient_results,
    "explicit": explicit_results,
}


def shipped_ms(device: str, frame_count: int) -> float:
    """Return the median time of a frame of the shipped sensor, pressed at 5 mm/s."""
    sensor = TactileSensor(load_sensor("densetact2"), indenter=sphere(0.004), device=device)
    spent_s = []
    for number in range(-WARM_FRAMES, frame_count):
        depth_m = PRESS_SPEED_M_S * FRAME_S * number
        begun_s = time.perf_counter()
        sensor.step(Pose(np.array([0.0, 0.0, RADIUS_M - depth_m])), FRAME_S)
        spent_s.append(time.perf_counter() - begun_s)
    return 1e3 * float(np.median(spent_s[WARM_FRAMES:]))


def explicit_ms(device: str, frame_count: int) -> float:
    """Return the mean time of a frame of the explicit method, at the paper's settings."""
    return 1e3 * explicit_seconds_per_frame(
        spacing_m=1.2e-3, substeps_per_frame=100, frame_count=frame_count, device=device
    )


TIMED: dict[str, Callable[[str, int], float]] = {"shipped": shipped_ms, "explicit": explicit_ms}


@contextmanager
def noted_launches(ran: set[str], device: str) -> Iterator[None]:
    """Note the kernels that are launched on a device, or recorded to be."""
    launch = wp.launch

    def noted(kernel: Any, *arguments: Any, **named: Any) -> Any:
        if wp.get_device(named.get("device")) == wp.get_device(device):
            ran.add(f"{kernel.func.__module__}.{kernel.func.__name__}")
        return launch(kernel, *arguments, **named)

    wp.launch = noted
    try:
        yield
    finally:
        wp.launch = launch


def difference(found: NDArray[Any], expected: NDArray[Any]) -> float:
    """Return the largest difference as a share of the range of what is expected."""
    if found.shape != expected.shape or not np.all(np.isfinite(found)):
        return float("inf")
    size = float(np.abs(expected).max(initial=0.0)) or 1.0
    return float(np.abs(found - expected).max(initial=0.0)) / size


def is_same(result: str, found: NDArray[Any], expected: NDArray[Any]) -> bool:
    """Return whether a result is the CPU's; a few colours of an image may be a grey level off."""
    share = difference(found, expected)
    if result != "image" or not np.isfinite(share):
        return share <= TOLERANCE
    off = np.abs(found - expected)
    return bool(off.max() <= 1.0 and off.mean() <= TOLERANCE * expected.max())


def device_check(
    *, device: str = "cuda:0", cases: tuple[str, ...] = tuple(CASES), timed: int = 20
) -> dict[str, Any]:
    """Whether a device computes what the CPU computes, and how fast.

    Args:
        device: to check against the CPU, by its name in Warp.
        cases: of sensor, shipped, adjoint, explicit.
        timed: frames to time on both; 0 for none.
    """
    expect_known("device", [device], map(str, wp.get_devices()))
    expect_known("case", cases, CASES)
    rows: list[dict[str, Any]] = []
    on_cpu: set[str] = set()
    ran: set[str] = set()
    for case in cases:
        with noted_launches(on_cpu, "cpu"):
            expected = CASES[case]("cpu")
        try:
            with noted_launches(ran, device):
                found = CASES[case](device)
        except Exception as error:
            rows.append({"case": case, "failed": f"{type(error).__name__}: {error}"})
            continue
        rows += [
            {
                "case": case,
                "result": name,
                "difference": difference(found[name], values),
                "is_right": is_same(name, found[name], values),
            }
            for name, values in expected.items()
        ]
    broken = {row["case"] for row in rows if "failed" in row}
    return {
        "device": device,
        "device_name": wp.get_device(device).name,
        "rows": rows,
        "ran": sorted(ran),
        "not_run": sorted(on_cpu - ran),
        "frame_ms": {
            case: {name: TIMED[case](name, timed) for name in ("cpu", device)}
            for case in sorted(TIMED.keys() & set(cases) - broken)
            if timed > 0
        },
        FAILED: [
            row.get("failed", f"{row['case']}: {row.get('result')} differs")
            for row in rows
            if not row.get("is_right", False)
        ],
    }
