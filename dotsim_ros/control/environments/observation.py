# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What an environment shows of the sensor."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import cv2
import gymnasium
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.gel.make import GelFrame
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import SensorSpecification, SolverSpecification

KINDS = ("image", "depth", "skin", "wrench")
"""The image (H, W, 3); range in m (along the ray of the pixel) and the three parts of the normal
(H, W, 4), zero where no skin is seen; displacements of the skin's markers (V, 3), m; force and
torque of the gel (6,), N and N m."""
LARGEST_DEPTH_M = 0.1
SKIN_SPACING_M = 1.0e-3
SOLVER = SolverSpecification(grid_spacing_m=3.6e-3, refined=False, tolerance_m=100e-6, iterations=2)
"""Of a dome: coarse, so that an hour is enough to learn on two cores. The thin gel of a pad would
diverge with it."""


def check_observation(kind: str, size_px: tuple[int, int]) -> None:
    """Raise unless an environment can show this.

    Raises:
        ValueError: another name, or no size.
    """
    if kind not in KINDS:
        raise ValueError(f"observation is {kind!r}, expected one of {', '.join(KINDS)}")
    if min(size_px) < 16:
        raise ValueError(
            f"image_size_px is {size_px}, expected a width and a height of at least 16 pixels"
        )


def coarse(
    specification: SensorSpecification,
    solver: SolverSpecification | None,
    size_px: tuple[int, int],
) -> SensorSpecification:
    """Return a sensor for learning, with another solver; where that is None, with `SOLVER` if it is
    a dome, and with its own if it is a pad.

    It sees what it saw, with as few pixels as a size (width, height) needs: images keep the
    camera's shape, and are cropped to the middle by `observe`. Its skin has a marker a pixel of a
    small image, no finer.
    """
    if solver is None:
        solver = SOLVER if specification.gel.shape == "dome" else specification.solver
    camera = specification.camera
    gel = replace(specification.gel, skin_spacing_m=SKIN_SPACING_M)
    unit = math.gcd(camera.width, camera.height)
    across, down = camera.width // unit, camera.height // unit
    count = max(math.ceil(size_px[0] / across), math.ceil(size_px[1] / down))
    scale = count / unit
    # The first pixel's centre is at 0, its corner at -1/2.
    x, y = ((place + 0.5) * scale - 0.5 for place in camera.principal_point_px)
    return replace(
        specification,
        gel=gel,
        solver=solver,
        camera=replace(
            camera, width=count * across, height=count * down, principal_point_px=(x, y)
        ),
    )


def observation_space(
    kind: str, sensor: TactileSensor, size_px: tuple[int, int]
) -> gymnasium.spaces.Box:
    """Return the space of an observation of `KINDS`, of a size (width, height) where it has one."""
    width, height = size_px
    match kind:
        case "image":
            return gymnasium.spaces.Box(0, 255, (height, width, 3), np.uint8)
        case "depth":
            high = np.ones((height, width, 4), dtype=np.float32)
            low = -high
            low[..., 0], high[..., 0] = 0.0, LARGEST_DEPTH_M
            return gymnasium.spaces.Box(low, high, dtype=np.float32)
        case "skin":
            shape: tuple[int, ...] = (sensor.skin.vertex_count, 3)
        case _:
            shape = (6,)
    return gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)


def observe(
    kind: str, sensor: TactileSensor, gel: GelFrame, size_px: tuple[int, int]
) -> NDArray[Any]:
    """Return an observation of `KINDS`, of a size (width, height) where it has one."""
    if kind == "wrench":
        return np.concatenate([gel.wrench.force_n, gel.wrench.torque_nm]).astype(np.float32)
    if kind == "skin":
        return (gel.skin_position_m - sensor.skin.rest_position_m).astype(np.float32)
    frame = sensor.see(gel, None)
    if kind == "image":
        return np.asarray(cv2.resize(_middle(frame.image, size_px), size_px, None, 0, 0, _AREA))
    seen = np.concatenate([frame.depth_m[..., None], frame.normal], axis=-1)
    clipped = np.clip(np.nan_to_num(seen, nan=0.0), -1.0, 1.0).astype(np.float32)
    # A mean over the rim of the skin would be of nothing that is there.
    return np.asarray(cv2.resize(_middle(clipped, size_px), size_px, None, 0, 0, _NEAREST))


_AREA, _NEAREST = cv2.INTER_AREA, cv2.INTER_NEAREST


def _middle(image: NDArray[Any], size_px: tuple[int, int]) -> NDArray[Any]:
    """Return the largest part in the middle of an image (H, W, C) that has the shape of a size
    (width, height)."""
    height, width = image.shape[:2]
    scale = min(width / size_px[0], height / size_px[1])
    across, down = round(size_px[0] * scale), round(size_px[1] * scale)
    left, top = (width - across) // 2, (height - down) // 2
    return image[top : top + down, left : left + across]
