# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Presses as a camera might have filmed them: dents under lights that the model does not know."""

from __future__ import annotations

import numpy as np

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin
from dotsim_ros.io.files import parameter_path
from dotsim_ros.optics.idle import lit_region, read_idle_frame
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.lighting import Lighting
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import load_sensor
from dotsim_ros.twin.footage import OpticalData, OpticalPress, Rest

RADIUS_M = 0.01575
HIDDEN = Lighting(ambient_fraction=0.4, exponent=1.5)
"""The lights of the camera that is learned from."""
GLOSS_LEVELS = 60.0
NOISE_LEVELS = 1.2


def dented(skin: SkinMesh, axis: np.ndarray, depth_m: float, width_m: float) -> np.ndarray:
    """Return the skin (V, 3) with a smooth dent."""
    distance = np.linalg.norm(skin.rest_position_m - RADIUS_M * axis, axis=1)
    share = np.exp(-((distance / width_m) ** 2))[:, None]
    return skin.rest_position_m - depth_m * share * axis


def film(*, width: int, press_count: int, frame_count: int = 4, seed: int = 0) -> OpticalData:
    """Return presses at random places, the first frame of each untouched."""
    random = np.random.default_rng(seed)
    height = 3 * width // 4
    camera = Camera.from_specification(load_sensor("densetact2").camera).scaled(width, height)
    skin = dome_skin(RADIUS_M, 1.0e-3)
    idle = read_idle_frame(parameter_path("images/densetact2_idle.png"), camera)
    renderer = SkinRenderer(camera, skin)
    known = ImageRenderer(camera, skin, idle.image, lighting=Lighting())
    hidden = ImageRenderer(camera, skin, idle.image, lighting=HIDDEN)
    untouched = renderer.render(skin.rest_position_m)
    rest = Rest(idle.image, untouched.depth_m, untouched.normal, lit_region(idle.image))
    presses = []
    for number in range(press_count):
        axis = np.array([*random.uniform(-0.5, 0.5, 2), 1.0])
        axis /= np.linalg.norm(axis)
        width_m = random.uniform(2.5e-3, 4.5e-3)
        depth_m = np.linspace(0.0, 3.0e-3, frame_count)
        views = [renderer.render(dented(skin, axis, depth, width_m)) for depth in depth_m]
        measured = []
        for view in views:
            turned = np.nan_to_num(np.linalg.norm(view.normal - rest.normal, axis=2))
            image = hidden.warp(view) + GLOSS_LEVELS * (turned * rest.lit)[..., None] ** 2
            image = image + NOISE_LEVELS * random.standard_normal(image.shape)
            measured.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
        presses.append(
            OpticalPress(
                f"dent_{number}",
                "dent",
                depth_m,
                np.stack(measured),
                np.stack([view.depth_m for view in views]),
                np.stack([view.normal for view in views]),
                np.stack([known.warp(view) for view in views]),
            )
        )
    return OpticalData(camera, rest, tuple(presses))
