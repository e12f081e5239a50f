# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The skins, and how the sensor is pressed onto them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from dotsim_ros.geometry.pose import Pose
from studies.tumour.pair.layer import Insert, LayerSpecification

SkinName = Literal["skin_1", "skin_2", "skin_3"]
SKIN_NAMES: tuple[SkinName, ...] = get_args(SkinName)
SKINS: Mapping[str, LayerSpecification] = MappingProxyType(
    {
        "skin_1": LayerSpecification(thickness_m=5.0e-3, youngs_modulus_pa=40.0e3),
        "skin_2": LayerSpecification(thickness_m=4.0e-3, youngs_modulus_pa=80.0e3),
        "skin_3": LayerSpecification(thickness_m=3.0e-3, youngs_modulus_pa=160.0e3),
    }
)
"""From the softest and thickest, which hides most, to the stiffest and thinnest."""
FACTORS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "0.7 times as stiff": (0.7, 1.0),
        "1.4 times as stiff": (1.4, 1.0),
        "0.85 times as thick": (1.0, 0.85),
        "1.15 times as thick": (1.0, 1.15),
    }
)
"""Changes of a skin after learning: factors on its Young's modulus and on its thickness."""
CLASSES = ("none", "tumour")
START_GAP_M = 20.0e-6
"""Between gel and skin before a press."""


def changed(skin: LayerSpecification, change: str) -> LayerSpecification:
    """Return a skin after one of `FACTORS`."""
    stiffness, thickness = FACTORS[change]
    return replace(
        skin,
        youngs_modulus_pa=stiffness * skin.youngs_modulus_pa,
        thickness_m=thickness * skin.thickness_m,
    )


@dataclass(frozen=True)
class Press:
    """One press of the sensor onto a skin.

    Attributes:
        insert: below the skin: bulged for a tumour, dented for none.
        tilt_rad: between the sensor's axis and the skin's normal.
        azimuth_rad: about the sensor's axis, of the way that the skin is tilted.
        depths_m: how deep the sensor's apex goes below the skin at rest, one a frame, growing.
    """

    insert: Insert
    tilt_rad: float
    azimuth_rad: float
    depths_m: tuple[float, ...]

    @property
    def label(self) -> int:
        """Number of its class in `CLASSES`."""
        return int(self.insert.height_m > 0.0)

    def pose(self, skin: LayerSpecification, dome_radius_m: float, depth_m: float) -> Pose:
        """Return the pose of the skin's frame in the sensor's base frame.

        The skin's plane touches the dome below the frame's origin, however it is tilted.
        """
        turned = (
            Rotation.from_euler("z", self.azimuth_rad)
            * Rotation.from_euler("x", np.pi)
            * Rotation.from_euler("y", self.tilt_rad)
        )
        outwards = turned.as_matrix()[:, 2]
        distance = dome_radius_m + skin.thickness_m - depth_m
        return Pose(-distance * outwards, turned.as_quat())

    def poses(self, skin: LayerSpecification, dome_radius_m: float) -> list[Pose]:
        """Return the pose of each frame."""
        return [self.pose(skin, dome_radius_m, depth) for depth in self.depths_m]


@dataclass(frozen=True)
class PressPlan:
    """How presses are drawn, alike for both classes: nothing but the insert's sign tells them.

    Attributes:
        shares: of the deepest depth, one a frame, growing to 1.
        height_m, radius_m: least and largest of the bulge, or of the dent.
        aside_m: largest distance of its middle from where the sensor touches first.
        tilt_rad: largest.
        deepest_m: least and largest depth of the last frame.
        seed: of the draws.

    Raises:
        ValueError: shares that do not grow to 1, or a seed below 0.
    """

    shares: tuple[float, ...] = (0.5, 0.75, 1.0)
    height_m: tuple[float, float] = (0.8e-3, 1.5e-3)
    radius_m: tuple[float, float] = (4.0e-3, 6.0e-3)
    aside_m: float = 2.0e-3
    tilt_rad: float = 0.09
    deepest_m: tuple[float, float] = (1.5e-3, 2.2e-3)
    seed: int = 0

    def __post_init__(self) -> None:
        if not (np.all(np.diff([0.0, *self.shares]) > 0.0) and self.shares[-1:] == (1.0,)):
            raise ValueError(
                f"shares of the depth are {self.shares}, expected positive ones that grow to 1"
            )
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}, expected 0 or more")

    def drawn(self, count: int, stream: int, *, in_plane: bool = False) -> list[Press]:
        """Return presses, tumours and none in turn.

        Args:
            count: of each class.
            stream: presses of another number are drawn independently.
            in_plane: tilt and insert lie in the plane y = 0 of sensor and skin.

        Raises:
            ValueError: fewer than one press.
        """
        if count < 1:
            raise ValueError(f"{count} presses of each class, expected one at least")
        random = np.random.default_rng([self.seed, stream])
        return [self._one(random, sign, in_plane) for _ in range(count) for sign in (1.0, -1.0)]

    def _one(self, random: np.random.Generator, sign: float, in_plane: bool) -> Press:
        height, radius = random.uniform(*self.height_m), random.uniform(*self.radius_m)
        aside = self.aside_m * np.sqrt(random.uniform())
        way, azimuth = random.uniform(0.0, 2.0 * np.pi, 2)
        if in_plane:
            way, azimuth = np.pi * round(way / (2.0 * np.pi)), 0.0
        centre = (float(aside * np.cos(way)), 0.0 if in_plane else float(aside * np.sin(way)))
        deepest = random.uniform(*self.deepest_m)
        return Press(
            Insert(sign * height, radius, centre),
            random.uniform(0.0, self.tilt_rad),
            float(azimuth),
            tuple(float(share * deepest) for share in self.shares),
        )
