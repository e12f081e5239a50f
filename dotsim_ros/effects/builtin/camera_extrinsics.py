# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Camera extrinsics: the camera is turned about its own place.

A camera that turns without moving sees the same rays elsewhere, whatever their depth, so the
image is resampled exactly but for the lens's radial distortion, which is not known here. A
camera that has moved sees a parallax that depends on depth: that is `camera_displacement`.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter, ImageFilter, SeenImage, Values
from dotsim_ros.effects.optical_terms import FixedResampling, any_frame, undistorted_camera


def _image(values: Values) -> ImageFilter:
    turn = Rotation.from_rotvec(
        [values["tilt_x_rad"], values["tilt_y_rad"], values["roll_rad"]]
    ).as_matrix()

    def source(image: SeenImage) -> tuple[FloatArray, FloatArray]:
        camera = undistorted_camera(image)
        directions, _ = camera.rays()
        places = camera.project_optical(directions @ turn.T)
        # Where a pixel has no direction or its direction no place, the border is shown.
        places = np.where(np.isfinite(places), places, -1.0)
        return places[..., 0], places[..., 1]

    return FixedResampling(source)


EFFECT = Effect(
    name="camera_extrinsics",
    title="Tilted camera",
    parameters=(
        EffectParameter("tilt_x_rad", "rad", 0.0, -0.07, 0.07, (0.01, -0.01)),
        EffectParameter("tilt_y_rad", "rad", 0.0, -0.07, 0.07, (0.0, 0.01)),
        EffectParameter("roll_rad", "rad", 0.0, -0.07, 0.07, (0.0, 0.01)),
    ),
    channels=(IMAGE,),
    protocol="images of the idle pattern",
    excited_by=any_frame,
    taken_for=("camera_intrinsics", "camera_displacement", "pose_offset"),
    image=_image,
)
