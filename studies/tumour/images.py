# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the sensor's camera sees of solved presses, and what a classifier is shown of it.

A soft skin moves the gel's pattern by a pixel or less. The difference to the idle image shows the
pattern's edges more than where they went, so classifiers are shown the motion itself: an optical
flow from the idle image to the image, which any camera's images give, and the change of brightness
that is left once the image is carried back along it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import Float32Array, ImageArray, IntArray
from dotsim_ros.io.files import given_path
from dotsim_ros.optics.idle import lights_of, lit_region, read_idle_frame
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.lighting import Lighting
from dotsim_ros.optics.noise import with_noise
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import LightingSpecification, SensorSpecification
from studies.tumour.presses import SolvedPress

WIDTH_PX = 320
SEEN_PX = (40, 30)
"""Width and height of what a classifier is shown: the gel's motion has no finer parts."""
MOTION_PX = 0.5
BRIGHTNESS_LEVELS = 6.0
"""Of a motion and of a change of brightness that count as one."""
RIM_PX = 9
"""What lies closer to the rim of the lit disc, within which the flow is not known, is left out."""


@dataclass(frozen=True)
class Light:
    """How images are lit and taken.

    Attributes:
        brightness: factor on all that the camera sees, the idle image too.
        turned_deg: by how much the LEDs stand elsewhere about the axis than is assumed.
        ambient: factor on the light that does not change with the skin.
        noise_levels: deviation of the camera's noise, grey levels.
    """

    brightness: float = 1.0
    turned_deg: float = 0.0
    ambient: float = 1.0
    noise_levels: float = 1.5


AS_ASSUMED = Light()
TO_LEARN_FROM = Light(noise_levels=1.2)
OTHER = Light(brightness=0.75, turned_deg=20.0, ambient=2.0, noise_levels=2.5)


class Eye:
    """The camera of a sensor, 320 pixels wide.

    Args:
        sensor: its camera, lights and idle image.
        skin: the gel's skin at rest.

    Raises:
        ValueError: the sensor names no idle image.
    """

    def __init__(self, sensor: SensorSpecification, skin: SkinMesh) -> None:
        if not sensor.camera.idle_image:
            raise ValueError(
                f"sensor {sensor.name} names no camera.idle_image, expected one: images are made "
                "from it"
            )
        whole = Camera.from_specification(sensor.camera)
        self._camera = whole.scaled(WIDTH_PX, round(whole.height * WIDTH_PX / whole.width))
        self._lighting, self._vignetting = lights_of(sensor)
        self.idle = read_idle_frame(given_path(sensor.camera.idle_image), self._camera).image
        self._skin = skin
        self._renderer = SkinRenderer(self._camera, skin)
        self._sensor = sensor
        rim = np.ones((2 * RIM_PX + 1, 2 * RIM_PX + 1), dtype=np.uint8)
        lit = lit_region(self.idle).astype(np.uint8)
        self._inside = cv2.erode(lit, rim, borderValue=0) > 0
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        self._image_under: dict[Light, ImageRenderer] = {}

    def images(self, skin_m: Float32Array, light: Light = AS_ASSUMED) -> ImageArray:
        """Return images (F, H, W, 3) of skins (F, V, 3), without noise."""
        if light not in self._image_under:
            self._image_under[light] = ImageRenderer(
                self._camera,
                self._skin,
                self.idle,
                lighting=self._lit(light),
                vignetting=self._vignetting,
            )
        image = self._image_under[light]
        taken = np.stack([image.warp(self._renderer.render(skin)) for skin in skin_m])
        return _scaled(taken, light.brightness)

    def _lit(self, light: Light) -> Lighting:
        """Return the sensor's LEDs, turned and with other light around them."""
        if light.turned_deg == 0.0 and light.ambient == 1.0:
            return self._lighting
        stated: LightingSpecification = self._sensor.lighting
        red, green, blue = (azimuth + light.turned_deg for azimuth in stated.azimuth_deg)
        turned = Lighting.from_specification(replace(stated, azimuth_deg=(red, green, blue)))
        return replace(
            self._lighting,
            lights=turned.lights,
            ambient_fraction=light.ambient * self._lighting.ambient_fraction,
        )

    def taken(
        self, presses: Sequence[SolvedPress], light: Light, seed: int
    ) -> tuple[Float32Array, IntArray, IntArray]:
        """Return what is shown of presses (N, 3, h, w), their classes (N,), and the number of the
        press that each belongs to (N,).

        Args:
            presses: all turns and frames of each.
            light: under which, and with which noise.
            seed: of the noise.
        """
        idle = _scaled(self.idle, light.brightness)
        seen, labels, numbers = [], [], []
        for number, press in enumerate(presses):
            for turn, skins in enumerate(press.skin_m):
                for frame, image in enumerate(self.images(skins, light)):
                    noisy = with_noise(image, light.noise_levels, (seed, number, turn, frame))
                    seen.append(self.shown(noisy, idle))
                labels += [press.press.label] * len(skins)
                numbers += [number] * len(skins)
        return np.stack(seen), np.array(labels), np.array(numbers)

    def shown(self, image: ImageArray, idle: ImageArray) -> Float32Array:
        """Return motion along x and y and change of brightness (3, h, w) from the idle image to
        another, both (H, W, 3)."""
        before, after = (cv2.cvtColor(one, cv2.COLOR_RGB2GRAY) for one in (idle, image))
        height, width = before.shape
        motion = self._flow.calc(before, after, np.zeros((height, width, 2), dtype=np.float32))
        column, row = np.meshgrid(np.arange(width), np.arange(height))
        source = np.stack([column, row], axis=-1).astype(np.float32) + motion
        carried = cv2.remap(after, source[..., 0], source[..., 1], cv2.INTER_LINEAR)
        brighter = carried.astype(np.float32) - before
        shown = np.dstack([motion / MOTION_PX, brighter / BRIGHTNESS_LEVELS])
        shown = np.where(self._inside[..., None], shown, 0.0).astype(np.float32)
        small = cv2.resize(shown, SEEN_PX, interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(small.transpose(2, 0, 1))


def _scaled(image: ImageArray, brightness: float) -> ImageArray:
    if brightness == 1.0:
        return image
    return np.clip(np.rint(brightness * image.astype(np.float32)), 0, 255).astype(np.uint8)
