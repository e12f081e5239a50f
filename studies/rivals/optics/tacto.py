# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tacto's image: the clipped surface under Phong's light, its change added to the idle image.

Wang, Lambeta, Chou, Calandra: "TACTO: A Fast, Flexible, and Open-Source Simulator for
High-Resolution Vision-Based Tactile Sensors", RA-L 7(2), 2022 (arXiv 2012.08456). A renderer lights
the object that has sunk into the gel, and the gel next to it, by a few coloured point lights on a
ring; the rendering without contact is subtracted, and the difference added to the real sensor's
image without contact. Light is calibrated by hand there; here by least squares.

The lights are as the published files have them: three on a ring, each anywhere around it. The light
of each is Phong's (1975), diffuse and specular, and falls with the square of the distance. How much
of it each colour of the camera gets is fitted, and must not be negative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import differential_evolution, nnls

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from dotsim_ros.twin.footage import OpticalPress, Rest
from studies.rivals.optics.pixels import (
    FULL_SCALE,
    Ground,
    check_frames,
    filled_normal,
    idle_ground,
    pixel_grid,
    seen_region,
)

SEARCH_PIXELS = 20_000
GENERATIONS = 40
POPULATION_FACTOR = 8
BOUNDS = (
    (4.0e-3, 16.0e-3),
    (-8.0e-3, 8.0e-3),
    (0.0, 2.0 * np.pi),
    (0.0, 2.0 * np.pi),
    (0.0, 2.0 * np.pi),
    (0.0, 5.0),
)
"""Searched ranges: radius of the ring and its place along the optical axis, metres; the lights'
azimuths; the logarithm of Phong's exponent to the base of two."""
SCALE_M = 0.01
"""Unit of length in which light falls with distance, so that intensities are of common size."""


@dataclass(frozen=True)
class Surface:
    """N points of a skin in the optical frame.

    Attributes:
        position_m: (N, 3).
        normal: (N, 3) unit, towards the camera.
    """

    position_m: FloatArray
    normal: FloatArray


@dataclass(frozen=True)
class PhongLight:
    """Where the lights are, and how sharp the gloss.

    Attributes:
        radius_m, axial_m: of the ring, around the optical axis and along it.
        azimuth_rad: of each light, from the image's right towards its bottom.
        shininess: Phong's exponent.
    """

    radius_m: float
    axial_m: float
    azimuth_rad: tuple[float, ...]
    shininess: float

    def basis(self, surface: Surface) -> FloatArray:
        """Return (N, 2 lights) light that is reflected to the camera at unit intensity: the
        diffuse part of each light, then the specular one."""
        view = -surface.position_m / np.linalg.norm(surface.position_m, axis=1, keepdims=True)
        cosine = np.sum(view * surface.normal, axis=1, keepdims=True)
        mirrored = 2.0 * cosine * surface.normal - view
        diffuse, specular = [], []
        for azimuth in self.azimuth_rad:
            place = [
                self.radius_m * np.cos(azimuth),
                self.radius_m * np.sin(azimuth),
                self.axial_m,
            ]
            towards = np.asarray(place) - surface.position_m
            distance = np.linalg.norm(towards, axis=1)
            falloff = (SCALE_M / distance) ** 2
            incidence = np.sum(towards * surface.normal, axis=1) / distance
            gloss = np.sum(towards * mirrored, axis=1) / distance
            lit = incidence > 0.0
            diffuse.append(falloff * np.maximum(incidence, 0.0))
            specular.append(falloff * lit * np.maximum(gloss, 0.0) ** self.shininess)
        return np.stack([*diffuse, *specular], axis=1)


def surface_of(
    depth_m: Float32Array, normal: Float32Array, rest: Rest, rays: FloatArray
) -> Surface:
    """Return the points that the seen pixels show; the skin at rest where a frame shows none.

    Args:
        depth_m: (H, W).
        normal: (H, W, 3).
        rest: of the gel untouched.
        rays: (H, W, 3) directions of the pixels.
    """
    seen = seen_region(rest)
    depth = np.where(np.isfinite(depth_m), depth_m, rest.depth_m)[seen].astype(np.float64)
    return Surface(
        depth[:, None] * rays[seen],
        filled_normal(normal, rest.normal)[seen].astype(np.float64),
    )


@dataclass(frozen=True)
class TactoImage:
    """The fitted lights.

    Attributes:
        light: places and gloss.
        intensity: (2 lights, 3) what each gives to red, green and blue, full scale 1.
        camera: whose pixels the surface is seen through.
        name: how tables call it.
        ground: what the change is added to.
    """

    light: PhongLight
    intensity: FloatArray
    camera: Camera
    name: str = "tacto"
    ground: Ground = idle_ground

    def predict(self, press: OpticalPress, rest: Rest) -> ImageArray:
        """Return images (F, H, W, 3); see `studies.optics.judge.ImageModel`.

        Args:
            press: with the depth and the normals of Tacto's own, clipped skin.
            rest: of the gel untouched.
        """
        rays = self.camera.rays()[0]
        grid = pixel_grid(rest)
        untouched = self._shaded(rest.depth_m, rest.normal, rest, rays)
        images = []
        for depth, normal, below in zip(
            press.depth_m, press.normal, self.ground(press, rest), strict=True
        ):
            change = self._shaded(depth, normal, rest, rays) - untouched
            images.append(grid.changed(below, change))
        return np.stack(images)

    def _shaded(
        self, depth_m: Float32Array, normal: Float32Array, rest: Rest, rays: FloatArray
    ) -> FloatArray:
        return self.light.basis(surface_of(depth_m, normal, rest, rays)) @ self.intensity


def fit(
    train: Sequence[OpticalPress],
    rest: Rest,
    camera: Camera,
    *,
    seed: int = 0,
    ground: Ground = idle_ground,
) -> TactoImage:
    """Return the lights of least squared error of the colour over the seen pixels.

    Differential evolution within `BOUNDS`, of a fixed length, over places and gloss, on
    `SEARCH_PIXELS` pixels drawn by the seed; for each, the intensities that are not negative and
    have the least squared error (Lawson and Hanson 1974).

    Args:
        train: frames to fit on, with the depth and the normals of Tacto's own, clipped skin.
        rest: of the gel untouched.
        camera: whose pixels the surface is seen through.
        seed: of the pixels and of the search.
        ground: what the change is added to.

    Raises:
        ValueError: no frame.
    """
    check_frames(train)
    pressed, untouched, change = _search_pixels(train, rest, camera, seed, ground)

    def solved(parameters: FloatArray) -> tuple[PhongLight, FloatArray, float]:
        light = _light_of(parameters)
        basis = light.basis(pressed) - light.basis(untouched)
        intensity, error = _intensities(basis, change)
        return light, intensity, error

    found = differential_evolution(
        lambda parameters: solved(parameters)[2],
        BOUNDS,
        maxiter=GENERATIONS,
        popsize=POPULATION_FACTOR,
        rng=seed,
        polish=False,
        tol=0.0,
    )
    light, intensity, _ = solved(found.x)
    return TactoImage(light, intensity, camera, ground=ground)


def _light_of(parameters: FloatArray) -> PhongLight:
    radius, axial, *azimuth, sharpness = (float(value) for value in parameters)
    return PhongLight(radius, axial, tuple(azimuth), 2.0**sharpness)


def _intensities(basis: FloatArray, change: FloatArray) -> tuple[FloatArray, float]:
    """Return intensities (2 lights, 3) and the mean squared error that they leave."""
    # The factor R of basis = QR has the same least squares and few rows.
    q, r = np.linalg.qr(basis)
    target = q.T @ change
    columns = [nnls(r, target[:, colour]) for colour in range(3)]
    intensity = np.stack([column[0] for column in columns], axis=1)
    outside = float(np.sum(change**2) - np.sum(target**2))
    error = outside + sum(column[1] ** 2 for column in columns)
    return intensity, error / change.size


def _search_pixels(
    train: Sequence[OpticalPress],
    rest: Rest,
    camera: Camera,
    seed: int,
    ground: Ground,
) -> tuple[Surface, Surface, FloatArray]:
    rays = camera.rays()[0]
    seen: BoolArray = seen_region(rest)
    untouched = surface_of(rest.depth_m, rest.normal, rest, rays)
    random = np.random.default_rng(seed)
    frame_count = sum(len(press.measured) for press in train)
    share = max(1, SEARCH_PIXELS // frame_count)
    parts = []
    for press in train:
        for depth, normal, measured, below in zip(
            press.depth_m, press.normal, press.measured, ground(press, rest), strict=True
        ):
            surface = surface_of(depth, normal, rest, rays)
            change = (measured[seen].astype(np.float64) - below[seen]) / FULL_SCALE
            drawn = random.choice(len(change), size=min(share, len(change)), replace=False)
            parts.append(
                (
                    surface.position_m[drawn],
                    surface.normal[drawn],
                    untouched.position_m[drawn],
                    untouched.normal[drawn],
                    change[drawn],
                )
            )
    position, normal_at, rest_position, rest_normal, change = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    return Surface(position, normal_at), Surface(rest_position, rest_normal), change
