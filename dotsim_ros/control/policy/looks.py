# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Looks: cameras, lights and coats that a sensor might have had, drawn at random.

A policy trained on many of them relies on what they share: how the skin moves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray, ImageArray
from dotsim_ros.optics.idle import IdleFrame
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.lighting import Lighting, Vignetting
from dotsim_ros.optics.noise import with_noise
from dotsim_ros.optics.pattern import idle_frame_of, render_idle_image
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import (
    CameraSpecification,
    LightingSpecification,
    PatternSpecification,
    SensorSpecification,
)

OWN_COAT_SHARE = 0.3
"""Share of the looks that keep the sensor's own idle image and lights."""


@dataclass(frozen=True)
class LookRanges:
    """How far looks differ from the sensor's own: largest tilt of the camera's axis, error of its
    principal point each way, and of the lens's angle at half the image's height; range of
    brightness and of its exponent; relative standard deviation of the brightness from image to
    image; largest standard deviation of the camera's noise, of 255."""

    tilt_deg: float = 1.5
    shift_px: float = 5.0
    angle_deg: float = 1.5
    gain: tuple[float, float] = (0.55, 1.25)
    gamma: tuple[float, float] = (0.85, 1.2)
    flicker: float = 0.015
    noise_levels: float = 3.0


def _camera(
    own: CameraSpecification, ranges: LookRanges, random: np.random.Generator
) -> CameraSpecification:
    tilt = np.radians(ranges.tilt_deg) * np.sqrt(random.uniform())
    towards = random.uniform(0.0, 2.0 * np.pi)
    turn = np.array([np.cos(towards) * tilt, np.sin(towards) * tilt, 0.0])
    # To first order in a small turn of the camera's own axes.
    x, y, z, w = own.quaternion_xyzw
    vector = np.array([x, y, z])
    turned = np.append(vector + 0.5 * (w * turn + np.cross(vector, turn)), w - 0.5 * vector @ turn)
    turned /= np.linalg.norm(turned)
    shift = random.uniform(-ranges.shift_px, ranges.shift_px, 2)
    centre = np.asarray(own.principal_point_px) + shift * own.height / 480.0
    return replace(
        own,
        quaternion_xyzw=(float(turned[0]), float(turned[1]), float(turned[2]), float(turned[3])),
        principal_point_px=(float(centre[0]), float(centre[1])),
        half_height_angle_deg=own.half_height_angle_deg
        + float(random.uniform(-ranges.angle_deg, ranges.angle_deg)),
    )


def _idle_frame(
    sensor: SensorSpecification, camera: Camera, random: np.random.Generator
) -> IdleFrame:
    """Return an idle frame with a coat and lights of its own."""
    azimuth = random.uniform(0.0, 360.0) + np.array([0.0, 120.0, 240.0])
    azimuth += random.uniform(-10.0, 10.0, 3)
    if random.uniform() < 0.5:
        azimuth = azimuth[[0, 2, 1]]
    lighting = Lighting.from_specification(
        LightingSpecification(
            radius_m=float(random.uniform(0.008, 0.0105)),
            height_m=float(random.uniform(0.0003, 0.0015)),
            azimuth_deg=(float(azimuth[0]), float(azimuth[1]), float(azimuth[2])),
            spread_deg=float(random.uniform(10.0, 42.0)),
            crosstalk=float(random.uniform(0.02, 0.3)),
            ambient_fraction=float(np.exp(random.uniform(np.log(0.1), np.log(0.6)))),
            exponent=float(random.uniform(0.35, 0.9)),
            gloss=float(random.choice([0.0, random.uniform(0.0, 4.0)])),
            gloss_exponent=float(random.uniform(50.0, 110.0)),
        )
    )
    vignetting = Vignetting((float(random.uniform(-0.3, 0.0)),))
    pattern = PatternSpecification(
        blotch_m=float(np.exp(random.uniform(np.log(0.2e-3), np.log(0.55e-3)))),
        dark_share=float(random.uniform(0.25, 0.6)),
        contrast=float(random.uniform(0.3, 0.75)),
        grain=float(random.uniform(0.02, 0.1)),
        noise_levels=0.5,
        seed=int(random.integers(2**31)),
    )
    image = render_idle_image(
        camera,
        sensor.gel,
        lighting=lighting,
        vignetting=vignetting,
        pattern=pattern,
        supersampling=1,
    )
    return IdleFrame(image, lighting, vignetting)


class Look:
    """One camera with its lights and coat, that sees the skin of a gel.

    Args:
        random: what is drawn from, now and for the noise of each image.

    Attributes:
        idle: (H, W, 3) uint8 image without contact, free of noise.
    """

    def __init__(
        self,
        sensor: SensorSpecification,
        skin: SkinMesh,
        ranges: LookRanges,
        random: np.random.Generator,
    ) -> None:
        camera = Camera.from_specification(_camera(sensor.camera, ranges, random))
        if random.uniform() < OWN_COAT_SHARE:
            frame = idle_frame_of(sensor, camera)
        else:
            frame = _idle_frame(sensor, camera, random)
        self._renderer = SkinRenderer(camera, skin)
        self._image = ImageRenderer(
            camera, skin, frame.image, lighting=frame.lighting, vignetting=frame.vignetting
        )
        self._gain = float(random.uniform(*ranges.gain))
        self._gamma = float(random.uniform(*ranges.gamma))
        self._noise_levels = float(random.uniform(0.0, ranges.noise_levels))
        self._flicker, self._random = ranges.flicker, random
        self.idle = self._exposed(frame.image, self._gain)

    def _exposed(self, image: ImageArray, gain: float) -> ImageArray:
        levels = np.linspace(0.0, 1.0, 256)
        table = np.clip(np.rint(255.0 * gain * levels**self._gamma), 0.0, 255.0)
        return np.asarray(cv2.LUT(image, table.astype(np.uint8)), dtype=np.uint8)

    def image(self, skin_position_m: FloatArray) -> ImageArray:
        """Return the image (H, W, 3) of the skin (V, 3), with the camera's noise."""
        seen = self._image.render(self._renderer.render(skin_position_m))
        flicker = 1.0 + self._flicker * float(self._random.standard_normal())
        image = self._exposed(seen, self._gain * flicker)
        seed = int(self._random.integers(2**31))
        return with_noise(image, self._noise_levels, seed)
