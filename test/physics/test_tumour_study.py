# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tumour detection in small: presses are solved, learnt from and judged, and none twice."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from dotsim_ros import load_sensor
from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import Float32Array
from studies.tumour import pictures, presses, reality, study
from studies.tumour.images import OTHER, Eye, Light
from studies.tumour.layer_press import LayerPressSettings
from studies.tumour.presses import SolvedPress, coarse, skin_turns, turned_skins
from studies.tumour.rigid import rigid_presses
from studies.tumour.skins import CLASSES, SKINS, PressPlan
from studies.tumour.study import tumour

needs_calculix = pytest.mark.skipif(
    shutil.which("ccx") is None, reason="CalculiX is not installed: apt-get install calculix-ccx"
)


@pytest.fixture(scope="module")
def skin() -> SkinMesh:
    return skin_of(coarse(load_sensor("densetact2")).gel)


def detect(folder: Path, **given: Any) -> dict[str, Any]:
    few = {"presses": 2, "judged": 1, "shifted": 0, "classifiers": 1, "epochs": 1}
    return tumour(**{**few, "images": folder / "images", "cache": folder / "kept", **given})


@needs_calculix
def test_presses_are_judged_and_not_solved_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = LayerPressSettings(gel_spacing_m=4.5e-3, layer_spacing_m=3.5e-3)
    monkeypatch.setattr(reality, "CALCULIX", (quick,))
    monkeypatch.setattr(presses, "MARKERS_M", 2.0e-3)
    monkeypatch.setattr(presses, "GRID_M", 4.8e-3)
    # A layer on a coarse grid, too.
    skins = SKINS | {"skin_2": replace(SKINS["skin_2"], spacing_m=3.0e-3, cells=2)}
    for module in (study, pictures):
        monkeypatch.setattr(module, "SKINS", skins)
    found = detect(tmp_path, skins=("skin_2",))
    assert set(found) == {"skin_2", "study", "calculix"}
    rows = found["skin_2"]
    for name in ("ours", "rigid", "load"):
        # Two presses, of each two depths and three turns.
        assert (rows[name]["presses"], rows[name]["images"]) == (2, 12)
        told_right = np.trace(rows[name]["confusion"]) / np.sum(rows[name]["confusion"])
        assert rows[name]["accuracy"] == pytest.approx(told_right)
    assert rows["chance"]["accuracy"] == 0.5
    assert rows["learnt_presses"] + rows["refused_presses"] == 4
    assert rows["difference"]["force_error"] < 0.15
    assert rows["difference"]["skin_rms_mm"] < 0.2 * rows["difference"]["moved_rms_mm"]
    assert found["calculix"] != ""
    with Image.open(tmp_path / "images" / "tumour.png") as picture:
        assert picture.size == (4 * 320, 240 + 120)
    kept = {p: p.stat().st_mtime_ns for p in (tmp_path / "kept").rglob("*.*") if p.is_file()}
    # Presses to learn from, CalculiX's, our own of these, and the skin's rows.
    assert len(kept) == 4 + 2 + 2 + 1
    assert detect(tmp_path, skins=("skin_2",))["skin_2"] == rows
    assert {path: path.stat().st_mtime_ns for path in kept} == kept


def test_only_the_sign_of_the_insert_tells_the_classes() -> None:
    drawn = PressPlan().drawn(400, 0)
    assert [press.label for press in drawn[:4]] == [1, 0, 1, 0]
    parts = [[press for press in drawn if press.label == label] for label in range(len(CLASSES))]
    for value in (
        lambda press: press.depths_m[-1],
        lambda press: abs(press.insert.height_m),
        lambda press: press.insert.radius_m,
        lambda press: press.tilt_rad,
    ):
        values = [np.array([value(press) for press in part]) for part in parts]
        error = np.hypot(*(part.std() / np.sqrt(len(part)) for part in values))
        assert abs(values[0].mean() - values[1].mean()) < 4.0 * error
    assert PressPlan().drawn(3, 0) == drawn[:6]
    assert PressPlan().drawn(3, 1) != drawn[:6]
    with pytest.raises(ValueError, match="expected positive ones that grow to 1"):
        PressPlan(shares=(1.0, 0.5))


def test_a_press_touches_the_skin_however_it_is_tilted() -> None:
    layer = SKINS["skin_1"]
    for press in PressPlan().drawn(3, 0):
        pose = press.pose(layer, 15.75e-3, 0.0)
        assert pose.apply([0.0, 0.0, layer.thickness_m]) == pytest.approx(
            -15.75e-3 * pose.rotation()[:, 2]
        )
        assert np.arccos(-pose.rotation()[2, 2]) == pytest.approx(press.tilt_rad, abs=1e-6)
    for press in PressPlan().drawn(3, 0, in_plane=True):
        assert np.abs(press.pose(layer, 15.75e-3, 1e-3).rotation()[1]) == pytest.approx([0, 1, 0])


def test_a_turned_press_is_the_press_from_another_side(skin: SkinMesh) -> None:
    (press, _) = PressPlan().drawn(1, 0)
    layer = SKINS["skin_1"]
    (straight,) = rigid_presses(skin, layer, 15.75e-3, [press], 2)
    turn = float(skin_turns(2)[1])
    aside = replace(press, azimuth_rad=press.azimuth_rad + turn)
    (turned,) = rigid_presses(skin, layer, 15.75e-3, [aside], 1)
    assert straight.skin_m[1] == pytest.approx(turned.skin_m[0], abs=2e-7)
    with pytest.raises(ValueError, match="6 turns of each press, expected 1 to 5"):
        turned_skins(skin, np.zeros((1, skin.vertex_count, 3), dtype=np.float32), 6)


def test_what_is_shown_is_how_the_image_moved(skin: SkinMesh) -> None:
    """Gel that is turned about the sensor's axis moves the image along circles."""
    eye = Eye(coarse(load_sensor("densetact2")), skin)
    rest = skin.rest_position_m.astype(np.float32)
    c, s = np.cos(0.02), np.sin(0.02)
    turned: Float32Array = (rest @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])).astype(np.float32)
    (press, _) = PressPlan(shares=(0.5, 1.0)).drawn(1, 0)
    solved = SolvedPress(press, np.stack([rest, turned])[None], np.zeros(2))
    for light in (Light(noise_levels=0.0), OTHER):
        seen, labels, numbers = eye.taken([solved], light, seed=0)
        assert labels.tolist() == [1, 1]
        assert numbers.tolist() == [0, 0]
        still, moved = seen
        row, column = np.mgrid[0:30, 0:40]
        away = np.stack([column - 19.5, row - 14.5])
        ring = (np.hypot(*away) > 5.0) & (np.hypot(*away) < 11.0)
        # From +x towards +y, the image's x towards its y: 0.02 rad of 8 pixels a cell, in halves.
        along = 0.02 * 8.0 / 0.5 * np.stack([-away[1], away[0]])
        assert np.abs(still[:2, ring]).mean() < 0.15
        assert (
            np.abs(moved[:2, ring] - along[:, ring]).mean() < 0.25 * np.abs(along[:, ring]).mean()
        )
