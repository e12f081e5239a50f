# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags that cannot be fitted to: each error names bag, message and mend; the others are read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

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


def bag_with(
    bag: BagFile,
    *,
    poses: Sequence[int] = range(FRAMES),
    height_m: float = 0.0155,
    wrenches: Sequence[float] = (1.0,) * FRAMES,
    skins: Sequence[float] = (1.0,) * FRAMES,
    dropped: int = 0,
    twist: bool = False,
) -> None:
    """Write a bag.

    Args:
        bag: where to.
        poses: stamp of each, by the number of its frame.
        height_m: of all poses.
        wrenches: force of each, or what stands in its place.
        skins: scale of each.
        dropped: points that are missing of each skin.
        twist: write twists in place of wrenches.
    """
    stamps = [1_000_000_000 + 100_000_000 * frame for frame in range(FRAMES)]
    head = {"frame_id": "densetact_base", "types": BAG_TYPES}
    up = np.array([0.0, 0.0, 0.0, 1.0])
    for frame, other in enumerate(poses):
        message = msg_adapters.encode_pose_stamped(
            np.array([0.0, 0.0, height_m]), up, stamp_ns=stamps[other], **head
        )
        bag.write("/indenter/pose", stamps[frame], message)
    for stamp_ns, force_n in zip(stamps, wrenches, strict=False):
        encode = msg_adapters.encode_twist_stamped if twist else msg_adapters.encode_wrench_stamped
        message = encode(np.zeros(3), np.zeros(3), stamp_ns=stamp_ns, **head)
        if not twist:
            # Set past the adapter, which refuses what is not finite.
            message.wrench.force.z = force_n
        bag.write("/indenter/wrench", stamp_ns, message)
    for stamp_ns, scale in zip(stamps, skins, strict=False):
        position = (scale * SKIN.rest_position_m[dropped:]).astype(np.float32)
        message = msg_adapters.encode_cloud(position, stamp_ns=stamp_ns, **head)
        bag.write("/tactile/skin", stamp_ns, message)


NONE: tuple[float, ...] = ()
BAD: dict[str, tuple[dict[str, Any], str]] = {
    "without_poses": ({"poses": ()}, r"no message on /indenter/pose.*record the indenter's poses"),
    "wrong_type": ({"twist": True}, r"/indenter/wrench: holds geometry_msgs/msg/Twist.*record"),
    "out_of_order": ({"poses": (0, 2, 1)}, r"/indenter/pose, message 2: stamp.*one clock"),
    "not_a_number": (
        {"wrenches": (1.0, float("nan"), 1.0)},
        r"/indenter/wrench, message 1: .*not finite.*drop",
    ),
    "millinewtons": ({"wrenches": (501.0,)}, r"/indenter/wrench, message 0: .*convert them"),
    "millimetres": ({"skins": (1.0, 1.0, 1e3)}, r"/tactile/skin, message 2: .*multiply by 0.001"),
    "pose_in_millimetres": ({"height_m": 15.5}, r"/indenter/pose, message 0: .*multiply by 0.001"),
    "fewer_points": ({"dropped": 2}, r"/tactile/skin, message 0: .*record the vertices"),
    "poses_alone": (
        {"wrenches": NONE, "skins": NONE},
        r"neither /tactile/skin nor /indenter/wrench.*record one",
    ),
    "unpaired": ({"wrenches": (1.0,), "skins": NONE}, r"1 stamps of the wrench differ.*record"),
}


@pytest.fixture(scope="module")
def data_set(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    directory = tmp_path_factory.mktemp("data_set")
    records = []
    changes = {"good": {}, **{name: change for name, (change, _) in BAD.items()}}
    for name, change in {**changes, "unknown_indenter": {}}.items():
        with BagFile(directory / "bags" / name) as bag:
            bag_with(bag, **change)
        indenter = "spere" if name == "unknown_indenter" else "sphere"
        records.append({"bag": f"bags/{name}", "indenter": indenter, "frames": FRAMES})
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
    (entry,) = data_set.named(["fewer_points"])
    press = read_observation(data_set, entry, skin=SKIN, has_vertices=False).press
    assert press.skin_position_m is not None
    assert press.skin_position_m.shape[1] == SKIN.vertex_count - 2
