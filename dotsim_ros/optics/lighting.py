# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The lights of the sensor, and how much of their light reaches the skin."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.arrays import Float32Array
from dotsim_ros.specification import LightingSpecification, VignettingSpecification

_STATED = LightingSpecification()


@dataclass(frozen=True)
class PointLight:
    """One LED.

    Attributes:
        position_m: place in the base frame.
        intensity: what it adds to red, green and blue, in any common unit.
    """

    position_m: tuple[float, float, float]
    intensity: tuple[float, float, float]


def led_ring(stated: LightingSpecification = _STATED) -> tuple[PointLight, ...]:
    """Return the nine LEDs of a sensor's file around the axis, on a ring or in three rows: three
    red, three green, three blue; from +x towards +y is from right towards down in the image."""
    lights = []
    mixing = stated.crosstalk + (1.0 - stated.crosstalk) * np.eye(3)
    for (red, green, blue), centre in zip(mixing.tolist(), stated.azimuth_deg, strict=True):
        for step in (-1.0, 0.0, 1.0):
            along = 0.5 * stated.row_length_m * step
            spread_deg = 0.0 if stated.row_length_m > 0.0 else stated.spread_deg
            azimuth = np.radians(centre + spread_deg * step)
            cosine, sine = float(np.cos(azimuth)), float(np.sin(azimuth))
            place = (
                stated.radius_m * cosine - along * sine,
                stated.radius_m * sine + along * cosine,
                stated.height_m,
            )
            lights.append(PointLight(place, (red, green, blue)))
    return tuple(lights)


@dataclass(frozen=True)
class Lighting:
    """Direct light of the LEDs on a coat, Lambertian with a gloss, and light that does not change.

    Attributes:
        lights: the LEDs.
        ambient_fraction: light from all other directions (reflected between the parts of the
            dome), over the mean direct light at rest. It keeps the relative change bounded where
            an LED hardly reaches the skin at rest.
        exponent: of brightness over light; 1 for a camera with a linear response.
        gloss: light that the coat mirrors where it turns an LED straight into the camera, over what
            it scatters of one that it faces; 0 for a dull coat.
        gloss_exponent: n of the lobe exp(n (c - 1)), with c the cosine between the normal and the
            half-way direction (nearly Blinn's c^n, and cheaper); larger is a smoother coat.

    Raises:
        ValueError: no light, a fraction or an exponent that is not positive, or a negative gloss.
    """

    lights: tuple[PointLight, ...] = field(default_factory=led_ring)
    ambient_fraction: float = _STATED.ambient_fraction
    exponent: float = _STATED.exponent
    gloss: float = _STATED.gloss
    gloss_exponent: float = _STATED.gloss_exponent

    @classmethod
    def from_specification(cls, specification: LightingSpecification) -> Lighting:
        """Return the lights of a sensor's file."""
        s = specification
        return cls(led_ring(s), s.ambient_fraction, s.exponent, s.gloss, s.gloss_exponent)

    def as_grey(self) -> Lighting:
        """Return the light as a camera sees it that tells no colours apart."""
        lights = []
        for light in self.lights:
            mean = sum(light.intensity) / 3.0
            lights.append(PointLight(light.position_m, (mean, mean, mean)))
        return replace(self, lights=tuple(lights))

    def __post_init__(self) -> None:
        if not self.lights:
            raise ValueError("lighting has no light, expected at least one")
        if not (np.isfinite(self.ambient_fraction) and self.ambient_fraction > 0.0):
            raise ValueError(
                f"ambient_fraction is {self.ambient_fraction}, expected a positive number"
            )
        for name in ("exponent", "gloss_exponent"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value}, expected a positive number")
        if not (np.isfinite(self.gloss) and self.gloss >= 0.0):
            raise ValueError(f"gloss is {self.gloss}, expected 0 or more")


@dataclass(frozen=True)
class Vignetting:
    """Loss of brightness towards the edge of the image, fixed to the camera.

    Attributes:
        falloff: c1, c2, ...: brightness is 1 + c1 s + c2 s^2 + ... with s the square of the
            distance from the principal point over half the image's height.
    """

    falloff: tuple[float, ...] = ()

    @classmethod
    def from_specification(cls, specification: VignettingSpecification) -> Vignetting:
        """Return the vignetting of a sensor's file."""
        return cls(specification.falloff)

    def of_part(self, height_share: float) -> Vignetting:
        """Return the vignetting of a part of the image, by its share of the image's height."""
        falloff = [
            factor * height_share ** (2 * power) for power, factor in enumerate(self.falloff, 1)
        ]
        return Vignetting(tuple(falloff))

    def brightness(self, camera: Camera) -> Float32Array:
        """Return (H, W) brightness relative to the principal point.

        No pixel gets less than a thousandth, so that dividing by it is safe.
        """
        x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        offset = np.stack([x, y], axis=-1) - camera.principal_point_px
        square = np.sum((offset / (0.5 * camera.height)) ** 2, axis=-1)
        brightness = np.polynomial.polynomial.polyval(square, [1.0, *self.falloff])
        return np.maximum(brightness, 1e-3).astype(np.float32)
