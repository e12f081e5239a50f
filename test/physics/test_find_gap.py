"""The whole search on small hidden cases: a null, an effect of the library, and one of none.

Three trajectories of a unit of `sensor_a` and four candidates, and hidden effects that act on the
force alone, so that all cases share their solves: what CI can afford. The blind study (`dotsim_ros
evaluate gap`) is the same code on all of it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dotsim_ros.gap.findings import Findings, Verdict
from dotsim_ros.gap.overlay import Overlay
from dotsim_ros.gap.search import Request, find_gap
from dotsim_ros.geometry.specification import load_sensor
from dotsim_ros.hidden.laws import LAWS
from dotsim_ros.hidden.reality import Truth
from dotsim_ros.hidden.unit import measure_unit
from dotsim_ros.sensor import skin_of

PROTOCOLS = ("press_sphere_4mm_0", "press_sphere_4mm_1", "slide_0")
CANDIDATES = ("coulomb_slip", "force_scale", "force_drift", "thermal_drift")
SEED = 11


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the solves: the cases have the same poses, so they share them."""
    return tmp_path_factory.mktemp("run")


def searched(
    tmp_path: Path, run: Path, *effects: tuple[str, float]
) -> tuple[Findings, Overlay | None]:
    sensor = load_sensor("sensor_a")
    data = tmp_path / "measured"
    measure_unit(data, sensor, skin_of(sensor.gel), Truth(effects), seed=SEED, only=PROTOCOLS)
    (data / "truth.json").write_text("{}", encoding="utf-8")
    steps: list[str] = []
    found = find_gap(
        Request(
            measured=data,
            sensor=sensor,
            directory=run,
            indenters=data / "indenters",
            candidates=CANDIDATES,
            seed=1,
        ),
        lambda step, done, total: steps.append(step),
    )
    assert "nulls" in steps
    return found


def test_a_unit_with_nothing_wrong_has_no_gap(tmp_path: Path, run: Path) -> None:
    findings, overlay = searched(tmp_path, run)
    assert findings.verdict is Verdict.NO_GAP
    assert overlay is None
    assert findings.sentence.startswith("No gap")
    assert any("truth.json lies in the data set: it was not read" in w for w in findings.warnings)
    assert any("no hold in the data" in w for w in findings.warnings)


def test_a_force_gauge_that_reads_too_much_is_named_and_closes_the_gap(
    tmp_path: Path, run: Path
) -> None:
    size = 0.35
    findings, overlay = searched(tmp_path, run, ("scaled_force", size))
    assert LAWS["scaled_force"].library == "force_scale"
    assert findings.named == ("force_scale",)
    assert findings.verdict in (Verdict.NAMED, Verdict.SET)
    estimate = next(c for c in findings.candidates if c.name == "force_scale").estimates[0]
    assert estimate.value == pytest.approx(1.0 + size, rel=0.15)
    assert estimate.low <= estimate.value <= estimate.high
    assert findings.share_closed is not None
    assert findings.share_closed > 0.7
    for gap in findings.gaps:
        assert gap.after <= 1.02 * gap.recalibrated
    assert overlay is not None
    assert overlay.effects[0].name == "force_scale"


def test_crosstalk_that_no_effect_imitates_is_unknown(tmp_path: Path, run: Path) -> None:
    findings, overlay = searched(tmp_path, run, ("crosstalk", 0.35))
    assert findings.verdict is Verdict.UNKNOWN
    assert overlay is None
    assert findings.named == ()
    worst = max((p for p in findings.places if p.trajectory == "all"), key=lambda p: p.before)
    assert worst.channel == "force"
    assert np.isfinite(worst.before)
