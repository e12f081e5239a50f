# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Camera displacement: the camera, or its entrance pupil, stands beside its place.

Near skin moves farther in the image than far skin: a parallax, which a turned camera
(`camera_extrinsics`) does not have. Skin that only the displaced camera sees is taken from what is
next to it. The lens's radial distortion is not known here and left out.
"""

from __future__ import annotations

import cv2
import numpy as np

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter, ImageFilter, SeenImage, Values
from dotsim_ros.effects.optical_terms import (
    any_frame,
    pixel_places,
    sampled,
    undistorted_camera,
    within_scale,
)

ROUNDS = 2
"""How often it is asked where the skin that a new pixel shows was seen before."""


def parallax_px(image: SeenImage, displacement_m: FloatArray) -> FloatArray:
    """Return how far (H, W, 2) what each pixel shows moves in the image; 0 where no skin is seen.

    Args:
        image: with the skin's depth.
        displacement_m: (3,) of the camera, optical frame.
    """
    camera = undistorted_camera(image)
    directions, _ = camera.rays()
    point_m = image.depth_m[..., None] * directions
    x, y = pixel_places(image)
    return np.nan_to_num(camera.project_optical(point_m - displacement_m) - np.stack([x, y], -1))


def _image(values: Values) -> ImageFilter:
    displacement_m = np.array([values["x_m"], values["y_m"], values["z_m"]])

    def displaced(image: SeenImage) -> FloatArray:
        if not displacement_m.any():
            return image.pixels
        moved = parallax_px(image, displacement_m).astype(np.float32)
        x, y = pixel_places(image)
        way = moved
        for _ in range(ROUNDS):
            found = cv2.remap(
                moved,
                (x - way[..., 0]).astype(np.float32),
                (y - way[..., 1]).astype(np.float32),
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REPLICATE,
            )
            way = np.asarray(found, dtype=np.float32)
        return within_scale(sampled(image.pixels, x - way[..., 0], y - way[..., 1]))

    return displaced


EFFECT = Effect(
    name="camera_displacement",
    title="Displaced camera",
    parameters=(
        EffectParameter("x_m", "m", 0.0, -5.0e-4, 5.0e-4, (1.0e-4, -1.0e-4)),
        EffectParameter("y_m", "m", 0.0, -5.0e-4, 5.0e-4, (0.0, 1.0e-4)),
        EffectParameter("z_m", "m", 0.0, -5.0e-4, 5.0e-4, (0.0, 1.0e-4)),
    ),
    channels=(IMAGE,),
    protocol="images of the idle pattern, and of deep presses, whose skin is near",
    excited_by=any_frame,
    taken_for=("camera_extrinsics", "camera_intrinsics", "pose_offset"),
    image=_image,
)
