# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The stand-in for reality: the same kind of presses, solved by CalculiX."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.cache import content_key, load_arrays, store_arrays
from dotsim_ros.io.documents import Arrays
from dotsim_ros.specification import SensorSpecification
from studies.reference.run import CalculixError
from studies.tumour.layer_press import LayerPressSettings, solve_layer_press
from studies.tumour.pair.layer import LayerSpecification
from studies.tumour.presses import SolvedPress, press_forms
from studies.tumour.skins import START_GAP_M, Press

CALCULIX = tuple(
    LayerPressSettings(gel_spacing_m=3.0e-3, layer_spacing_m=2.4e-3, friction=friction)
    for friction in (0.0, 0.3)
)
"""In turn, for pairs of a tumour and none."""


def calculix_presses(
    sensor: SensorSpecification,
    layer: LayerSpecification,
    presses: Sequence[Press],
    turns_rad: FloatArray,
    cache: Path,
) -> list[SolvedPress]:
    """Return presses that CalculiX solved with both bodies deformable; every second pair of a
    tumour and none with friction, which our own presses have not. Each is returned in its turns,
    next to the press that is its first one.

    Args:
        sensor: as `coarse` returns it.
        layer: the soft skin.
        presses: onto it, in the plane y = 0; those that fail are reported and left out.
        turns_rad: (N, T) turns of each press about the sensor's axis.
        cache: folder of the presses solved before.

    Raises:
        CalculixMissingError: it is not installed, and a press was not solved before.
    """
    skin = skin_of(sensor.gel)
    found = []
    for number, (press, turns) in enumerate(zip(presses, turns_rad, strict=True)):
        name = f"press {number + 1} of {len(presses)}"
        settings = CALCULIX[number // 2 % len(CALCULIX)]
        key = content_key(
            ("../studies/reference", "../studies/tumour"),
            (sensor.gel, sensor.material),
            layer,
            press,
            turns,
            settings,
        )
        path = cache / "calculix" / f"{key}.npz"
        shape = (len(turns), len(press.depths_m), skin.vertex_count, 3)
        known = load_arrays(path, press_forms(shape))
        if known is None:
            print(f"CalculiX solves {name}")
            known = _solve(sensor, skin, layer, press, turns, settings)
            store_arrays(path, known)
        if not known["is_solved"].all():
            print(f"{name} was not solved by CalculiX and is left out")
            continue
        turned = replace(press, azimuth_rad=float(turns[0]))
        found.append(SolvedPress(turned, known["skin_m"], known["force_n"]))
    return found


def _solve(
    sensor: SensorSpecification,
    skin: SkinMesh,
    layer: LayerSpecification,
    press: Press,
    turns_rad: FloatArray,
    settings: LayerPressSettings,
) -> Arrays:
    radius, count = sensor.gel.outer_radius_m, len(press.depths_m)
    poses = [press.pose(layer, radius, -START_GAP_M), *press.poses(layer, radius)]
    position = np.zeros((len(turns_rad), count, skin.vertex_count, 3), dtype=np.float32)
    force, is_solved = np.zeros(count), np.zeros(count, dtype=np.bool_)
    try:
        solved = solve_layer_press(sensor, layer, press.insert, poses, settings)
    except CalculixError as error:
        print(str(error))
        return {"skin_m": position, "force_n": force, "is_solved": is_solved}
    if solved.failure:
        print(solved.failure)
    done = len(solved.force_n)
    is_solved[:done] = True
    force[:done] = np.linalg.norm(solved.force_n, axis=1)
    for number, turn in enumerate(turns_rad):
        position[number, :done] = solved.skin_m(skin.rest_position_m, float(turn))
    return {"skin_m": position, "force_n": force, "is_solved": is_solved}
