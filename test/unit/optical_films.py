# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Synthetic films of contacts and residuals of a known covariance, for tests of optical effects."""

from functools import cache

import cv2
import numpy as np
from scipy import ndimage

from dotsim_ros.gap.images.model import Film
from dotsim_ros.gap.images.tile_noise import Correlation, TileNoise, contact_change
from dotsim_ros.gap.images.tiles import NAMES, TileMeter, tile_grid
from dotsim_ros.geometry.camera import FisheyeCamera

HEIGHT, WIDTH = 60, 80
FRAMES = 4
CENTRE, FOCAL = np.array([39.5, 29.5]), 20.0
LIT = np.hypot(*np.meshgrid(np.arange(WIDTH) - 39.5, np.arange(HEIGHT) - 29.5)) < 28.0
CHOSEN = (
    "ambient_light",
    "auto_exposure",
    "camera_intrinsics",
    "gamma",
    "led_imbalance_red",
    "vignetting",
)
REFERENCES, NULLS = range(20, 28), 40


def idle_frame():
    """Return a speckled image (H, W, 3) lit from three sides."""
    random = np.random.default_rng(1)
    speckle = cv2.GaussianBlur(random.standard_normal((HEIGHT, WIDTH)), (0, 0), 1.0)
    level = 100.0 + 40.0 * np.tanh(4.0 * speckle)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    side = np.stack(
        [
            1.0 + 0.4 * np.cos(a) * (x - 40) / 40 + 0.4 * np.sin(a) * (y - 30) / 30
            for a in (0, 2, 4)
        ],
        axis=-1,
    )
    return np.where(LIT[..., None], level[..., None] * side, 0.0)


IDLE = idle_frame()
CAMERA_HEIGHT_M, DOME_M = 2.5e-3, 15.75e-3
CAMERA = FisheyeCamera(WIDTH, HEIGHT, FOCAL, CENTRE)
RAYS = CAMERA.rays()[0]


def dome_depth_m(rays, displacement_m=(0.0, 0.0, 0.0)):
    """Return how far a dome is along rays (..., 3) from a camera above its centre."""
    start = np.array([0.0, 0.0, CAMERA_HEIGHT_M]) + displacement_m
    along = rays @ start
    return -along + np.sqrt(along**2 - start @ start + DOME_M**2)


def film_of(number):
    """Return a film of a contact that darkens a place of the image."""
    random = np.random.default_rng(100 + number)
    middle = random.uniform([25.0, 20.0], [55.0, 40.0])
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    dent = np.exp(-((x - middle[0]) ** 2 + (y - middle[1]) ** 2) / 60.0)[..., None]
    depth = np.linspace(0.0, 0.4, FRAMES)[:, None, None, None]
    # As far as 3 mm from where it was, and with the dome's normals, as if it were smooth.
    depth_m = dome_depth_m(RAYS) * (1.0 - 0.5 * depth * dent)[..., 0]
    normal = -(RAYS * dome_depth_m(RAYS)[..., None] + [0.0, 0.0, CAMERA_HEIGHT_M]) / DOME_M
    return Film(
        0.1 * np.arange(FRAMES),
        10.0 * number + 0.1 * np.arange(FRAMES),
        (IDLE * (1.0 - depth * dent)).astype(np.float32),
        np.zeros((FRAMES, HEIGHT, WIDTH, 2), dtype=np.float32),
        depth_m.astype(np.float32),
        np.broadcast_to(normal, (FRAMES, HEIGHT, WIDTH, 3)).astype(np.float32),
        IDLE,
        CENTRE,
        FOCAL,
        CAMERA.projection,
    )


def truth():
    """Return the covariance that the synthetic residuals are drawn from."""
    tiles = len(METER.grid)
    scale = np.array([0.5, 0.5, 0.5, 0.02, 0.05, 0.05])
    mixing = np.eye(6)
    mixing[:3, :3] = np.linalg.inv(np.linalg.cholesky(0.7 * np.eye(3) + 0.3))
    return TileNoise(
        METER.grid.centre_px,
        np.tile(0.2 * scale, (tiles, 1)),
        np.tile(scale, (tiles, 1)),
        0.1 * scale,
        mixing,
        tuple(Correlation(0.6, 2.0, 20.0) for _ in NAMES),
        len(REFERENCES),
    )


METER = TileMeter(tile_grid(LIT, columns=6, rows=4), IDLE)
FILMS = [film_of(number) for number in range(6)]


def changes_of(films):
    rest = [np.broadcast_to(IDLE, film.pixels.shape) for film in films]
    return [
        contact_change(METER.difference(film.pixels, one))
        for film, one in zip(films, rest, strict=True)
    ]


CHANGES = changes_of(FILMS)


@cache
def roots():
    """Return what turns normal numbers into correlated ones, of any channel of `truth`."""
    distance = np.linalg.norm(METER.grid.centre_px[:, None] - METER.grid.centre_px[None], axis=2)
    lag = np.abs(np.subtract.outer(np.arange(FRAMES), np.arange(FRAMES)))
    one = truth().correlations[0]
    shared = np.kron(np.exp(-lag / one.frames), np.exp(-distance / one.length_px))
    return np.linalg.cholesky(one.white * np.eye(len(shared)) + (1.0 - one.white) * shared)


def drawn(change, random):
    """Return a residual (F, T, 6) of the true covariance, by inverting what whitens it."""
    noise = truth()
    values = roots() @ random.standard_normal((len(roots()), 6))
    unmixed = values @ np.linalg.inv(noise.mixing).T
    return unmixed.reshape(change.shape) * noise.deviation(change)


def null_residual(seed):
    random = np.random.default_rng(seed)
    return [drawn(change, random) for change in CHANGES]


def out_of_focus(film):
    # A lens of 0.9 mm in focus at 9 mm, its blur that of a bell and in steps of the depth.
    vergence = np.abs(1.0 / film.depth_m - 1.0 / 9e-3)
    blur_px = np.round(0.25 * FOCAL * 0.9e-3 * vergence / 0.02) * 0.02
    result = film.pixels.copy()
    for frame, image in enumerate(film.pixels):
        # Finer pixels: a bell of a fifth of a pixel has no blur on its own.
        fine = cv2.resize(image, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
        for width_px in np.unique(blur_px[frame][blur_px[frame] > 0.0]):
            soft = cv2.GaussianBlur(fine, (0, 0), 4.0 * float(width_px))
            soft = cv2.resize(soft, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
            same = cv2.resize(fine, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
            there = blur_px[frame] == width_px
            result[frame][there] += (soft - same)[there]
    return result


def beside_a_lamp(film, direction, level):
    # A lamp far away: Lambert's cosine, and nothing where the skin turns from it.
    return film.pixels + level * np.maximum(-film.normal @ direction, 0.0)[..., None]


def seen_from(film, displacement_m):
    # Where the dome, without its dents, was seen before.
    point_m = RAYS * dome_depth_m(RAYS, displacement_m)[..., None] + displacement_m
    x, y = np.moveaxis(CAMERA.project_optical(point_m), -1, 0)
    return np.stack(
        [
            np.stack(
                [
                    ndimage.map_coordinates(image[..., k], [y, x], order=3, mode="nearest")
                    for k in range(3)
                ],
                axis=-1,
            )
            for image in film.pixels
        ]
    )


def vignetted(pixels):
    # cos^4 and not r^2: 10 % at half the image's height from the axis.
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    radius = np.hypot(x - CENTRE[0], y - CENTRE[1]) / (0.5 * HEIGHT)
    angle = np.arccos(0.9**0.25)
    return pixels * (np.cos(np.minimum(radius * angle, 1.5)) ** 4)[..., None]
