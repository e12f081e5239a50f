# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Trajectories in bags: exact there and back, whole or not at all, malformed ones refused."""

from dataclasses import fields, replace

import numpy as np
import pytest
import trimesh
import yaml

import msg_adapters
from dotsim_ros.data.bag import BAG_TYPES, BagFile, BagReader
from dotsim_ros.data.data_set import find_indenter, read_data_set
from dotsim_ros.data.trajectory import (
    RECORDED_TOPICS,
    ImageChannel,
    PoseChannel,
    SkinChannel,
    Topics,
    Trajectory,
    WrenchChannel,
    read_trajectory,
    write_trajectory,
)


@pytest.fixture
def trajectory():
    random = np.random.default_rng(3)
    stamp_ns = 1_000_000_000 + 40_000_001 * np.arange(5, dtype=np.int64)
    quaternion = random.normal(size=(5, 4))
    return Trajectory(
        pose=PoseChannel(
            stamp_ns,
            random.normal(size=(5, 3)),
            quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True),
        ),
        wrench=WrenchChannel(
            stamp_ns + 3, random.normal(size=(5, 3)), random.normal(size=(5, 3)), "tool"
        ),
        skin=SkinChannel(stamp_ns[1:], random.normal(size=(4, 7, 3)).astype(np.float32)),
        image=ImageChannel(
            stamp_ns[::2], random.integers(0, 256, (3, 6, 8, 3), dtype=np.uint8), "camera"
        ),
    )


def assert_same(first, second):
    assert first.channels().keys() == second.channels().keys()
    for name, channel in first.channels().items():
        for item in fields(channel):
            here, there = getattr(channel, item.name), getattr(second.channels()[name], item.name)
            assert np.array_equal(here, there), (name, item.name)


@pytest.mark.parametrize("topics", [Topics(), RECORDED_TOPICS, Topics(pose="/arm/tip")])
def test_trajectory_is_exact(tmp_path, trajectory, topics):
    write_trajectory(tmp_path / "press", trajectory, topics=topics)
    assert_same(read_trajectory(tmp_path / "press", topics=topics), trajectory)


def test_a_channel_may_be_absent_or_not_asked_for(tmp_path, trajectory):
    for name in trajectory.channels():
        rest = replace(trajectory, **{name: None})
        write_trajectory(tmp_path / name, rest)
        assert_same(read_trajectory(tmp_path / name), rest)
    read = read_trajectory(tmp_path / "pose", channels=["wrench"])
    assert list(read.channels()) == ["wrench"]


def test_bag_is_version_9_in_mcap_and_ordered(tmp_path, trajectory):
    write_trajectory(tmp_path / "press", trajectory)
    metadata = yaml.safe_load((tmp_path / "press" / "metadata.yaml").read_text())
    information = metadata["rosbag2_bagfile_information"]
    assert (information["version"], information["storage_identifier"]) == (9, "mcap")
    assert information["relative_file_paths"] == ["press.mcap"]
    with BagReader(tmp_path / "press") as bag:
        times = [message.log_time_ns for message in bag.messages(*bag.topics())]
    assert times == sorted(times)
    assert len(times) == information["message_count"]


def test_what_cannot_be_written_leaves_what_was_there(tmp_path, trajectory):
    spoiled = trajectory.wrench.force_n.copy()
    spoiled[-1, 0] = np.nan
    wrong = replace(trajectory, wrench=replace(trajectory.wrench, force_n=spoiled))
    for unwritable, reason in ((wrong, "not finite"), (Trajectory(), "no channel")):
        with pytest.raises(ValueError, match=reason):
            write_trajectory(tmp_path / "press", unwritable)
    with BagFile(tmp_path / "press") as bag:
        with pytest.raises(ValueError, match="not known"):
            bag.add_topic("/a", "nowhere_msgs/msg/Nothing")
        bag.discard()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "press").mkdir()
    with pytest.raises(FileExistsError, match="exists already"):
        write_trajectory(tmp_path / "press", trajectory)


def test_frames_are_ordered_by_their_headers(tmp_path, trajectory):
    with BagFile(tmp_path / "press") as bag:
        for log_time_ns, index in enumerate([2, 0, 1]):
            message = msg_adapters.encode_wrench_stamped(
                (float(index), 0.0, 0.0), (0, 0, 0), stamp_ns=index, frame_id="", types=BAG_TYPES
            )
            bag.write(Topics().wrench, log_time_ns, message)
    read = read_trajectory(tmp_path / "press")
    assert read.wrench.force_n[:, 0].tolist() == [0.0, 1.0, 2.0]


def _bag_of(path, topic, *messages):
    with BagFile(path) as bag:
        for message in messages:
            bag.write(topic, 1, message)


def _wrench(stamp_ns, **change):
    message = msg_adapters.encode_wrench_stamped(
        (0, 0, 0), (0, 0, 0), stamp_ns=stamp_ns, frame_id="", types=BAG_TYPES
    )
    for name, value in change.items():
        setattr(message.wrench.force, name, value)
    return message


def _cloud(stamp_ns, count):
    return msg_adapters.encode_cloud(
        np.zeros((count, 3)), stamp_ns=stamp_ns, frame_id="", types=BAG_TYPES
    )


@pytest.mark.parametrize(
    ("topic", "messages", "reason"),
    [
        ("wrench", lambda: [_wrench(1), _wrench(2, y=np.nan)], "message 1: force .* not finite"),
        ("wrench", lambda: [_wrench(5), _wrench(5)], "stamps must increase"),
        ("skin", lambda: [_cloud(1, 4), _cloud(2, 5)], r"arrays from \(4, 3\) to \(5, 3\)"),
        ("pose", lambda: [_wrench(1)], "expected geometry_msgs/msg/PoseStamped as pose"),
        (None, lambda: [_wrench(1)], "it holds /elsewhere"),
    ],
)
def test_malformed_channels_are_refused(tmp_path, topic, messages, reason):
    topic = "/elsewhere" if topic is None else getattr(Topics(), topic)
    _bag_of(tmp_path / "press", topic, *messages())
    with pytest.raises(ValueError, match=rf"press.*{reason}"):
        read_trajectory(tmp_path / "press")


def test_no_bag_and_a_cut_one_are_refused(tmp_path, trajectory):
    with pytest.raises(FileNotFoundError, match="no bag"):
        read_trajectory(tmp_path / "nothing")
    (tmp_path / "folder").mkdir()
    with pytest.raises(ValueError, match="no ROS 2 bag"):
        read_trajectory(tmp_path / "folder")
    write_trajectory(tmp_path / "press", trajectory)
    file = tmp_path / "press" / "press.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(ValueError, match="press"):
        read_trajectory(tmp_path / "press")
    with pytest.raises(ValueError, match="2 stamps and 3 force_n"):
        Trajectory(wrench=WrenchChannel(np.array([1, 2]), np.zeros((3, 3)), np.zeros((2, 3))))


def _data_set(tmp_path, trajectory):
    write_trajectory(tmp_path / "bags" / "press", trajectory)
    record = {"bag": "bags/press", "indenter": "ball", "frames": 5, "images": True}
    (tmp_path / "dataset.yaml").write_text(yaml.safe_dump({"trajectories": [record]}))
    np.savez(
        tmp_path / "skin_mesh.npz",
        rest_position_m=1e-2 * np.eye(3),
        triangles=np.array([[0, 1, 2]]),
        on_base=np.array([True, False, False]),
    )


def test_data_set_is_read(tmp_path, trajectory):
    # Meshes are looked for next to a data set, too: not among the folders of other tests.
    _data_set(tmp_path / "alone", trajectory)
    data_set = read_data_set(tmp_path / "alone")
    (entry,) = data_set.entries
    found = (entry.name, entry.indenter, entry.frame_count, entry.has_images)
    assert found == ("press", "ball", 5, True)
    assert_same(entry.read(), trajectory)
    assert data_set.skin_mesh().on_base.tolist() == [True, False, False]


def test_a_mesh_is_looked_for_in_the_data_set_then_beside_it_or_in_the_folder_named(
    tmp_path, trajectory
):
    data = tmp_path / "mine"
    _data_set(data, trajectory)
    meshes = {}
    for folder in ("mine", "other", "named"):
        meshes[folder] = tmp_path / folder / "indenters" / "ball.stl"
        meshes[folder].parent.mkdir(parents=True)
    data_set = read_data_set(data)
    for given, places in ((None, ("mine", "named", "other")), (meshes["named"].parent, ("named",))):
        with pytest.raises(FileNotFoundError, match=r"no mesh ball\.stl .*--indenters") as refused:
            data_set.indenter_file("ball", given)
        looked = [name for name in meshes if str(meshes[name].parent) in str(refused.value)]
        assert sorted(looked) == sorted(places)
    meshes["other"].write_text("next to")
    assert data_set.indenter_file("ball") == meshes["other"]
    meshes["mine"].write_text("own")
    assert data_set.indenter_file("ball") == meshes["mine"]
    with pytest.raises(FileNotFoundError, match="holds no indenter"):
        data_set.indenter_file("ball", meshes["named"].parent)
    meshes["named"].write_text("named")
    assert data_set.indenter_file("ball", meshes["named"].parent) == meshes["named"]


def test_an_indenter_is_a_mesh_a_description_or_a_definition(tmp_path, trajectory, monkeypatch):
    _data_set(tmp_path / "data", trajectory)
    data_set = read_data_set(tmp_path / "data")
    folder = tmp_path / "data" / "indenters"
    folder.mkdir()
    (folder / "ball.yaml").write_text("kind: sphere\nradius_m: 0.003\n")
    (folder / "cube.obj").write_text(
        trimesh.creation.box(extents=[0.004] * 3).export(file_type="obj")
    )
    described = find_indenter(data_set, "ball")
    assert (described.name, described.parameters) == ("ball", (0.003,))
    assert find_indenter(data_set, "cube").mesh is not None
    with pytest.raises(FileNotFoundError, match=r"\(did you mean 'ball'\?\).*holds ball, cube"):
        find_indenter(data_set, "bal")
    index = tmp_path / "data" / "dataset.yaml"
    defined = index.read_text().replace("indenter: ball", "indenter: sphere(radius_m=0.002)")
    index.write_text(defined)
    monkeypatch.setenv("HOME", str(tmp_path))
    data_set = read_data_set("~/data")
    found = find_indenter(data_set, data_set.entries[0].indenter)
    assert (found.name, found.parameters) == ("sphere(radius_m=0.002)", (0.002,))


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("[]", "expected a list"),
        ("trajectories: [press]", "expected a mapping"),
        ("trajectories: [{bag: bags/press, frames: -1}]", "frames"),
        ("trajectories: [{bag: bags/press, indenter: a/b}]", "indenter is 'a/b'"),
        ("trajectories: [{bag: bags/press}]\nweights: 3", "weights is 3"),
    ],
)
def test_malformed_index_is_refused(tmp_path, trajectory, content, reason):
    _data_set(tmp_path, trajectory)
    (tmp_path / "dataset.yaml").write_text(content)
    with pytest.raises(ValueError, match=reason):
        read_data_set(tmp_path)


def test_index_that_names_no_bag_is_refused(tmp_path, trajectory):
    _data_set(tmp_path, trajectory)
    (tmp_path / "dataset.yaml").write_text("trajectories: [{bag: bags/other}]")
    with pytest.raises(FileNotFoundError, match="bags/other"):
        read_data_set(tmp_path)
    with pytest.raises(FileNotFoundError, match="is no data set"):
        read_data_set(tmp_path / "bags")
