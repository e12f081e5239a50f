# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writing data sets: what is written is read back, and what cannot be read is refused."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.data.data_set_writer import (
    DataSetWriter,
    trajectory_of_frames,
    write_data_set,
)
from dotsim_ros.data.trajectory import Trajectory
from dotsim_ros.geometry.indenter import box_edge, load_indenter, sphere
from dotsim_ros.geometry.pose import Pose, Wrench
from dotsim_ros.geometry.skin_mesh import dome_skin

SKIN = dome_skin(0.01575, 4.0e-3)
BALL = sphere(0.004)


@dataclass
class Frame:
    """What a recording takes of a frame."""

    time_s: float
    indenter_pose: Pose | None = field(default_factory=lambda: Pose(np.array([0.0, 0.0, 0.015])))
    wrench: Wrench = field(default_factory=lambda: Wrench(np.array([0.1, 0.0, 2.0])))
    skin_position_m: NDArray[np.float64] = field(default_factory=lambda: SKIN.rest_position_m)
    image: NDArray[np.uint8] = field(default_factory=lambda: np.full((6, 8, 3), 90, np.uint8))


def recorded(name: str, **changes: object) -> Trajectory:
    frames = [Frame(0.04 * number) for number in (1, 2, 3)]
    return replace(trajectory_of_frames(frames, name=name), **changes)


def test_frames_become_the_channels_of_a_trajectory():
    frames = [Frame(0.04), Frame(0.08, Pose(np.array([0.001, 0.0, 0.014])))]
    made = trajectory_of_frames(frames, name="press")
    assert set(made.channels()) == {"pose", "wrench", "skin", "image"}
    assert made.pose.stamp_ns.tolist() == [40_000_000, 80_000_000]
    assert made.pose.position_m[1].tolist() == [0.001, 0.0, 0.014]
    assert made.wrench.force_n.tolist() == [[0.1, 0.0, 2.0]] * 2


@pytest.mark.parametrize(
    ("frames", "channels", "reason"),
    [
        ([], ("pose",), "press: 0 of 0 frames have an indenter, expected all and at least one"),
        ([Frame(0.04), Frame(0.08, None)], ("pose",), "press: 1 of 2 frames have an indenter"),
        ([Frame(0.04)], ("depth",), "channels are depth, expected of pose, wrench, skin, image"),
    ],
)
def test_frames_that_make_no_trajectory_are_refused(frames, channels, reason):
    with pytest.raises(ValueError, match=reason):
        trajectory_of_frames(frames, name="press", channels=channels)


def test_a_written_data_set_is_read_back(tmp_path):
    presses = [(recorded("first"), BALL), (recorded("second.5", image=None), BALL)]
    idle = np.full((6, 8, 3), 40, np.uint8)
    written = write_data_set(tmp_path / "data", presses, skin=SKIN, idle_images=[idle, idle])
    found = read_data_set(tmp_path / "data")
    assert found == written
    assert [entry.name for entry in found.entries] == ["first", "second.5"]
    assert [entry.has_images for entry in found.entries] == [True, False]
    assert [entry.frame_count for entry in found.entries] == [3, 3]
    for entry, (trajectory, _) in zip(found.entries, presses, strict=True):
        for name, channel in trajectory.channels().items():
            read = entry.read().channels()[name]
            for key, value in vars(channel).items():
                np.testing.assert_array_equal(getattr(read, key), value, err_msg=f"{name}.{key}")
    assert np.array_equal(found.skin_mesh().rest_position_m, SKIN.rest_position_m)
    assert len(found.idle_images()) == 2
    mesh = load_indenter(found.indenter_file("sphere"))
    assert np.abs(BALL.signed_distance(mesh.mesh.vertices_m)).max() < 1e-6


def test_nothing_is_left_of_a_data_set_that_could_not_be_written(tmp_path):
    twice = [(recorded("one"), BALL), (recorded("one"), BALL)]
    with pytest.raises(ValueError, match="two trajectories are named 'one'"):
        write_data_set(tmp_path / "data", twice, skin=SKIN)
    with pytest.raises(ValueError, match="no trajectory to write"):
        write_data_set(tmp_path / "data", [], skin=SKIN)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "data").mkdir()
    with pytest.raises(FileExistsError, match="data exists; name a folder that does not"):
        write_data_set(tmp_path / "data", [(recorded("one"), BALL)])


def test_a_data_set_grows_and_a_trajectory_is_replaced(tmp_path):
    DataSetWriter(tmp_path, SKIN).add(recorded("one"), BALL, {"site": 1}, failure="stopped")
    assert not DataSetWriter(tmp_path, SKIN).holds("one", {})
    writer = DataSetWriter(tmp_path, SKIN)
    writer.add(recorded("one"), BALL, {"site": 2})
    writer.add(recorded("two"), BALL)
    assert writer.holds("one", {"site": 2})
    assert not writer.holds("one", {"site": 1})
    assert [entry.name for entry in read_data_set(tmp_path).entries] == ["one", "two"]
    with pytest.raises(ValueError, match="holds another skin; give another folder"):
        DataSetWriter(tmp_path, dome_skin(0.01575, 3.0e-3))


def test_names_and_points_that_do_not_fit_are_refused(tmp_path):
    writer = DataSetWriter(tmp_path, SKIN)
    for name, indenter, reason in (
        ("", BALL, "the trajectory has the name '', expected one that a file can have"),
        ("a/b", BALL, "the trajectory has the name 'a/b'"),
        ("one", replace(BALL, name=""), "the indenter has the name ''"),
    ):
        with pytest.raises(ValueError, match=reason):
            writer.add(recorded(name), indenter)
    assert [path.name for path in tmp_path.iterdir()] == ["skin_mesh.npz"]
    other = dome_skin(0.01575, 3.0e-3)
    with pytest.raises(ValueError, match=rf"the skin has {SKIN.vertex_count} points, that of the"):
        DataSetWriter(tmp_path / "other", other).add(recorded("one"), BALL)


def test_another_shape_of_a_name_that_is_taken_is_refused(tmp_path):
    edge, other = (box_edge([size, 0.01, 0.01], 0.0003) for size in (0.01, 0.008))
    first, later = DataSetWriter(tmp_path, SKIN), DataSetWriter(tmp_path, SKIN)
    first.add(recorded("one"), edge)
    later.add(recorded("two"), edge)
    for writer in (first, later):
        with pytest.raises(ValueError, match=r"box_edge\.stl holds another indenter of this name"):
            writer.add(recorded("three"), other)
    assert [entry.name for entry in read_data_set(tmp_path).entries] == ["one", "two"]


@pytest.mark.fault("bags and data sets", "a bag to write has the name of one that no index lists")
def test_a_bag_that_the_index_does_not_list_is_kept(tmp_path, answered):
    own = tmp_path / "bags" / "press"
    own.mkdir(parents=True)
    (own / "press.mcap").write_bytes(b"of the user")
    index = tmp_path / "dataset.yaml"
    index.write_text("operator: Ada\ntrajectories: []\n", encoding="utf-8")
    DataSetWriter(tmp_path, SKIN).add(recorded("press"), BALL)
    kept = (tmp_path / "bags" / "press.kept" / "press.mcap").read_bytes()
    assert kept == b"of the user"
    assert yaml.safe_load(index.read_text(encoding="utf-8"))["operator"] == "Ada"
    assert [entry.name for entry in read_data_set(tmp_path).entries] == ["press"]
    bags = sorted(p.name for p in (tmp_path / "bags").iterdir())
    assert bags == ["press", "press.kept"]
    answered(f"bags/ holds {' and '.join(bags)}; press.kept/press.mcap is {kept.decode()!r}")


def test_a_trajectory_that_cannot_be_written_leaves_the_one_before(tmp_path):
    writer = DataSetWriter(tmp_path, SKIN)
    writer.add(recorded("press"), BALL)
    pose = recorded("press").pose
    assert pose is not None
    broken = replace(pose, position_m=np.full((3, 3), np.nan))
    with pytest.raises(ValueError, match="finite"):
        writer.add(recorded("press", pose=broken), BALL)
    (entry,) = read_data_set(tmp_path).entries
    assert entry.read().pose is not None
