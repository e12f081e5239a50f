# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags that cannot be fitted to: each error names bag, message and mend; the others are read."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh
import yaml

import msg_adapters
from dotsim_ros.data.bag import BAG_TYPES, BagFile
from dotsim_ros.data.data_set import DataSet, read_data_set
from dotsim_ros.data.reading import BadBagError, read_observation, read_observations
from dotsim_ros.geometry.skin_mesh import dome_skin

SKIN = dome_skin(0.01575, 4e-3)
FRAMES = 3


def stamp(frame: int) -> int:
    return 1_000_000_000 + 100_000_000 * frame


def write_pose(bag: BagFile, frame: int, height_m: float, stamp_ns: int | None = None) -> None:
    time_ns = stamp(frame)
    message = msg_adapters.encode_pose_stamped(
        np.array([0.0, 0.0, height_m]),
        np.array([0.0, 0.0, 0.0, 1.0]),
        stamp_ns=time_ns if stamp_ns is None else stamp_ns,
        frame_id="densetact_base",
        types=BAG_TYPES,
    )
    bag.write("/indenter/pose", time_ns, message)


def write_wrench(bag: BagFile, frame: int, force_n: float) -> None:
    message = msg_adapters.encode_wrench_stamped(
        np.array([0.0, 0.0, 1.0]),
        np.zeros(3),
        stamp_ns=stamp(frame),
        frame_id="densetact_base",
        types=BAG_TYPES,
    )
    # Set past the adapter, which refuses what is not finite.
    message.wrench.force.z = force_n
    bag.write("/indenter/wrench", stamp(frame), message)


def write_skin(bag: BagFile, frame: int, scale: float = 1.0, dropped: int = 0) -> None:
    position = (scale * SKIN.rest_position_m[dropped:]).astype(np.float32)
    message = msg_adapters.encode_cloud(
        position, stamp_ns=stamp(frame), frame_id="densetact_base", types=BAG_TYPES
    )
    bag.write("/tactile/skin", stamp(frame), message)


def good(bag: BagFile) -> None:
    for frame in range(FRAMES):
        write_pose(bag, frame, 0.0155)
        write_wrench(bag, frame, 1.0)
        write_skin(bag, frame)


def without_poses(bag: BagFile) -> None:
    for frame in range(FRAMES):
        write_wrench(bag, frame, 1.0)


def wrong_type(bag: BagFile) -> None:
    for frame in range(FRAMES):
        write_pose(bag, frame, 0.0155)
        message = msg_adapters.encode_twist_stamped(
            np.zeros(3), np.zeros(3), stamp_ns=stamp(frame), frame_id="a", types=BAG_TYPES
        )
        bag.write("/indenter/wrench", stamp(frame), message)


def out_of_order(bag: BagFile) -> None:
    for frame, other in enumerate((0, 2, 1)):
        write_pose(bag, frame, 0.0155, stamp(other))
        write_wrench(bag, frame, 1.0)


def not_a_number(bag: BagFile) -> None:
    for frame in range(FRAMES):
        write_pose(bag, frame, 0.0155)
        write_wrench(bag, frame, float("nan") if frame == 1 else 1.0)


def millimetres(bag: BagFile) -> None:
    for frame in range(FRAMES):
        write_pose(bag, frame, 0.0155)
        write_skin(bag, frame, scale=1000.0 if frame == 2 else 1.0)


def pose_in_millimetres(bag: BagFile) -> None:
    for frame in range(FRAMES):
        write_pose(bag, frame, 15.5)
        write_wrench(bag, frame, 1.0)


def fewer_points(bag: BagFile) -> None:
    for frame in range(FRAMES):
        write_pose(bag, frame, 0.0155)
        write_skin(bag, frame, dropped=2)


def poses_alone(bag: BagFile) -> None:
    for frame in range(FRAMES):
        write_pose(bag, frame, 0.0155)


def unpaired(bag: BagFile) -> None:
    for frame in range(FRAMES):
        write_pose(bag, frame, 0.0155)
    write_wrench(bag, 0, 1.0)


BAD: dict[str, tuple[Callable[[BagFile], None], str]] = {
    "without_poses": (without_poses, r"no message on /indenter/pose.*record the indenter's poses"),
    "wrong_type": (wrong_type, r"/indenter/wrench: holds geometry_msgs/msg/TwistStamped.*record"),
    "out_of_order": (out_of_order, r"/indenter/pose, message 2: stamp.*one clock"),
    "not_a_number": (not_a_number, r"/indenter/wrench, message 1: .*not finite.*drop"),
    "millimetres": (millimetres, r"/tactile/skin, message 2: .*multiply by 0.001"),
    "pose_in_millimetres": (pose_in_millimetres, r"/indenter/pose, message 0: .*multiply by 0.001"),
    "fewer_points": (fewer_points, r"/tactile/skin, message 0: .*record the vertices"),
    "poses_alone": (poses_alone, r"neither /tactile/skin nor /indenter/wrench.*record one"),
    "unpaired": (unpaired, r"1 stamps of the wrench differ.*record"),
}


@pytest.fixture(scope="module")
def data_set(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    directory = tmp_path_factory.mktemp("data_set")
    records = []
    writers = {"good": good, **{name: writer for name, (writer, _) in BAD.items()}}
    for name, writer in writers.items():
        with BagFile(directory / "bags" / name) as bag:
            writer(bag)
        records.append({"bag": f"bags/{name}", "indenter": "sphere", "frames": FRAMES})
    with BagFile(directory / "bags" / "unknown_indenter") as bag:
        good(bag)
    records.append({"bag": "bags/unknown_indenter", "indenter": "spere", "frames": FRAMES})
    (directory / "dataset.yaml").write_text(yaml.safe_dump({"trajectories": records}))
    np.savez(
        directory / "skin_mesh.npz",
        rest_position_m=SKIN.rest_position_m,
        triangles=SKIN.triangles,
        on_base=SKIN.on_base,
    )
    (directory / "indenters").mkdir()
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.004)
    ball.apply_translation([0.0, 0.0, 0.004])
    ball.export(directory / "indenters" / "sphere.stl")
    return read_data_set(directory)


@pytest.mark.parametrize("name", list(BAD))
def test_a_bad_bag_is_refused_with_bag_message_and_mend(data_set: DataSet, name: str) -> None:
    entry = next(entry for entry in data_set.entries if entry.name == name)
    with pytest.raises(BadBagError, match=f"(?s)^{name}.*{BAD[name][1]}"):
        read_observation(data_set, entry, skin=SKIN, has_vertices=True)


def test_an_unknown_indenter_is_named_with_those_that_there_are(data_set: DataSet) -> None:
    entry = data_set.entries[-1]
    with pytest.raises(BadBagError, match=r"unknown_indenter: no mesh .*spere.*holds sphere.*cor"):
        read_observation(data_set, entry, skin=SKIN, has_vertices=True)


def test_the_good_ones_are_read_beside_the_bad(data_set: DataSet) -> None:
    names = [entry.name for entry in data_set.entries]
    found, omitted = read_observations(data_set, names, skin=SKIN, has_vertices=True)
    assert [observation.press.name for observation in found] == ["good"]
    assert {omission.name for omission in omitted} == {*BAD, "unknown_indenter"}
    assert found[0].press.frame_count == FRAMES


def test_clouds_may_differ_where_there_is_no_mesh(data_set: DataSet) -> None:
    entry = next(entry for entry in data_set.entries if entry.name == "fewer_points")
    press = read_observation(data_set, entry, skin=SKIN, has_vertices=False).press
    assert press.skin_position_m is not None
    assert press.skin_position_m.shape[1] == SKIN.vertex_count - 2
