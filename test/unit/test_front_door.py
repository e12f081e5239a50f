# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The public names of the package, and the first lines that a user writes."""

from __future__ import annotations

import importlib
import os
import pickle
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import BinaryIO

import cv2
import numpy as np
import pytest

import dotsim_ros
from dotsim_ros import (
    Pose,
    TactileSensor,
    load_indenter,
    load_sensor,
    make_gel_batch,
)
from dotsim_ros.io import progress
from dotsim_ros.io.moved import MOVED
from dotsim_ros.optics.picture import BACKGROUND, CHANGE_GAIN, TITLE_HEIGHT_PX
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import SolverSpecification

FOREVER = {
    "Frame",
    "Pose",
    "SensorSpecification",
    "TactileSensor",
    "calibrate",
    "find_gap",
    "load_indenter",
    "load_sensor",
    "read_data_set",
}
"""Names that scripts of others call."""
RADIUS_M = 0.01575


@pytest.fixture(scope="module")
def coarse():
    """A sensor whose gel is solved in milliseconds."""
    sensor = load_sensor("densetact2")
    return replace(
        sensor,
        gel=replace(sensor.gel, skin_spacing_m=1.5e-3),
        solver=SolverSpecification(grid_spacing_m=4.8e-3, refined=False),
        camera=replace(sensor.camera, width=160, height=120, principal_point_px=(79.5, 59.5)),
    )


@pytest.fixture(scope="module")
def frame(coarse):
    return TactileSensor.load(coarse).step(Pose.above_apex(depth_m=0.001, x_m=0.002))


def test_importing_the_package_loads_nothing_heavy_and_the_names_load_when_asked():
    code = """
import sys
import dotsim_ros
heavy = lambda: sorted({"warp", "torch", "rclpy", "numpy", "cv2"} & set(sys.modules))
print(heavy())
dotsim_ros.SensorSpecification, dotsim_ros.Pose, dotsim_ros.read_data_set
print(set(heavy()) & {"warp", "torch", "rclpy"})
dotsim_ros.calibrate
print("rclpy" in sys.modules, "torch" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-3:] == ["[]", "set()", "False False"]


def test_only_the_program_prints_and_a_first_load_says_what_it_computes(tmp_path):
    code = """
from dataclasses import replace
from dotsim_ros import Pose, TactileSensor, load_sensor
from dotsim_ros.specification import SolverSpecification
sensor = load_sensor("densetact2")
solver = SolverSpecification(grid_spacing_m=4.8e-3, refined=False)
sensor = replace(sensor, gel=replace(sensor.gel, skin_spacing_m=1.5e-3), solver=solver)
TactileSensor.load(sensor).step(Pose.above_apex(0.001))
print("done")
"""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == "done\n"
    # With an empty cache it says so before it compiles.
    environment = {**os.environ, "WARP_CACHE_PATH": str(tmp_path)}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment) as first:
        said = first.stderr.readline()
        first.kill()
    assert said == (
        "dotsim_ros: compiling the kernels for the first time, about 12 s; the result is kept\n"
    )


def test_long_tables_are_noticed_once_and_short_ones_never(monkeypatch, capsys):
    for part_s, said in ((4.0, "about 32 s"), (0.2, "")):
        clock = iter(np.arange(1, 11) * part_s)
        monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=clock.__next__))
        notice = progress.FirstTimeNotice("computing tables")
        for part in range(1, 11):
            notice(part / 10)
        lines = capsys.readouterr().err.splitlines()
        assert [said in line for line in lines] == [True] * bool(said)


def test_every_public_name_is_what_its_home_holds_and_is_listed():
    assert set(dotsim_ros.__all__) >= FOREVER
    homes = {name: home for home, names in dotsim_ros._HOMES.items() for name in names}
    assert sorted(homes) == sorted(dotsim_ros.__all__)
    assert set(dotsim_ros.__all__) <= set(dir(dotsim_ros))
    for name, home in homes.items():
        assert getattr(dotsim_ros, name) is getattr(importlib.import_module(home), name), name


def test_a_pose_above_the_apex_is_placed_by_the_sensor(frame):
    expected = [0.002, 0.0, RADIUS_M - 0.001]
    np.testing.assert_allclose(frame.indenter_pose.position_m, expected, atol=1e-12)
    assert frame.wrench.force_n[2] > 0.1
    assert frame.time_s == 0.04
    assert frame.image.shape == (120, 160, 3)


def test_above_the_apex_turns_about_the_axis_and_refuses_what_is_no_number():
    pose = Pose.above_apex(0.001, yaw_rad=np.pi / 2).on([0.0, 0.0, 0.01])
    np.testing.assert_allclose(pose.apply([1.0, 0.0, 0.0]), [0.0, 1.0, 0.009], atol=1e-12)
    with pytest.raises(ValueError, match="a pose above the apex holds a number that is not finite"):
        Pose.above_apex(float("nan"))


def test_poses_above_the_apex_are_checked_like_others(coarse):
    sensor = TactileSensor.load(coarse)
    with pytest.raises(ValueError, match="press less deep"):
        sensor.check_depth(Pose.above_apex(depth_m=0.0095))
    with pytest.raises(ValueError, match="press less deep"):
        sensor.step(Pose.above_apex(depth_m=0.0095))
    gel = sensor.press(Pose.above_apex(depth_m=0.0005))
    seen = sensor.see(gel, Pose.above_apex(depth_m=0.0005))
    np.testing.assert_allclose(seen.indenter_pose.position_m, [0.0, 0.0, RADIUS_M - 0.0005])


def test_a_sensor_is_loaded_from_names_files_or_objects(tmp_path, coarse):
    path = tmp_path / "mine.yaml"
    dotsim_ros.write_sensor(path, replace(coarse, name="mine"), "coarse")
    sensor = TactileSensor.load(path, indenter={"kind": "sphere", "radius_m": 0.003})
    assert sensor.specification.name == "mine"
    assert sensor.indenter.parameters == (0.003,)
    defined = TactileSensor.load(coarse, indenter="sphere(radius_m=0.003)")
    assert defined.indenter.parameters == (0.003,)
    ball = load_indenter("sphere_4mm")
    assert TactileSensor.load(coarse, indenter=ball).indenter is ball


def test_a_frame_is_saved_as_image_change_and_range_side_by_side(tmp_path, frame):
    frame.save(tmp_path / "new" / "press.png")
    read = cv2.imread(str(tmp_path / "new" / "press.png"))
    picture = cv2.cvtColor(read, cv2.COLOR_BGR2RGB)
    assert picture.shape == (120 + TITLE_HEIGHT_PX, 3 * 160, 3)
    image, change, distance = np.split(picture[TITLE_HEIGHT_PX:].astype(int), 3, axis=1)
    assert np.array_equal(image, frame.image)
    difference = image - frame.idle_image
    assert np.abs(difference).max() > 10
    expected = np.clip(127.5 + CHANGE_GAIN * difference, 0, 255)
    np.testing.assert_allclose(change, expected, atol=0.5)
    seen = np.isfinite(frame.depth_m)
    assert np.all(distance[~seen] == BACKGROUND)
    # Viridis: the nearest is bright yellow, the farthest dark purple.
    order = np.argsort(np.where(seen, frame.depth_m, np.nan).ravel())[: seen.sum()]
    np.testing.assert_allclose(distance.reshape(-1, 3)[order[0]], [253, 231, 37], atol=4)
    np.testing.assert_allclose(distance.reshape(-1, 3)[order[-1]], [68, 1, 84], atol=4)
    frame.save(str(tmp_path / "press.JPG"))
    read = cv2.cvtColor(cv2.imread(str(tmp_path / "press.JPG")), cv2.COLOR_BGR2RGB)
    assert np.abs(read.astype(int) - picture).mean() < 8.0


@pytest.mark.parametrize("name", ["coarse", "sensor_a"])
def test_a_frame_is_the_whole_drawing_of_its_skin(coarse, name):
    # The network of sensor_a knows the whole camera only.
    given = coarse if name == "coarse" else load_sensor(name)
    sensor = TactileSensor(
        replace(given, gel=replace(given.gel, skin_spacing_m=1.5e-3), solver=coarse.solver),
        indenter=load_indenter("sphere_4mm"),
    )
    frames = []
    # Away, a press, a slide, a release, and a jump to a press elsewhere.
    places_mm = ((-1.0, 0.0), (0.5, 0.0), (0.5, 0.3), (-1.0, 0.0), (-2.0, 0.0), (0.6, -2.0))
    for depth_mm, x_mm in places_mm:
        if x_mm < 0.0:
            sensor.reset()
        frames.append(sensor.step(Pose.above_apex(1e-3 * depth_mm, x_m=1e-3 * x_mm)))
        # What a holder does to its frame changes no other.
        kept = [array.copy() for array in (frames[-1].image, frames[-1].depth_m)]
        frames[-1].image[:], frames[-1].depth_m[:] = 0, 0.0
        view = SkinRenderer(sensor.camera, sensor.skin).render(frames[-1].skin_position_m)
        assert np.array_equal(kept[1], view.depth_m, equal_nan=True)
        assert np.array_equal(kept[0], sensor._image.render(view))
    for frame in frames:
        view = SkinRenderer(sensor.camera, sensor.skin).render(frame.skin_position_m)
        for each in ("normal", "material_point_m"):
            assert np.array_equal(getattr(frame, each), getattr(view, each), equal_nan=True), each
    moved = [bool(frame.max_skin_motion_m) for frame in frames]
    assert moved == [False, True, True, False, False, True]
    again = pickle.loads(pickle.dumps(frames[-1]))
    assert np.array_equal(again.normal, frames[-1].normal, equal_nan=True)


def test_a_frame_is_printed_on_one_line(frame):
    x, y, z = frame.wrench.force_n
    motion_mm = 1e3 * frame.max_skin_motion_m
    assert 0.7 < motion_mm < 1.1
    assert str(frame) == (
        f"Frame at 0.04 s: force [{x:.3f}, {y:.3f}, {z:.3f}] N, skin moved by up to "
        f"{motion_mm:.2f} mm, converged, image 160 x 120 px"
    )
    assert "mm, not converged, image" in str(replace(frame, converged=False))


def test_a_frame_is_saved_with_all_its_arrays(tmp_path, frame):
    for path, saved in (("a.npz", frame), ("b.NPZ", replace(frame, indenter_pose=None))):
        saved.save(tmp_path / path)
        with np.load(tmp_path / path) as arrays:
            for name in ("image", "depth_m", "normal", "material_point_m", "skin_position_m"):
                np.testing.assert_array_equal(arrays[name], getattr(frame, name))
            np.testing.assert_array_equal(arrays["force_n"], frame.wrench.force_n)
            np.testing.assert_array_equal(arrays["torque_nm"], frame.wrench.torque_nm)
            assert float(arrays["time_s"]) == frame.time_s
            assert bool(arrays["converged"]) is frame.converged
            has_pose = saved.indenter_pose is not None
            assert bool(np.isfinite(arrays["indenter_position_m"]).all()) is has_pose
    with pytest.raises(ValueError, match=r"ends in .tiff, expected \.png, \.jpg, \.jpeg for the"):
        frame.save(tmp_path / "press.tiff")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "b.NPZ"]


def test_a_file_stays_as_it_was_where_a_frame_could_not_be_written(tmp_path, frame, monkeypatch):
    path = tmp_path / "press.npz"
    path.write_bytes(b"before")

    def break_off(file: BinaryIO, **_: object) -> None:
        file.write(b"half")
        raise OSError("no space left")

    monkeypatch.setattr(np, "savez_compressed", break_off)
    with pytest.raises(OSError, match="no space left"):
        frame.save(path)
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("method", ["implicit", "explicit"])
def test_a_sensor_with_another_indenter_is_at_rest(coarse, method):
    specification = replace(coarse, solver=replace(coarse.solver, method=method))
    cone = load_indenter("cone")
    sensor = TactileSensor.load(specification)
    for depth_m in (0.0, 0.5e-3, 1.0e-3):
        pressed = sensor.press(Pose.above_apex(depth_m), 0.01)
    rest_m = sensor.skin.rest_position_m
    assert np.abs(pressed.skin_position_m - rest_m).max() > 0.5e-3
    sensor.set_indenter(cone)
    untouched = sensor.press(None, 0.001)
    assert untouched.time_s == 0.001
    assert np.abs(untouched.skin_position_m - rest_m).max() < 1e-6
    pose = Pose.above_apex(0.2e-3)
    fresh = TactileSensor.load(specification, indenter=cone)
    fresh.press(None, 0.001)
    np.testing.assert_array_equal(
        sensor.press(pose, 0.01).skin_position_m, fresh.press(pose, 0.01).skin_position_m
    )


def test_a_batch_needs_the_implicit_method(coarse):
    explicit = replace(coarse, solver=replace(coarse.solver, method="explicit"))
    with pytest.raises(ValueError, match="'explicit', expected 'implicit' for a batch"):
        make_gel_batch(explicit, indenter=load_indenter("sphere_4mm"), environment_count=2)


@pytest.fixture
def fresh_names(monkeypatch):
    """Forget what was imported by an old name: a name is warned of once."""
    for name in list(sys.modules):
        if name.startswith(tuple(MOVED)):
            monkeypatch.delitem(sys.modules, name)


@pytest.mark.usefixtures("fresh_names")
@pytest.mark.parametrize(("old", "new"), MOVED.items())
def test_an_old_name_leads_to_the_same_module(old, new):
    with pytest.warns(DeprecationWarning, match=f"{old} is {new}"):
        assert importlib.import_module(old) is importlib.import_module(new)
    assert importlib.import_module(new).__spec__.name == new


@pytest.mark.usefixtures("fresh_names")
def test_what_lies_below_an_old_folder_is_found():
    with pytest.warns(DeprecationWarning, match=r"is dotsim_ros\.data\.importers\.force_depth"):
        table = importlib.import_module("dotsim_ros.measured.importers.force_depth")
    assert table.read_force_table.__module__ == "dotsim_ros.data.importers.force_depth"
    with (
        pytest.warns(DeprecationWarning, match=r"is dotsim_ros\.data\.nothing"),
        pytest.raises(ModuleNotFoundError, match=r"dotsim_ros\.data\.nothing"),
    ):
        importlib.import_module("dotsim_ros.measured.nothing")
