# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A known weight in a data set: its entry in the index, its reading, and the scale of the gauge."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from gap_findings import named, no_gap

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.data.known_weight import ForceScale, combined_scale, read_weight
from dotsim_ros.data.trajectory import Trajectory, WrenchChannel, write_trajectory
from dotsim_ros.effects.library import load_effects
from dotsim_ros.effects.overlay import active_effects
from dotsim_ros.gap.findings import Verdict, as_record, findings_of
from dotsim_ros.gap.presses.search_state import GapRequest
from dotsim_ros.gap.presses.weighed import is_wrong, weighed_scale, with_scale
from dotsim_ros.gap.report.page import report_files
from dotsim_ros.specification import load_sensor

GRAVITY = 9.80665


def write_weight(bag: Path, force_n: np.ndarray) -> None:
    stamp_ns = 1_000_000_000 + 50_000_000 * np.arange(len(force_n))
    wrench = WrenchChannel(stamp_ns, force_n, np.zeros_like(force_n))
    write_trajectory(bag, Trajectory(wrench=wrench))


def data_set_with(directory: Path, *weights: object, **index: object) -> Path:
    (directory / "bags" / "press").mkdir(parents=True, exist_ok=True)
    content = {"trajectories": [{"bag": "bags/press"}], "weights": list(weights), **index}
    (directory / "dataset.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    return directory


def set_down(known_n: float, scale: float, *, noise_n: float = 0.01) -> np.ndarray:
    """Return forces (N, 3) of a gauge, with an offset, on which a weight is set down."""
    random = np.random.default_rng(3)
    share = np.concatenate([np.zeros(40), np.linspace(0.0, 1.0, 6), np.ones(60)])
    direction = np.array([0.0, 0.6, -0.8])
    offset = np.array([0.02, -0.01, 0.05])
    return (
        scale * known_n * share[:, None] * direction
        + offset
        + noise_n * random.standard_normal((len(share), 3))
    )


def test_a_weight_gives_the_scale_of_the_gauge(tmp_path):
    write_weight(tmp_path / "bags" / "weight_0", set_down(0.1 * GRAVITY, 0.8))
    write_weight(tmp_path / "bags" / "weight_1", np.tile([0.0, 0.0, -4.0], (20, 1)))
    data = data_set_with(
        tmp_path,
        {"bag": "bags/weight_0", "mass_kg": 0.1},
        {"bag": "bags/weight_1", "known_force_n": 5.0, "tolerance": 0.02},
    )
    first, second = read_data_set(data).weights
    assert first.known_force_n == pytest.approx(0.1 * GRAVITY)
    scale = read_weight(first)
    # Offset, noise and the frames in which it is set down leave no more than the weight's own.
    assert scale.scale == pytest.approx(0.8, abs=0.004)
    assert 0.8 * 0.005 < scale.deviation < 0.8 * 0.008
    # One that rests all the time, on a gauge that was tared before.
    resting = read_weight(second)
    assert (resting.scale, resting.deviation) == pytest.approx((0.8, 0.8 * 0.02))
    both = combined_scale([scale, resting])
    assert both.names == ("weight_0", "weight_1")
    assert both.deviation < scale.deviation


def test_weights_that_disagree_are_less_certain():
    agreeing = combined_scale([ForceScale(s, 0.01, ("w",)) for s in (0.99, 1.0, 1.01)])
    apart = combined_scale([ForceScale(s, 0.01, ("w",)) for s in (0.9, 1.0, 1.1)])
    assert agreeing.deviation == pytest.approx(0.01 / np.sqrt(3.0))
    # Ten deviations apart: the standard error of the three themselves.
    assert apart.deviation == pytest.approx(0.1 / np.sqrt(3.0))
    ratio = ForceScale(0.8, 0.008, ("now",)).over(ForceScale(1.25, 0.0, ("before",)))
    assert (ratio.scale, ratio.deviation) == pytest.approx((0.64, 0.0064))


def test_an_entry_that_says_no_weight_is_refused(tmp_path):
    for weight, told in (
        ({"bag": "bags/none", "mass_kg": 0.1}, "weight 0: there is no bag"),
        ({"bag": "bags/press"}, "expected either 'mass_kg' or 'known_force_n', got neither"),
        ({"bag": "bags/press", "mass_kg": 0.1, "known_force_n": 1.0}, "mass_kg and known_force_n"),
        ({"bag": "bags/press", "mass_kg": -0.1}, "mass_kg is -0.1, expected a number above 0"),
        ("bags/press", "expected a mapping with the key 'bag'"),
    ):
        with pytest.raises((ValueError, FileNotFoundError), match=told):
            read_data_set(data_set_with(tmp_path, weight))
    with pytest.raises(ValueError, match="expected a list of bags"):
        read_data_set(data_set_with(tmp_path, **{"weights": "bags/press"}))


def test_a_reading_of_no_weight_is_refused(tmp_path):
    bag = tmp_path / "bags" / "weight"
    write_weight(bag, set_down(1.0, 1.0))
    grams = read_data_set(data_set_with(tmp_path, {"bag": "bags/weight", "mass_kg": 100.0}))
    with pytest.raises(ValueError, match="mass_kg, which is in kilograms"):
        read_weight(grams.weights[0])
    short = tmp_path / "bags" / "short"
    write_weight(short, np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    known = read_data_set(data_set_with(tmp_path, {"bag": "bags/short", "known_force_n": 1.0}))
    with pytest.raises(ValueError, match="1 frames under the weight, expected 5 at least"):
        read_weight(known.weights[0])


@pytest.mark.parametrize("presses", [no_gap, named])
def test_a_wrong_scale_is_named_beside_what_the_presses_show(presses):
    library = load_effects()
    scale = ForceScale(0.8, 0.004, ("weight_0",))
    found, overlay = with_scale(presses(), None, scale, library["force_scale"])
    assert found.verdict is Verdict.NAMED
    assert found.named == (*presses().named, "force_scale")
    assert findings_of(as_record(found)) == found
    (active,) = active_effects(overlay, library)
    assert active.values == {"scale": 0.8}
    assert "by the known weight (weight_0): scale = 0.8 [0.792, 0.808]" in found.sentence
    text = report_files(replace(found, worst=None, places=(), gaps=()), {}, library)[
        "report.md"
    ].decode()
    assert "Another scale of the force (force_scale), added" in text
    assert found.sentence.endswith(presses().sentence)


def test_the_scale_since_the_commissioning_takes_a_weight_in_both(tmp_path):
    for name, scale in (("before", 1.25), ("now", 1.0)):
        write_weight(tmp_path / name / "bags" / "weight", set_down(2.0, scale))
        data_set_with(tmp_path / name, {"bag": "bags/weight", "known_force_n": 2.0})
    data_set_with(tmp_path / "none")
    request = GapRequest(tmp_path / "now", load_sensor("sensor_a"), tmp_path)
    alone, _ = weighed_scale(request)
    since, _ = weighed_scale(replace(request, reference=tmp_path / "before"))
    assert alone is not None
    assert not is_wrong(alone)
    assert is_wrong(since)
    assert since.scale == pytest.approx(0.8, abs=0.01)
    nothing, (told,) = weighed_scale(replace(request, reference=tmp_path / "none"))
    assert nothing is None
    assert "the commissioning has none" in told
    assert weighed_scale(replace(request, channels=("skin",))) == (None, [])
    assert weighed_scale(replace(request, measured=tmp_path / "none")) == (None, [])
