# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Camera intrinsics: another focal length, or another place of the optical axis in the image.

With an equidistant lens or a pinhole, and any radial distortion, focal length and centre act on the
image linearly: a new pixel p looks where the old image has c + (p - c') / k, with k the ratio of
the focal lengths and c' the new centre.
"""

from __future__ import annotations

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter, ImageFilter, SeenImage, Values
from dotsim_ros.effects.optical_terms import FixedResampling, any_frame, pixel_places


def _image(values: Values) -> ImageFilter:
    def source(image: SeenImage) -> tuple[FloatArray, FloatArray]:
        x, y = pixel_places(image)
        centre_x, centre_y = image.centre_px
        shift_x = values["shift_x_rad"] * image.focal_x_px
        shift_y = values["shift_y_rad"] * image.focal_px
        ratio = values["focal_ratio"]
        return (
            centre_x + (x - centre_x - shift_x) / ratio,
            centre_y + (y - centre_y - shift_y) / ratio,
        )

    return FixedResampling(source)


EFFECT = Effect(
    name="camera_intrinsics",
    title="Another focal length or centre of the camera",
    # The shift is given over the focal length: 0.06 rad are 5 px of an image 240 px high.
    parameters=(
        EffectParameter("focal_ratio", "", 1.0, 0.95, 1.05, (1.01, 0.99)),
        EffectParameter("shift_x_rad", "rad", 0.0, -0.06, 0.06, (0.0, 0.012)),
        EffectParameter("shift_y_rad", "rad", 0.0, -0.06, 0.06, (0.0, 0.012)),
    ),
    channels=(IMAGE,),
    protocol="images of the idle pattern",
    excited_by=any_frame,
    taken_for=("camera_extrinsics", "camera_displacement", "pose_offset"),
    image=_image,
)
