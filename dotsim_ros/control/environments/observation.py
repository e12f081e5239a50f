# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What an environment shows of the sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import gymnasium
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.gel.make import GelFrame
from dotsim_ros.geometry.camera import middle_part
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import SensorSpecification, SolverSpecification, given_sensor

KINDS = ("image", "depth", "skin", "wrench")
"""The image (H, W, 3); range in m (along the ray of the pixel) and the three parts of the normal
(H, W, 4), zero where no skin is seen; displacements of the skin's markers (V, 3), m; force and
torque of the gel (6,), N and N m."""
LARGEST_DEPTH_M = 0.1
SKIN_SPACING_M = 1.0e-3
SOLVER = SolverSpecification(grid_spacing_m=3.6e-3, refined=False, tolerance_m=100e-6, iterations=2)
"""Of a dome: coarse, so that an hour is enough to learn on two cores. The thin gel of a pad would
diverge with it."""


def depth_space(size_px: tuple[int, int]) -> gymnasium.spaces.Box:
    """Return the space of range and normal (H, W, 4) of a width and height."""
    high = np.ones((size_px[1], size_px[0], 4), dtype=np.float32)
    low = -high
    low[..., 0], high[..., 0] = 0.0, LARGEST_DEPTH_M
    return gymnasium.spaces.Box(low, high, dtype=np.float32)


class TouchView:
    """What an environment shows of its sensor.

    The sensor sees what it saw, with as few pixels as the size needs: images keep the camera's
    shape, and are cropped to the middle. Its skin has a marker a pixel of a small image, no finer.

    Args:
        solver: of its gel; None for `SOLVER`, or for a pad its own.
        kind: one of `KINDS`.
        size_px: width and height of image and depth.

    Raises:
        ValueError: a kind or size that there is not.
    """

    def __init__(
        self,
        sensor: str | Path | SensorSpecification,
        solver: SolverSpecification | None,
        kind: str,
        size_px: tuple[int, int],
        *,
        indenter: str | Mapping[str, Any] = "sphere_4mm",
    ) -> None:
        if kind not in KINDS:
            raise ValueError(f"observation is {kind!r}, expected one of {', '.join(KINDS)}")
        if min(size_px) < 16:
            raise ValueError(
                f"image_size_px is {size_px}, expected a width and a height of at least 16 pixels"
            )
        self._kind, self._size_px = kind, size_px
        specification = _coarse(given_sensor(sensor), solver, size_px)
        self.sensor = TactileSensor.load(specification, indenter=indenter)
        self.space = self._space()

    def _space(self) -> gymnasium.spaces.Box:
        width, height = self._size_px
        if self._kind == "image":
            return gymnasium.spaces.Box(0, 255, (height, width, 3), np.uint8)
        if self._kind == "depth":
            return depth_space(self._size_px)
        shape = (self.sensor.skin.vertex_count, 3) if self._kind == "skin" else (6,)
        return gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)

    def see(self, gel: GelFrame, kind: str = "") -> NDArray[Any]:
        """Return the observation, or another of `KINDS`."""
        kind = kind or self._kind
        if kind == "wrench":
            return np.concatenate([gel.wrench.force_n, gel.wrench.torque_nm]).astype(np.float32)
        if kind == "skin":
            return (gel.skin_position_m - self.sensor.skin.rest_position_m).astype(np.float32)
        frame, size_px = self.sensor.see(gel, None), self._size_px
        if kind == "image":
            middle = _middle(frame.image, size_px)
            return np.asarray(cv2.resize(middle, size_px, None, 0, 0, cv2.INTER_AREA))
        seen = np.concatenate([frame.depth_m[..., None], frame.normal], axis=-1)
        middle = _middle(
            np.clip(np.nan_to_num(seen, nan=0.0), -1.0, 1.0).astype(np.float32), size_px
        )
        # A mean over the rim of the skin would be of nothing that is there.
        return np.asarray(cv2.resize(middle, size_px, None, 0, 0, cv2.INTER_NEAREST))


def _coarse(
    specification: SensorSpecification,
    solver: SolverSpecification | None,
    size_px: tuple[int, int],
) -> SensorSpecification:
    if solver is None:
        solver = SOLVER if specification.gel.shape == "dome" else specification.solver
    camera = specification.camera
    unit = math.gcd(camera.width, camera.height)
    across, down = camera.width // unit, camera.height // unit
    count = max(math.ceil(size_px[0] / across), math.ceil(size_px[1] / down))
    scale = count / unit
    # The first pixel's centre is at 0, its corner at -1/2.
    x, y = ((place + 0.5) * scale - 0.5 for place in camera.principal_point_px)
    return replace(
        specification,
        gel=replace(specification.gel, skin_spacing_m=SKIN_SPACING_M),
        solver=solver,
        camera=replace(
            camera, width=count * across, height=count * down, principal_point_px=(x, y)
        ),
    )


def _middle(image: NDArray[Any], size_px: tuple[int, int]) -> NDArray[Any]:
    """Return the largest part in the middle of an image (H, W, C) that has the shape of a size
    (width, height)."""
    height, width = image.shape[:2]
    left, top, across, down = middle_part((width, height), size_px)
    return image[top : top + down, left : left + across]
