# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a moment of a bag looks like, panel by panel, as RGB images."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import matplotlib
import numpy as np

from dotsim_ros.io.arrays import FloatArray, ImageArray
from dotsim_ros.optics.picture import BACKGROUND, change_image
from dotsim_ros.view.skin_map import SkinMap, rest_position_m
from dotsim_ros.view.timeline import BagMoment

SKIN_MAP_PX = 480

DEPTH_COLOURS = "viridis_r"
SKIN_COLOURS = "inferno"
LEAST_DISPLACEMENT_M = 1e-4
LARGEST_ASPECT = 10
SAMPLE = 7
"""Depth ranges are taken from every seventh pixel of every seventh row."""


@dataclass(frozen=True)
class Ranges:
    """Ends of the colour scales, the same over a whole bag.

    Attributes:
        depth_m: nearest and farthest depth, or None without depth.
        displacement_m: the largest motion of a point of the skin, or None without skin.
    """

    depth_m: tuple[float, float] | None
    displacement_m: float | None


def _check_sides(image: ImageArray) -> None:
    height, width = image.shape[:2]
    if max(height, width) > LARGEST_ASPECT * min(height, width):
        raise ValueError(
            f"an image of {width} x {height} pixels cannot be shown: expected no side longer than "
            f"{LARGEST_ASPECT} times the other"
        )


def coloured(values: FloatArray, low: float, high: float, colours: str) -> ImageArray:
    """Return (..., 3) uint8 RGB of values on a colour scale; the background where not finite."""
    table = (matplotlib.colormaps[colours](np.arange(256))[:, :3] * 255.0 + 0.5).astype(np.uint8)
    valid = np.isfinite(values)
    span = max(high - low, 1e-12)
    index = np.clip((np.where(valid, values, low) - low) / span * 255.0, 0.0, 255.0)
    image = table[index.astype(np.uint8)]
    image[~valid] = BACKGROUND
    return image


class PanelImages:
    """Draws moments of one bag, all on the same scales.

    The skin's motion is the displacement that its cloud holds; a cloud of positions alone is
    compared with the first one. Images are compared with the first one.

    Args:
        moments: every moment of the bag; read once, none is kept.
        rest_m: (V, 3) the skin at rest, instead of the one that the clouds give.

    Raises:
        ValueError: the bag shows nothing.
    """

    def __init__(self, moments: Iterable[BagMoment], *, rest_m: FloatArray | None = None) -> None:
        self._rest_m = rest_m
        self._first_image: ImageArray | None = None
        self._skin_map: SkinMap | None = None
        depths: list[float] = []
        displacements: list[float] = []
        for moment in moments:
            if moment.image is not None and self._first_image is None:
                _check_sides(moment.image)
                self._first_image = moment.image.copy()
            if moment.depth_m is not None:
                sample = np.asarray(moment.depth_m[::SAMPLE, ::SAMPLE], dtype=np.float64)
                if np.isfinite(sample).any():
                    depths += np.nanpercentile(sample, [1.0, 99.0]).tolist()
            if moment.cloud is not None:
                displacement_m = self._displacement_m(moment)
                displacements.append(
                    float(np.max(displacement_m, where=np.isfinite(displacement_m), initial=0.0))
                )
        self.ranges = Ranges(
            (min(depths), max(depths)) if depths else None,
            max(LEAST_DISPLACEMENT_M, *displacements) if displacements else None,
        )
        if self._first_image is None and not depths and not displacements:
            raise ValueError("the bag shows nothing: no image, no depth and no skin")

    def shape_px(self) -> dict[str, tuple[int, int]]:
        """Return the height and width of each panel that there is, by name."""
        shapes = {}
        if self._first_image is not None:
            shapes["image"] = shapes["change"] = self._first_image.shape[:2]
        if self.ranges.depth_m is not None:
            shapes["depth"] = shapes.get("image", (480, 640))
        if self.ranges.displacement_m is not None:
            shapes["skin"] = (SKIN_MAP_PX, SKIN_MAP_PX)
        return shapes

    def panel(self, name: str, moment: BagMoment) -> ImageArray | None:
        """Return one panel of a moment, or None before there is anything in it."""
        return {
            "image": self._image,
            "change": self._change,
            "depth": self._depth,
            "skin": self._skin,
        }[name](moment)

    def _image(self, moment: BagMoment) -> ImageArray | None:
        return moment.image

    def _change(self, moment: BagMoment) -> ImageArray | None:
        if moment.image is None or self._first_image is None:
            return None
        if moment.image.shape != self._first_image.shape:
            raise ValueError("the images of the bag change their size")
        return change_image(moment.image, self._first_image)

    def _depth(self, moment: BagMoment) -> ImageArray | None:
        if moment.depth_m is None or self.ranges.depth_m is None:
            return None
        low, high = self.ranges.depth_m
        return coloured(np.asarray(moment.depth_m, dtype=np.float64), low, high, DEPTH_COLOURS)

    def _skin(self, moment: BagMoment) -> ImageArray | None:
        if moment.cloud is None or self.ranges.displacement_m is None:
            return None
        displacement = self._displacement_m(moment)
        if self._skin_map is None:
            self._skin_map = SkinMap(self._rest(moment), size_px=SKIN_MAP_PX)
        values = self._skin_map.raster(displacement)
        return coloured(values, 0.0, self.ranges.displacement_m, SKIN_COLOURS)

    def _rest(self, moment: BagMoment) -> FloatArray:
        if self._rest_m is None:
            assert moment.cloud is not None
            rest_m = rest_position_m(moment.cloud)
            if not np.isfinite(rest_m).all():
                raise ValueError(
                    "the skin at rest holds a point that is not finite: name the skin with --rest"
                )
            self._rest_m = rest_m
        return self._rest_m

    def _displacement_m(self, moment: BagMoment) -> FloatArray:
        assert moment.cloud is not None
        rest = self._rest(moment)
        position = np.asarray(moment.cloud.position, dtype=np.float64)
        if position.shape != rest.shape:
            raise ValueError(
                f"the skin has {len(position)} points after {len(rest)}: it must keep its vertices"
            )
        return np.asarray(np.linalg.norm(position - rest, axis=1))
