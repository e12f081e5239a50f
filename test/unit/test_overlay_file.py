# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The overlay of found effects: written, read, and refused in words."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from dotsim_ros import __version__
from dotsim_ros.effects.library import load_effects
from dotsim_ros.effects.overlay import (
    Estimate,
    FoundEffect,
    Overlay,
    active_effects,
    described,
    overlay_text,
    read_overlay,
)

LIBRARY = load_effects()
FOUND = Overlay(
    sensor="sensor_b",
    data_hash="0123456789abcdef",
    effects=(
        FoundEffect(
            "viscoelastic_relaxation",
            (Estimate("share", "", 0.19, 0.15, 0.23), Estimate("time_s", "s", 2.1, 1.4, 3.3)),
        ),
        FoundEffect("force_scale", (Estimate("scale", "", 1.1, 1.08, 1.12),)),
    ),
)


def found_record() -> dict:
    return yaml.safe_load(overlay_text(FOUND))


def test_an_overlay_comes_back_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "effects_overlay.yaml"
    path.write_text(overlay_text(FOUND))
    overlay = read_overlay(path)
    active = active_effects(overlay, LIBRARY)
    assert overlay == FOUND
    assert overlay.written_by == __version__
    assert [a.effect.name for a in active] == ["viscoelastic_relaxation", "force_scale"]
    assert dict(active[0].values) == {"share": 0.19, "time_s": 2.1}
    assert described(active) == (
        "viscoelastic_relaxation (share 0.19, time_s 2.1 s)",
        "force_scale (scale 1.1)",
    )


def test_an_overlay_that_would_be_refused_is_not_written() -> None:
    lost = FoundEffect("force_scale", (Estimate("scale", "", float("nan"), 1.0, 1.2),))
    with pytest.raises(ValueError, match=r"force_scale.scale: value is nan, expected a finite"):
        overlay_text(Overlay("sensor_b", "", (lost,)))


def scale_of(record: dict) -> dict:
    return record["effects"][1]["parameters"]["scale"]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda r: r.update(version=2), "overlay of version 2, this dotsim_ros reads 1"),
        (lambda r: r.pop("sensor"), "expected data_hash, dotsim_ros, effects, sensor, version"),
        (lambda r: r.update(effects="force_scale"), "effects is 'force_scale', expected a list"),
        (lambda r: r["effects"][1].pop("parameters"), "is no effect, expected its name and"),
        (lambda r: scale_of(r).update(value="big"), "scale: value is 'big', expected a number"),
        (lambda r: scale_of(r).update(value=1.15), "1.15 is not within its interval, 1.08 to 1.12"),
        (lambda r: r["effects"][1].update(name="ghost"), "unknown effect 'ghost'; known are adhe"),
        (
            lambda r: r["effects"][1].update(parameters={"gain": scale_of(r)}),
            "'force_scale' has no parameter 'gain'; it has scale",
        ),
        (lambda r: r["effects"][0]["parameters"].pop("time_s"), "lacks its parameter time_s"),
        (lambda r: scale_of(r).update(value=1.5, high=1.6), "scale is 1.5, expected 0.64 to 1.4"),
        (lambda r: r["effects"].append(r["effects"][1]), "'force_scale' stands there twice"),
    ],
)
def test_a_broken_overlay_says_what_is_wrong(tmp_path: Path, change, reason: str) -> None:
    path = tmp_path / "effects_overlay.yaml"
    record = found_record()
    change(record)
    path.write_text(yaml.safe_dump(record))
    with pytest.raises(ValueError, match=reason) as caught:
        active_effects(read_overlay(path), LIBRARY, place=str(path))
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a: [", "YAML"),
        ("- force_scale", "is no overlay of effects"),
    ],
)
def test_what_is_no_overlay_is_refused(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "effects_overlay.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=reason):
        read_overlay(path)
    with pytest.raises(FileNotFoundError, match=r"none.yaml; find_gap writes one"):
        read_overlay(tmp_path / "none.yaml")


@pytest.mark.fault("effects and overlays", "an overlay with an effect of a name of 5,000 letters")
def test_names_of_any_length_make_one_short_line(
    tmp_path: Path, answered: Callable[..., None]
) -> None:
    path = tmp_path / "effects_overlay.yaml"
    effects = [{"name": 5000 * "x", "parameters": {"a\nb": {}}}]
    record = {"version": 1, "dotsim_ros": "0", "sensor": "s", "data_hash": "0", "effects": effects}
    path.write_text(yaml.safe_dump(record))
    with pytest.raises(ValueError, match="expected unit, value, low, high") as refused:
        read_overlay(path)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 600
    answered(refused.value)
