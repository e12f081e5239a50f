# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Data sets of touches: what a touch holds, what is drawn, and what an ended run leaves."""

from __future__ import annotations

import io
import json
import shutil
import tarfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from dotsim_ros.cli.main import main
from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.geometry.pose import Wrench
from dotsim_ros.io.files import parameter_path
from dotsim_ros.learning.touches.formats import BagFormat, LeRobotFormat, arrays_of
from dotsim_ros.learning.touches.making import CONTACT_M, Touch, TouchMaker
from dotsim_ros.learning.touches.plan import KINDS, TouchPlan, plan_of, read_plan
from dotsim_ros.learning.touches.sheet import thumbnail_of

FIELD_PX = 40
SENSOR = {
    "gel": {"shape": "flat_pad", "pad_size_m": [0.02, 0.016, 0.004], "skin_spacing_m": 1e-3},
    "material": {"youngs_modulus_pa": 3e5, "poisson_ratio": 0.45},
    "contact": {"friction_coefficient": 0.5},
    "solver": {"grid_spacing_m": 2e-3, "refined": False},
    "camera": {
        "width": 80,
        "height": 60,
        "position_m": [0.0, 0.0, -0.012],
        "half_height_angle_deg": 25.0,
        "principal_point_px": [39.5, 29.5],
        "idle_image": "",
    },
    "markers": {"columns": 4, "rows": 3, "spacing_m": [0.003, 0.003]},
}


def _document(folder: Path, **changes: Any) -> dict[str, Any]:
    """Return a plan on a small pad, of one round indenter."""
    (folder / "pad.yaml").write_text(yaml.safe_dump(SENSOR))
    shipped = yaml.safe_load(parameter_path("touches/default.yaml").read_text())
    small = {
        "sensor": str(folder / "pad.yaml"),
        "indenters": ["sphere(radius_m=0.003)"],
        "image_side_px": 80,
        "frames": 8,
        "touches_a_gel": 2,
    }
    return {**shipped, **small, **changes}


def _plan(folder: Path, **changes: Any) -> TouchPlan:
    return plan_of(_document(folder, **changes), "plan")


def _forces(wrenches: Sequence[Wrench]) -> np.ndarray:
    return np.array([wrench.force_n for wrench in wrenches])


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "grasp"])
def test_a_touch_begins_in_the_air_and_presses(tmp_path: Path, kind: str) -> None:
    maker = TouchMaker(_plan(tmp_path, touches={kind: 1}), 3, FIELD_PX)
    touch = maker.touch(0)
    (side,) = touch.sides
    arrays, force = side.arrays, _forces(side.solved.wrenches)
    assert touch.kind == kind
    assert not force[0].any()
    assert not arrays["contact"][0].any()
    assert arrays["slip"][0] == 0.0
    np.testing.assert_allclose(arrays["difference"][0], 127, atol=10)
    pressed = 8 - 8 // 2 - 1
    assert force[pressed, 2] > 0.05
    assert arrays["contact"][pressed].sum() > 3
    assert np.all(arrays["depth"][pressed][arrays["contact"][pressed]] > 0.0)
    # What touches is the part of the skin that the indenter moves most.
    nearest = arrays["depth"][0] - arrays["depth"][pressed]
    assert nearest[arrays["contact"][pressed]].min() > np.median(nearest)
    if kind == "press":
        assert not force[-1].any()
    if kind == "slide":
        assert arrays["slip"][-1] > 0.8
        assert np.linalg.norm(force[-1, :2]) > 5.0 * np.linalg.norm(force[pressed, :2])
        mu = touch.constants["gel.friction"]
        # The ball also pushes the gel before it.
        assert mu <= np.linalg.norm(force[-1, :2]) / force[-1, 2] < 1.4 * mu
        assert np.abs(arrays["markers"][-1, :, :2]).max() > 1e-4
    if kind == "roll":
        assert arrays["slip"][-1] < 0.5


def test_both_sides_of_a_grasped_ball_are_pressed_alike(tmp_path: Path) -> None:
    touch = TouchMaker(_plan(tmp_path, touches={"grasp": 1}), 0, FIELD_PX).touch(0)
    left, right = (_forces(side.solved.wrenches) for side in touch.sides)
    assert left[-1, 2] > 0.05
    # The second sensor is turned by half a turn about x.
    np.testing.assert_allclose(right[-1] * [1, -1, -1], left[-1] * [1, 1, -1], atol=0.03)
    assert {key for key in arrays_of(touch) if "images" in key} == {
        f"observation.images.{side}{what}"
        for side in ("left", "right")
        for what in ("", "_difference")
    }


def test_a_touch_depends_on_its_number_alone(tmp_path: Path) -> None:
    gel = {"thickness_m": {"low": 0.9, "high": 1.1, "unit": "of own"}}
    plan = _plan(tmp_path, gel=gel)
    one, other = TouchMaker(plan, 5, FIELD_PX), TouchMaker(plan, 5, FIELD_PX)
    made = [one.touch(number) for number in range(4)]
    again = other.touch(3)
    assert again.constants == made[3].constants
    for key, values in arrays_of(again).items():
        np.testing.assert_array_equal(values, arrays_of(made[3])[key])
    drawn = [touch.constants["gel.thickness_m"] for touch in made]
    assert drawn[0] == drawn[1] != drawn[2] == drawn[3]
    assert len({touch.constants["pose.depth"] for touch in made}) == 4


def test_stiffness_scales_the_force_and_contact_is_where_the_indenter_is(tmp_path: Path) -> None:
    def touch(factor: float) -> Touch:
        gel = {"youngs_modulus_pa": {"low": factor, "high": factor, "unit": "of own"}}
        return TouchMaker(_plan(tmp_path, gel=gel), 1, FIELD_PX).touch(0)

    soft, stiff = touch(1.0), touch(2.0)
    np.testing.assert_allclose(
        _forces(stiff.sides[0].solved.wrenches), 2.0 * _forces(soft.sides[0].solved.wrenches)
    )
    solved = soft.sides[0].solved
    deepest = soft.sides[0].strongest
    skin, pose = solved.skin_position_m[deepest], solved.poses[deepest]
    assert soft.indenter.distance_from(skin, pose).min() < CONTACT_M
    assert thumbnail_of(soft).shape[2] == 3


def test_a_run_that_was_ended_goes_on_to_the_same_data(tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text(yaml.safe_dump(_document(tmp_path)))
    made = ["dataset", "--plan", str(plan), "--touches", "5", "--format", "webdataset"]
    whole, ended = tmp_path / "whole", tmp_path / "ended"
    assert main([*made, "--out", str(whole), "--workers", "2"]) == 0
    shutil.copytree(whole, ended)
    (ended / "touches-000001.tar").unlink()
    (ended / ".part.killed").mkdir()
    (ended / "touches-000002.tar").rename(ended / ".part.killed" / "touches-000002.tar")
    (ended / "contact_sheet.jpg").unlink()
    assert main([*made, "--out", str(ended), "--workers", "1"]) == 0
    for name in ("contact_sheet.jpg", *(f"touches-{k:06d}.tar" for k in range(3))):
        assert (ended / name).read_bytes() == (whole / name).read_bytes()
    assert not (ended / ".part.killed").exists()
    with tarfile.open(whole / "touches-000002.tar") as archive:
        names = archive.getnames()
        npz = archive.extractfile("000004_0007.npz")
        assert npz is not None
        wrench = np.load(io.BytesIO(npz.read()))["observation.tactile.wrench"]
    assert len(names) == 8 * 4
    assert {name.split(".", 1)[1] for name in names} == {
        *("gel.png", "gel_difference.png", "npz", "json")
    }
    assert wrench.shape == (6,)


def test_another_plan_in_the_same_folder_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    card = tmp_path / "out" / "touches.json"
    card.parent.mkdir()
    card.write_text(json.dumps({"version": 1, "seed": 1}))
    arguments = ["dataset", "--out", str(card.parent), "--format", "webdataset"]
    assert main(arguments) == 1
    assert "holds touches of another plan and number" in capsys.readouterr().err
    card.write_text(json.dumps({"version": 0}))
    assert main(arguments) == 1
    assert "is of the version 0, expected 1" in capsys.readouterr().err


def _with(folder: Path, *path: str, value: Any) -> dict[str, Any]:
    document = _document(folder)
    inner = document
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return document


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        (
            ("pose", "slide", "low"),
            0.01,
            "pose.slide is upside down: low is 0.01 and high is 0.003",
        ),
        (("pose", "slide", "unit"), "mm", "pose.slide has the unit 'mm', expected 'm'"),
        (("gel", "friction", "unit"), "", None),
        (("gel", "youngs_modulus_pa", "high"), 1e6, "which is 3e+11, expected 1000 to 1e+08 Pa"),
        (("gel", "frction"), {}, "did you mean 'friction'"),
        (("colour",), 1, "unknown entry 'colour'"),
        (("version",), 2, "is a plan of version 2, expected 1"),
        (("effects", "backlash"), {}, "expected effects on gel or image"),
        (("touches", "grasp"), 1, "make a data set of each"),
        (("contents",), ["sound"], "contents has 'sound'"),
        (("image_side_px",), [80, 80], "image_side_px is [80, 80], expected a number from 16"),
    ],
)
def test_a_plan_that_is_wrong_is_refused_in_one_line(
    tmp_path: Path, path: tuple[str, ...], value: Any, reason: str | None
) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text(yaml.safe_dump(_with(tmp_path, *path, value=value)))
    if reason is None:
        read_plan(plan)
        return
    with pytest.raises(ValueError, match="plan") as raised:
        read_plan(plan)
    assert reason in str(raised.value)
    assert "\n" not in str(raised.value)


def test_an_open_mesh_of_a_folder_is_refused(tmp_path: Path) -> None:
    import trimesh

    folder = tmp_path / "meshes"
    folder.mkdir()
    mesh = trimesh.creation.box((0.004, 0.004, 0.004))
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    mesh.export(folder / "open.stl")
    with pytest.raises(ValueError, match=r"open\.stl: the mesh is not closed"):
        _plan(tmp_path, indenters=[str(folder)])


def test_bags_hold_the_touches(tmp_path: Path) -> None:
    plan = _plan(tmp_path)
    maker, written = TouchMaker(plan, 0, FIELD_PX), BagFormat(tmp_path / "bags", plan)
    touches = [maker.touch(number) for number in range(2)]
    assert not written.holds(0)
    written.add(0, touches)
    assert written.holds(0)
    (first, _) = read_data_set(tmp_path / "bags").entries
    read = first.read()
    assert read.wrench is not None
    np.testing.assert_allclose(
        read.wrench.force_n, _forces(touches[0].sides[0].solved.wrenches), atol=1e-6
    )


def test_a_lerobot_data_set_holds_every_array_and_what_was_drawn(tmp_path: Path) -> None:
    for package in ("pyarrow", "av"):
        pytest.importorskip(package, reason="needs the extra dataset: pip install '.[dataset]'")
    import pyarrow.parquet as parquet

    plan = _plan(tmp_path)
    maker, folder = TouchMaker(plan, 0, FIELD_PX), tmp_path / "set"
    touches = [maker.touch(number) for number in range(2)]
    LeRobotFormat(folder, plan).add(0, touches)
    assert LeRobotFormat(folder, plan).holds(0)
    assert not LeRobotFormat(folder, plan).holds(1)
    rows = parquet.read_table(folder / "data/chunk-000/file-000.parquet").to_pylist()
    assert len(rows) == 16
    features = json.loads((folder / "meta/info.json").read_text())["features"]
    for number, touch in enumerate(touches):
        arrays = arrays_of(touch)
        last = rows[8 * number + 7]
        for key, values in arrays.items():
            if features[key]["dtype"] != "video":
                np.testing.assert_allclose(last[key], values[7])
        drawn = dict(zip(features["constants"]["names"], last["constants"], strict=True))
        assert drawn == pytest.approx(dict(touch.constants), rel=1e-6)
