# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How often the gap finder is right about images of an independent renderer.

A path tracer (Mitsuba 3, `studies.hidden.path_traced`) renders the skins of a measured data
set: a commissioning, from which the finder learns what its images show where nothing is
missing, and later sets of other trajectories, of which some hide an effect in the scene or in the
camera. The twin has the gel of a sensor's file, the camera and the LEDs as the scene has them, and
no network.
Each set's truth is sealed next to it, its hash printed first, and opened after the finder's answer.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.gap.find import find_gap_with_images
from dotsim_ros.gap.findings import Findings
from dotsim_ros.gap.images.find import fit_noise_of_images
from dotsim_ros.gap.images.null import OpticalNull, save_optical_null
from dotsim_ros.gap.presses.search import read_measurements
from dotsim_ros.gap.presses.search_state import GapRequest
from dotsim_ros.io.progress import PrintedProgress
from dotsim_ros.optics.idle_check import read_idle_images
from dotsim_ros.specification import CameraSpecification, SensorSpecification, load_sensor
from studies.data import SENSOR_A
from studies.hidden.path_traced import (
    LED_AZIMUTH_DEG,
    LED_HEIGHT_M,
    LED_RING_M,
    LED_SPREAD_DEG,
    open_mitsuba,
)
from studies.hidden.reality import Truth, write_truth
from studies.hidden.rendered_laws import LAWS
from studies.hidden.rendered_unit import LEAK, Studio
from studies.run import expect_positive

ALPHA = 0.02
NULLS = 4
COMMISSIONING = 12
TRAJECTORIES, FRAMES = 5, 3
"""Trajectories of a later set, and frames of a trajectory."""


@dataclass(frozen=True)
class Plan:
    """One set.

    Attributes:
        name: of its folder, which does not reveal what is hidden.
        trajectories: of the measured data set.
        truth: what is hidden.
        seed: of its samples and noise.
    """

    name: str
    trajectories: tuple[str, ...]
    truth: Truth
    seed: int


def plans(names: Sequence[str], seed: int) -> tuple[Plan, list[Plan]]:
    """Return the commissioning and the later sets, in an order drawn by the seed."""
    random = np.random.default_rng(seed)
    drawn = random.permutation(np.array(names)).tolist()
    first, others = sorted(drawn[:COMMISSIONING]), drawn[COMMISSIONING:]
    truths = [Truth(())] * NULLS
    truths += [Truth(((law.name, size),)) for law in LAWS.values() for size in law.sizes]
    later = []
    for number, place in enumerate(random.permutation(len(truths)).tolist()):
        chosen = tuple(sorted(random.choice(others, TRAJECTORIES, replace=False).tolist()))
        later.append(Plan(f"set_{number:02d}", chosen, truths[place], 1000 + number))
    return Plan("commissioning", tuple(first), Truth(()), 999), later


def render(studio: Studio, plan: Plan, directory: Path) -> None:
    """Write the data set of a plan, its truth sealed next to it."""
    print(f"{plan.name}: truth {plan.truth.digest()}", flush=True)
    unit = studio.unit
    for name, size in plan.truth.effects:
        unit = LAWS[name].change(unit, size, studio.white)
    directory.mkdir(parents=True, exist_ok=True)
    write_truth(directory / f"{plan.name}.truth.json", plan.truth)
    studio.measure(directory / plan.name, plan.trajectories, unit, frames=FRAMES, seed=plan.seed)


def twin(sensor: SensorSpecification, commissioning: Path, directory: Path) -> SensorSpecification:
    """Return the unit's twin: the gel of a sensor, the camera and the LEDs of the scene, and the
    idle image of the commissioning."""
    images = read_idle_images(read_data_set(commissioning).idle_images())
    mean = np.rint(images.mean(axis=0)).astype(np.uint8)
    idle = directory / "twin_idle.png"
    cv2.imwrite(str(idle), cv2.cvtColor(mean, cv2.COLOR_RGB2BGR))
    lighting = {
        "radius_m": LED_RING_M,
        "height_m": LED_HEIGHT_M,
        "azimuth_deg": list(LED_AZIMUTH_DEG),
        "spread_deg": LED_SPREAD_DEG,
        "crosstalk": LEAK,
    }
    idle.with_suffix(".yaml").write_text(yaml.safe_dump({"lighting": lighting}), encoding="utf-8")
    camera = CameraSpecification(idle_image=str(idle.resolve()))
    return replace(sensor, name="path_traced", camera=camera)


def judged(findings: Findings, directory: Path, plan: Plan) -> dict[str, Any]:
    """Return what the finder made of a set, its truth opened."""
    sealed = json.loads((directory / f"{plan.name}.truth.json").read_text(encoding="utf-8"))
    truth = Truth(tuple((str(name), float(size)) for name, size in sealed["effects"]))
    if truth.digest() != plan.truth.digest():
        raise ValueError(f"the truth of {plan.name} is another than was sealed")
    seen = findings.optical
    verdict, named = findings.verdict.value, list(findings.named)
    alternatives = list(findings.alternatives)
    right = {name for law, _ in truth.effects for name in LAWS[law].library}
    if not truth.effects:
        outcome = "right" if verdict == "no_gap" else "false alarm"
    elif verdict == "no_gap":
        outcome = "missed"
    elif verdict == "unknown":
        outcome = "unknown" if right else "right"
    elif verdict == "unusable":
        outcome = "refused"
    elif right & {*named, *alternatives}:
        outcome = "right" if verdict == "named" and set(named) <= right else "in the set"
    else:
        outcome = "wrong name"
    found = {
        "set": plan.name,
        "hidden": [[name, size, LAWS[name].unit] for name, size in truth.effects],
        "library": sorted(right),
        "trajectories": list(plan.trajectories),
        "truth_sha256": truth.digest(),
        "verdict": verdict,
        "named": named,
        "alternatives": alternatives,
        "outcome": outcome,
    }
    if seen is None or seen.verdict.value == "unusable":
        return {**found, "reason": findings.sentence}
    return {
        **found,
        "statistic": seen.statistic,
        "threshold": seen.threshold,
        "explained": seen.explained,
        "excess": seen.excess,
        "largest_excess": seen.largest_excess,
        "share_closed": seen.share_closed,
        "stability": seen.stability,
        "nearest": [c.name for c in seen.candidates[:3]],
        "estimates": {
            one.name: {e.name: [e.value, e.low, e.high] for e in one.estimates}
            for one in seen.candidates
            if one.name in named
        },
    }


def noise_figures(null: OpticalNull) -> dict[str, Any]:
    """Return what the images of the commissioning show where nothing is missing."""
    return {
        "camera_levels": float(np.sqrt(np.mean(null.noise.camera[:, :3] ** 2))),
        "model_levels": float(np.sqrt(np.mean(null.noise.model[:, :3] ** 2))),
        "growth": null.noise.growth.tolist(),
        "excess": null.excess.tolist(),
        "largest_excess": null.largest_excess(ALPHA),
    }


def gap_rendered(
    *,
    data: Path = SENSOR_A,
    sensor: str = "sensor_a",
    run: Path = Path("out/gap_rendered"),
    seed: int = 2,
    samples: int = 12,
) -> dict[str, Any]:
    """How often the gap finder is right about images of an independent renderer.

    Args:
        data: measured data set with skins.
        sensor: whose gel the twin has.
        run: folder of the data sets.
        seed: of trajectories and order.
        samples: rays a pixel and colour.
    """
    expect_positive(samples=samples)
    begun_s = time.monotonic()
    source = read_data_set(data)
    mitsuba = open_mitsuba()
    studio = Studio(source, mitsuba, sample_count=samples)
    first, later = plans([entry.name for entry in source.entries], seed)
    sets = run / "sets"
    for plan in (first, *later):
        render(studio, plan, sets)
    rendered_s = time.monotonic() - begun_s
    noise = run / "optical_noise.npz"
    # Solves are shared by all sets.
    request = GapRequest(
        sets / first.name,
        twin(load_sensor(sensor), sets / first.name, run),
        run,
        reference=sets / first.name,
        channels=("image",),
        alpha=ALPHA,
        workers=1,
        optical_noise=noise,
    )
    null = fit_noise_of_images(request, *read_measurements(request), PrintedProgress())
    save_optical_null(null, noise)
    progress, results = PrintedProgress(), []
    for number, plan in enumerate(later):
        progress("sets", number, len(later))
        findings, _ = find_gap_with_images(
            replace(request, measured=sets / plan.name), PrintedProgress()
        )
        results.append(judged(findings, sets, plan))
    outcomes = [one["outcome"] for one in results]
    return {
        "mitsuba": f"{mitsuba.__version__}, {mitsuba.variant()}",
        "pictures": f"{studio.width}x{studio.height}, {samples} rays a pixel and colour",
        "picture_count": sum(
            len(plan.trajectories) * FRAMES + len(read_data_set(sets / plan.name).idle_images())
            for plan in (first, *later)
        ),
        "commissioning": list(first.trajectories),
        "noise": noise_figures(null),
        "outcomes": {name: outcomes.count(name) for name in sorted(set(outcomes))},
        "sets": results,
        "render_seconds": rendered_s,
        "seconds": time.monotonic() - begun_s,
    }
