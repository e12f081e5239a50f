# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Simulated presses of indenters at random places, to learn from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from dotsim_ros.gel.make import make_gel, skin_of
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, tip_depth_m
from dotsim_ros.io.arrays import Float32Array, FloatArray
from dotsim_ros.io.cache import PHYSICS, content_key, load_arrays, store_arrays
from dotsim_ros.io.documents import ArrayForm
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.follow import SolveError, follow
from dotsim_ros.twin.footage import FilmedPress

FRAME_S = 0.1
FIRST_DEPTH_M = 0.3e-3
SLIDE_M = 1.5e-3
SLIDE_FRAMES = 2


@dataclass(frozen=True)
class PressPlan:
    """How indenters are pressed.

    Attributes:
        count: presses of each indenter.
        frames: of each press.
        deepest_m: where each ends, the same for every indenter: how deep it was pressed must not
            show which one it is.
        widest_rad: farthest from the dome's axis.
        tilt_rad: largest angle between the indenter's axis and the skin's normal.
        sliding_share: of the presses that end with a slide.
        seed: of the draws.

    Raises:
        ValueError: no press, or no frame before a slide.
    """

    count: int = 60
    frames: int = 6
    deepest_m: float = 3.0e-3
    widest_rad: float = 0.73
    tilt_rad: float = 0.19
    sliding_share: float = 0.3
    seed: int = 0

    def __post_init__(self) -> None:
        if self.count < 1 or self.frames <= SLIDE_FRAMES:
            raise ValueError(
                f"{self.count} presses of {self.frames} frames, expected one at least of more than "
                f"{SLIDE_FRAMES}"
            )


def simulated_presses(
    sensor: SensorSpecification,
    indenters: Mapping[str, Indenter],
    plan: PressPlan,
    image_shape: tuple[int, int],
    *,
    cache: Path,
) -> tuple[list[FilmedPress], list[list[Pose]]]:
    """Return presses by a sensor's gel, and the poses of each, with black images as the measured.

    A press that the gel refuses is left out, and reported.

    Args:
        sensor: whose gel is pressed.
        indenters: by name.
        plan: how.
        image_shape: height and width of the images.
        cache: folder of the skins computed before.
    """
    skin = skin_of(sensor.gel)
    pressed: list[FilmedPress] = []
    poses_of: list[list[Pose]] = []
    for rank, (name, indenter) in enumerate(sorted(indenters.items())):
        drawn, skins = pressed_skins(sensor, name, indenter, rank, plan, cache=cache)
        for number, (poses, position) in enumerate(zip(drawn, skins, strict=True)):
            if not np.all(np.isfinite(position)):
                print(f"{name}: press {number} is refused by the gel and left out")
                continue
            pressed.append(
                FilmedPress(
                    f"simulated_{name}_{number}",
                    name,
                    tip_depth_m(skin, poses),
                    np.zeros((len(poses), *image_shape, 3), dtype=np.uint8),
                    position,
                    _stamps(len(poses)),
                )
            )
            poses_of.append(poses)
    return pressed, poses_of


def pressed_skins(
    sensor: SensorSpecification,
    name: str,
    indenter: Indenter,
    rank: int,
    plan: PressPlan,
    *,
    cache: Path,
) -> tuple[list[list[Pose]], Float32Array]:
    """Return the poses of one indenter's presses and their skins (N, F, V, 3), not finite where the
    gel refused a press.

    Args:
        sensor: whose gel is pressed.
        name: of the indenter.
        indenter: what presses.
        rank: of the indenter's name among those that are pressed, which decides the draws.
        plan, cache: as for `simulated_presses`.
    """
    skin = skin_of(sensor.gel)
    random = np.random.default_rng([plan.seed, rank])
    drawn = [_poses(skin, plan, random) for _ in range(plan.count)]
    return drawn, _skins(sensor, skin, name, indenter, drawn, cache)


def _poses(skin: SkinMesh, plan: PressPlan, random: np.random.Generator) -> list[Pose]:
    """Return the poses of one press: in along the skin's normal, some with a slide at the end."""
    # Evenly over the cap.
    height = random.uniform(np.cos(plan.widest_rad), 1.0)
    azimuth = random.uniform(0.0, 2.0 * np.pi)
    radius = np.sqrt(1.0 - height**2)
    normal = np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), height])
    # The dome is a sphere about the middle of its base.
    surface = float(skin.apex_m[2]) * normal
    across = _perpendicular(normal, random.uniform(0.0, 2.0 * np.pi))
    tilt = random.uniform(0.0, plan.tilt_rad)
    axis = np.cos(tilt) * normal + np.sin(tilt) * across
    side = _perpendicular(axis, random.uniform(0.0, 2.0 * np.pi))
    quaternion = _quaternion(np.stack([side, np.cross(axis, side), axis], axis=1))
    slides = random.uniform() < plan.sliding_share
    pressing = plan.frames - (SLIDE_FRAMES if slides else 0)
    deepest = plan.deepest_m * (random.uniform(0.6, 0.8) if slides else random.uniform(0.7, 1.0))
    depths = np.linspace(FIRST_DEPTH_M, deepest, pressing)
    way = _perpendicular(normal, random.uniform(0.0, 2.0 * np.pi))
    places = [surface - depth * normal for depth in depths]
    places += [
        places[-1] + SLIDE_M * (step + 1) / SLIDE_FRAMES * way
        for step in range(plan.frames - pressing)
    ]
    return [Pose(place, quaternion) for place in places]


def _perpendicular(direction: FloatArray, angle_rad: float) -> FloatArray:
    """Return a unit vector (3,) across a direction (3,)."""
    start = np.cross(direction, [1.0, 0.0, 0.0] if abs(direction[0]) < 0.9 else [0.0, 1.0, 0.0])
    start /= np.linalg.norm(start)
    return np.cos(angle_rad) * start + np.sin(angle_rad) * np.cross(direction, start)


def _stamps(frames: int) -> FloatArray:
    return np.asarray(FRAME_S * np.arange(frames), dtype=np.float64)


def _quaternion(rotation: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_matrix(rotation).as_quat())


def _skins(
    sensor: SensorSpecification,
    skin: SkinMesh,
    name: str,
    indenter: Indenter,
    drawn: Sequence[Sequence[Pose]],
    cache: Path,
) -> Float32Array:
    """Return the skins (N, F, V, 3) of presses; not finite where the gel refused one."""
    s = sensor
    key = content_key(
        (*PHYSICS, "../studies/classification"),
        (s.gel, s.material, s.contact, s.solver),
        indenter,
        drawn,
    )
    path = cache / f"{name}-{key}.npz"
    shape = (len(drawn), len(drawn[0]), skin.vertex_count, 3)
    known = load_arrays(path, {"skin_position_m": ArrayForm(shape)})
    if known is not None:
        return known["skin_position_m"]
    gel = make_gel(sensor, skin, indenter)
    stamps = _stamps(shape[1])
    found = np.full(shape, np.nan, dtype=np.float32)
    for number, poses in enumerate(drawn):
        print(f"{name}: press {number + 1} of {len(drawn)}")
        gel.reset()
        try:
            found[number] = follow(gel.step, poses, stamps).skin_position_m
        except SolveError:
            continue
    store_arrays(path, {"skin_position_m": found})
    return found
