"""What the sensor's camera sees of solved presses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dotsim_ros.arrays import Float32Array, ImageArray, IntArray
from dotsim_ros.evaluation.classification.classifier import (
    ClassifierSettings,
    touched,
    touched_as_taken,
)
from dotsim_ros.evaluation.tumour.presses import SolvedPress
from dotsim_ros.files import given_path
from dotsim_ros.geometry.camera import FisheyeCamera
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.optics.idle import lights_of, read_idle_frame
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.lighting import Lighting
from dotsim_ros.optics.noise import with_noise
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import LightingSpecification, SensorSpecification

WIDTH_PX = 320


@dataclass(frozen=True)
class Light:
    """How a stand-in's images are lit and taken; learning assumes none of it but the noise's kind.

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
        whole = FisheyeCamera.from_specification(sensor.camera)
        self._camera = whole.scaled(WIDTH_PX, round(whole.height * WIDTH_PX / whole.width))
        self._lighting, self._vignetting = lights_of(sensor)
        self.idle = read_idle_frame(given_path(sensor.camera.idle_image), self._camera).image
        self._skin = skin
        self._renderer = SkinRenderer(self._camera, skin)
        self._sensor = sensor
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

    def to_learn_from(
        self, presses: Sequence[SolvedPress], settings: ClassifierSettings, seed: int
    ) -> tuple[Float32Array, IntArray]:
        """Return what simulated touches add to the idle image, and their classes."""
        random = np.random.default_rng(seed)
        seen, labels = [], []
        for press in presses:
            for skins in press.skin_m:
                seen.append(touched(self.images(skins), self.idle, settings, random))
                labels += [press.press.label] * len(skins)
        return np.concatenate(seen), np.array(labels)

    def as_taken(
        self,
        presses: Sequence[SolvedPress],
        light: Light,
        settings: ClassifierSettings,
        seed: int,
    ) -> tuple[Float32Array, IntArray, IntArray]:
        """Return what touches add as a camera with noise takes them, their classes, and the number
        of the press that each belongs to."""
        idle = _scaled(self.idle, light.brightness)
        seen, labels, numbers = [], [], []
        for number, press in enumerate(presses):
            for turn, skins in enumerate(press.skin_m):
                images = np.stack(
                    [
                        with_noise(image, light.noise_levels, (seed, number, turn, frame))
                        for frame, image in enumerate(self.images(skins, light))
                    ]
                )
                seen.append(touched_as_taken(images, idle, settings))
                labels += [press.press.label] * len(skins)
                numbers += [number] * len(skins)
        return np.concatenate(seen), np.array(labels), np.array(numbers)


def _scaled(image: ImageArray, brightness: float) -> ImageArray:
    if brightness == 1.0:
        return image
    return np.clip(np.rint(brightness * image.astype(np.float32)), 0, 255).astype(np.uint8)
