# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The whole search on small hidden cases: a null, an effect of the library, and one of none.

Two trajectories of a unit of `sensor_a` with a coarse skin, three candidates, and hidden effects
that act on the force alone, so that all cases share their solves: what CI can afford. The blind
study (`python -m studies gap`) is the same code on all of it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from dotsim_ros.data.trajectory import Trajectory, WrenchChannel, write_trajectory
from dotsim_ros.effects.overlay import Overlay
from dotsim_ros.gap.findings import Findings, Verdict
from dotsim_ros.gap.presses.search import read_measurements, search_presses
from dotsim_ros.gap.presses.search_state import GapRequest
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.specification import load_sensor
from studies.hidden.laws import LAWS
from studies.hidden.reality import Truth
from studies.hidden.unit import measure_unit

PROTOCOLS = ("hold_0", "slide_0")
CANDIDATES = ("force_drift", "mullins_softening", "permanent_set")
WEIGHABLE = ("force_scale", *CANDIDATES)
SKIN_SPACING_M = 2.0e-3
COARSE_M = 4.8e-3
SEED = 11


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the solves: the cases have the same poses, so they share them."""
    return tmp_path_factory.mktemp("run")


# A refined gel needs tables for each skin and Poisson's ratio: minutes.
SENSOR = load_sensor("sensor_a")
SENSOR = replace(SENSOR, solver=replace(SENSOR.solver, refined=False, grid_spacing_m=COARSE_M))


def measured(folder: Path, *effects: tuple[str, float]) -> Path:
    """Measure a unit with hidden effects and their sizes; return its data set."""
    data = folder / "measured"
    skin = dome_skin(SENSOR.gel.outer_radius_m, SKIN_SPACING_M)
    measure_unit(data, SENSOR, skin, Truth(effects), seed=SEED, only=PROTOCOLS)
    (data / "truth.json").write_text("{}", encoding="utf-8")
    return data


def searched(
    data: Path, run: Path, candidates: tuple[str, ...] = CANDIDATES
) -> tuple[Findings, Overlay | None]:
    """Search a data set for some effects, with solves in the folder of a run."""
    told: list[tuple[str, int, int]] = []
    request = GapRequest(
        measured=data,
        sensor=SENSOR,
        directory=run,
        indenters=data / "indenters",
        candidates=candidates,
        seed=1,
        workers=1,
    )
    found = search_presses(request, *read_measurements(request), lambda *one: told.append(one))
    assert "nulls" in {step for step, _, _ in told}
    solves = [(done, total) for step, done, total in told if step == "solve"]
    # The time left is right from the first solve on only if all of them are foreseen.
    assert solves[0][1] == pytest.approx(solves[-1][1], abs=8)
    assert solves[-1][0] == solves[-1][1]
    return found


def weigh(data: Path, scale: float) -> None:
    """Record a mass of 200 g, that a gauge with noise reads at a scale."""
    random = np.random.default_rng(SEED)
    force_n = 0.015 * random.standard_normal((80, 3))
    force_n[30:, 2] += scale * 0.2 * 9.80665
    stamp_ns = 1_000_000_000 + 50_000_000 * np.arange(80)
    wrench = WrenchChannel(stamp_ns, force_n, np.zeros_like(force_n))
    write_trajectory(data / "bags" / "weight_0", Trajectory(wrench=wrench))
    index = yaml.safe_load((data / "dataset.yaml").read_text(encoding="utf-8"))
    index["weights"] = [{"bag": "bags/weight_0", "mass_kg": 0.2}]
    (data / "dataset.yaml").write_text(yaml.safe_dump(index), encoding="utf-8")


def test_a_force_scale_of_four_fifths_is_named_by_a_known_weight_alone(
    tmp_path: Path, run: Path
) -> None:
    data = measured(tmp_path, ("scaled_force", -0.2))
    # The stiffness may be as wrong.
    without, overlay = searched(data, run, WEIGHABLE)
    assert "force_scale" not in without.named
    assert overlay is None
    weigh(data, 0.8)
    findings, overlay = searched(data, run, WEIGHABLE)
    assert findings.verdict is Verdict.NAMED
    assert findings.named == ("force_scale",)
    assert "by the known weight (weight_0): scale = 0.8" in findings.sentence
    assert overlay is not None
    (estimate,) = overlay.effects[0].parameters
    assert (estimate.low, estimate.high) == pytest.approx((0.792, 0.808), abs=0.004)
    assert estimate.low <= 0.8 <= estimate.high


def test_a_unit_with_nothing_wrong_has_no_gap(tmp_path: Path, run: Path) -> None:
    data = measured(tmp_path)
    # A gauge that reads the weight as it is leaves the forces alone.
    weigh(data, 1.0)
    findings, overlay = searched(data, run, WEIGHABLE)
    assert findings.verdict is Verdict.NO_GAP
    assert overlay is None
    assert findings.sentence.startswith("No gap")
    assert any("truth.json lies in the data set: it was not read" in w for w in findings.warnings)
    assert any("no reference" in w for w in findings.warnings)


def test_a_gel_that_softens_is_named_and_closes_the_gap(tmp_path: Path, run: Path) -> None:
    findings, overlay = searched(measured(tmp_path, ("softened", 0.34)), run)
    assert LAWS["softened"].library == "mullins_softening"
    assert findings.named == ("mullins_softening",)
    assert findings.verdict is Verdict.NAMED
    estimate = next(c for c in findings.candidates if c.name == "mullins_softening").estimates[0]
    assert estimate.low <= estimate.value <= estimate.high
    assert findings.share_closed is not None
    assert findings.share_closed > 0.5
    for gap in findings.gaps:
        assert gap.after <= 1.02 * gap.recalibrated
    assert overlay is not None
    assert overlay.effects[0].name == "mullins_softening"


def test_crosstalk_that_no_effect_imitates_is_unknown(tmp_path: Path, run: Path) -> None:
    findings, overlay = searched(measured(tmp_path, ("crosstalk", 0.5)), run)
    assert findings.verdict is Verdict.UNKNOWN
    assert overlay is None
    assert findings.named == ()
    worst = max((p for p in findings.places if p.trajectory == "all"), key=lambda p: p.before)
    assert worst.channel == "force"
    assert np.isfinite(worst.before)
