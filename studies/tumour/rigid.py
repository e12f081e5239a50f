# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The baseline without mechanics: the insert's shape as a rigid body, cut out of the gel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import Float32Array
from studies.tumour.pair.layer import LayerSpecification
from studies.tumour.presses import SolvedPress, turned_skins
from studies.tumour.skins import Press


def rigid_presses(
    skin: SkinMesh,
    layer: LayerSpecification,
    dome_radius_m: float,
    presses: Sequence[Press],
    turns: int,
) -> list[SolvedPress]:
    """Return presses of a skin that has the insert's shape throughout and gives way nowhere: gel
    inside of it is moved onto it, along its axis, as Tacto cuts surfaces.

    Args:
        skin: the gel's, at rest.
        layer: the skin; its stiffness plays no part.
        dome_radius_m: of the gel.
        presses: onto it.
        turns: of each press about the sensor's axis.
    """
    found = []
    for press in presses:
        poses = press.poses(layer, dome_radius_m)
        cut = np.stack([_cut(skin, layer, press, pose) for pose in poses])
        turned = turned_skins(skin, cut.astype(np.float32), turns)
        found.append(SolvedPress(press, turned, np.zeros(len(poses))))
    return found


def _cut(skin: SkinMesh, layer: LayerSpecification, press: Press, pose: Pose) -> Float32Array:
    local = (skin.rest_position_m - pose.position_m) @ pose.rotation()
    height, _ = press.insert.heights_m(local[:, :2])
    is_inside = (local[:, 2] < layer.thickness_m + height) & ~skin.on_base
    local[is_inside, 2] = (layer.thickness_m + height)[is_inside]
    return np.asarray(pose.apply(local), dtype=np.float32)
