# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a bag looks like: its moments, panel by panel, as RGB images, its forces, its colours."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from numpy.typing import NDArray

from dotsim_ros.io.arrays import FloatArray, ImageArray
from dotsim_ros.optics.picture import BACKGROUND, CHANGE_GAIN, change_image
from dotsim_ros.view.skin_map import SkinMap, rest_position_m
from dotsim_ros.view.timeline import BagMoment, Forces

SKIN_MAP_PX = 480

DEPTH_COLOURS = "viridis_r"
SKIN_COLOURS = "inferno"
LEAST_DISPLACEMENT_M = 1e-4
LARGEST_ASPECT = 10
SAMPLE = 7
"""Depth ranges are taken from every seventh pixel of every seventh row."""


TITLES = {
    "image": "Image",
    "change": f"Change x{CHANGE_GAIN:g}",
    "depth": "Depth, mm",
    "skin": "Motion of the skin, mm",
}

INK = "#e6e9ee"
FAINT = "#5b6675"
STYLE: Any = {
    "figure.facecolor": tuple(level / 255 for level in BACKGROUND),
    "axes.facecolor": "#181d25",
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": "#2b323d",
    "font.family": "DejaVu Sans",
    "font.size": 10.0,
    "axes.titlesize": 11.0,
}
AXIS_COLOURS = {"x": "#ff6b6b", "y": "#51cf66", "z": "#4dabf7"}


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

    Attributes:
        depth_m: nearest and farthest depth of the bag, or None without depth.
        displacement_m: the largest motion of a point of the skin, or None without skin.
        shape_px: height and width of each panel that there is, by name.

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
                moved_m = self._displacement_m(moment)
                displacements.append(
                    float(np.max(moved_m, where=np.isfinite(moved_m), initial=0.0))
                )
        self.depth_m = (min(depths), max(depths)) if depths else None
        self.displacement_m = max(LEAST_DISPLACEMENT_M, *displacements) if displacements else None
        self.shape_px: dict[str, tuple[int, int]] = {}
        if self._first_image is not None:
            self.shape_px["image"] = self.shape_px["change"] = self._first_image.shape[:2]
        if self.depth_m is not None:
            self.shape_px["depth"] = self.shape_px.get("image", (480, 640))
        if self.displacement_m is not None:
            self.shape_px["skin"] = (SKIN_MAP_PX, SKIN_MAP_PX)
        if not self.shape_px:
            raise ValueError("the bag shows nothing: no image, no depth and no skin")

    def panel(self, name: str, moment: BagMoment) -> ImageArray | None:
        """Return one panel of a moment, or None before there is anything in it."""
        if name == "image":
            return moment.image
        if name == "change":
            return self._change(moment)
        if name == "depth":
            return None if moment.depth_m is None else self._depth(moment.depth_m)
        return None if moment.cloud is None else self._skin(moment)

    def colour_scale(self, name: str) -> ScalarMappable | None:
        """Return the colour scale of a panel in millimetres, or None where it has none."""
        if name == "depth" and self.depth_m is not None:
            low, high = self.depth_m
            colours = matplotlib.colormaps[DEPTH_COLOURS]
        elif name == "skin" and self.displacement_m is not None:
            low, high = 0.0, self.displacement_m
            colours = matplotlib.colormaps[SKIN_COLOURS]
        else:
            return None
        return ScalarMappable(Normalize(1e3 * low, 1e3 * high), colours)

    def _change(self, moment: BagMoment) -> ImageArray | None:
        if moment.image is None or self._first_image is None:
            return None
        if moment.image.shape != self._first_image.shape:
            raise ValueError("the images of the bag change their size")
        return change_image(moment.image, self._first_image)

    def _depth(self, depth_m: NDArray[np.float32]) -> ImageArray | None:
        if self.depth_m is None:
            return None
        return coloured(np.asarray(depth_m, dtype=np.float64), *self.depth_m, DEPTH_COLOURS)

    def _skin(self, moment: BagMoment) -> ImageArray:
        assert self.displacement_m is not None
        displacement_m = self._displacement_m(moment)
        if self._skin_map is None:
            self._skin_map = SkinMap(self._rest(moment), size_px=SKIN_MAP_PX)
        values = self._skin_map.raster(displacement_m)
        return coloured(values, 0.0, self.displacement_m, SKIN_COLOURS)

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


def _check_sides(image: ImageArray) -> None:
    height, width = image.shape[:2]
    if max(height, width) > LARGEST_ASPECT * min(height, width):
        raise ValueError(
            f"an image of {width} x {height} pixels cannot be shown: expected no side longer than "
            f"{LARGEST_ASPECT} times the other"
        )


@dataclass(frozen=True)
class Drawing:
    """What every picture of a bag is drawn from: its panels, forces, time axis and title."""

    images: PanelImages
    forces: Forces | None
    start_ns: int
    end_ns: int
    title: str

    def time_s(self, moment: BagMoment) -> float:
        """Return the time of a moment from the start of the bag."""
        return (moment.stamp_ns - self.start_ns) * 1e-9

    def draw_forces(self, axes: Axes) -> None:
        """Plot the force over the time of the bag, in seconds from its start."""
        axes.set_xlim(0.0, max(1e-3, (self.end_ns - self.start_ns) * 1e-9))
        axes.set_xlabel("time, s")
        forces = self.forces
        if forces is None:
            axes.set_yticks([])
            axes.text(
                0.5, 0.5, "no force recorded", transform=axes.transAxes, ha="center", va="center"
            )
            return
        time_s = (forces.stamp_ns - self.start_ns) * 1e-9
        for index, (name, colour) in enumerate(AXIS_COLOURS.items()):
            axes.plot(time_s, forces.force_n[:, index], color=colour, lw=1.6, label=f"F{name}")
        magnitude = np.linalg.norm(forces.force_n, axis=1)
        axes.plot(time_s, magnitude, color=INK, lw=1.2, ls="--", label="|F|")
        axes.set_ylabel("force on the indenter, N")
        axes.grid(True)
        axes.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, frameon=False, borderaxespad=0.2
        )
