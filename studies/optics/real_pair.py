# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How much of one real image of a press the motion of the gel explains.

Of a real DenseTact there is one pair of images, idle and pressed, without a pose. The press is
fitted to the image: a ball on the dome, where and how deep, so that the warped image comes closest
to the measured one. No learned model takes part; reported is how much better than the floor, the
idle image, an image is by motion alone, and by motion with first-order shading.

The press is searched without gradients: a grid of directions and depths around where the image
changes most, then Nelder and Mead's simplex (1965).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.optimize import minimize

from dotsim_ros.data.motion import pose_along
from dotsim_ros.gel.make import make_gel, skin_of
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.io.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from dotsim_ros.io.files import parameter_path, read_image
from dotsim_ros.optics.idle import LitDisc, read_description
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.lighting import Lighting, Vignetting
from dotsim_ros.optics.renderer import SkinRenderer, View
from dotsim_ros.specification import SensorSpecification, load_sensor
from studies.data import REAL
from studies.optics.image_scores import score_image

DESCRIPTION = "images/densetact_real_idle.yaml"
BALL_RADIUS_M = 4.0e-3
"""Consistent with the recorded presses on such sensors; the shape was not recorded."""
GRID_OFFSETS = (-0.1, 0.0, 0.1)
GRID_DEPTHS_M = (0.5e-3, 1.5e-3, 2.5e-3, 3.5e-3)
DEPTH_UNIT_M = 10.0e-3
"""Depth that counts as one in the search, as a whole radian of direction does."""
DEEPEST_M = 4.5e-3
WIDEST_SINE = 0.9
FIRST_SIMPLEX = 0.04
EVALUATIONS = 60
PRESS_S = 0.5
UNCHANGING = Lighting(ambient_fraction=1e9)

CHANGE_SMOOTHING_PX = 3.0
FINE_PX, COARSE_PX, CONTRAST_PX = 1.0, 5.0, 6.0
CONTRAST_FLOOR = 3.0
"""Grey levels below which contrast is noise and is not lifted."""


@dataclass(frozen=True)
class BallPose:
    """Where a ball presses the dome, along its normal.

    Attributes:
        x, y: of the unit vector from the dome's centre to the place.
        depth_m: of the tip below the skin at rest.
    """

    x: float
    y: float
    depth_m: float


@dataclass(frozen=True)
class RealPair:
    """An idle and a pressed image of one sensor.

    Attributes:
        idle, pressed: (H, W, 3) uint8, red, green, blue.
        mask: (H, W) the lit disc.
    """

    idle: ImageArray
    pressed: ImageArray
    mask: BoolArray


def read_real_pair(directory: Path) -> RealPair:
    """Read idle.png, pressed.png and mask.png, the latter at any resolution.

    Raises:
        FileNotFoundError: one of them is not there.
        ValueError: one is no image, or the two differ in size.
    """
    images = {}
    for name in ("idle", "pressed", "mask"):
        path = directory / f"{name}.png"
        if not path.is_file():
            raise FileNotFoundError(f"no {path}; expected idle.png, pressed.png and mask.png")
        images[name] = read_image(path)
    idle, pressed = images["idle"], images["pressed"]
    if idle.shape != pressed.shape:
        raise ValueError(f"idle.png has shape {idle.shape}, pressed.png {pressed.shape}")
    height, width = idle.shape[:2]
    mask = cv2.resize(images["mask"][..., 0], (width, height), interpolation=cv2.INTER_AREA)
    return RealPair(idle, pressed, np.asarray(mask > 127))


def pattern_of(image: ImageArray) -> Float32Array:
    """Return the fine pattern (H, W, 3) at even contrast, without what shading does to it."""
    levels = image.astype(np.float32)
    fine = cv2.GaussianBlur(levels, (0, 0), FINE_PX) - cv2.GaussianBlur(levels, (0, 0), COARSE_PX)
    contrast = np.sqrt(cv2.GaussianBlur(fine * fine, (0, 0), CONTRAST_PX))
    return np.asarray(fine / (contrast + CONTRAST_FLOOR), dtype=np.float32)


def pattern_likeness(image: ImageArray, other: ImageArray, region: BoolArray) -> float:
    """Return the correlation of the patterns of two images over a region, 1 for the same."""
    first, second = pattern_of(image)[region], pattern_of(other)[region]
    return float(np.sum(first * second) / np.sqrt(np.sum(first**2) * np.sum(second**2)))


def place_of_change(pair: RealPair, camera: Camera, radius_m: float) -> tuple[float, float]:
    """Return x and y of the unit vector to where the image changes most."""
    change = np.abs(pair.pressed.astype(np.float32) - pair.idle).sum(axis=2)
    weight = cv2.GaussianBlur(change, (0, 0), CHANGE_SMOOTHING_PX) ** 3 * pair.mask
    rows, columns = np.mgrid[: weight.shape[0], : weight.shape[1]]
    centre = [float(np.sum(weight * axis) / np.sum(weight)) for axis in (columns, rows)]
    ray = camera.unproject(centre) @ camera.pose.rotation().T
    origin = camera.pose.position_m
    along = float(ray @ origin)
    length = -along + np.sqrt(along**2 - float(origin @ origin) + radius_m**2)
    place = (origin + length * ray) / radius_m
    return float(place[0]), float(place[1])


class PressSearch:
    """Presses a ball into the gel, and looks at it through the pair's camera.

    Args:
        pair: the images.
        sensor: the gel.
        disc: where the lit disc lies in the images.
        lighting, vignetting: of the real sensor, as far as they are known.
    """

    def __init__(
        self,
        pair: RealPair,
        sensor: SensorSpecification,
        disc: LitDisc,
        lighting: Lighting,
        vignetting: Vignetting,
    ) -> None:
        height, width = pair.idle.shape[:2]
        self.pair = pair
        self.camera = disc.camera(width, height, Camera.from_specification(sensor.camera).pose)
        self._radius_m = sensor.gel.outer_radius_m
        skin = skin_of(sensor.gel)
        self._gel = make_gel(sensor, skin, sphere(BALL_RADIUS_M))
        self._renderer = SkinRenderer(self.camera, skin)
        self.warping = ImageRenderer(self.camera, skin, pair.idle, lighting=UNCHANGING)
        self.shading = ImageRenderer(
            self.camera, skin, pair.idle, lighting=lighting, vignetting=vignetting
        )

    def view(self, ball: BallPose) -> View:
        """Return what the camera sees of the gel under a ball, pressed from rest."""
        outward = np.array([ball.x, ball.y, np.sqrt(1.0 - ball.x**2 - ball.y**2)])
        tip = (self._radius_m - ball.depth_m) * outward
        self._gel.reset()
        position = self._gel.step(pose_along(tip, outward), PRESS_S).skin_position_m
        return self._renderer.render(position)

    def grid(self) -> dict[BallPose, View]:
        """Return the views of a grid of presses around where the image changes most."""
        x, y = place_of_change(self.pair, self.camera, self._radius_m)
        balls = [
            BallPose(x + dx, y + dy, depth)
            for dx in GRID_OFFSETS
            for dy in GRID_OFFSETS
            for depth in GRID_DEPTHS_M
        ]
        return {ball: self.view(ball) for ball in balls if _allowed(ball)}

    def best(
        self, grid: dict[BallPose, View], error: Callable[[View], float]
    ) -> tuple[BallPose, View]:
        """Return the press of least error, from the best one of a grid."""
        start = min(grid, key=lambda ball: error(grid[ball]))

        def at(parameters: FloatArray) -> float:
            ball = _ball_of(parameters)
            return error(self.view(ball)) if _allowed(ball) else np.inf

        first = np.array([start.x, start.y, start.depth_m / DEPTH_UNIT_M])
        simplex = np.stack([first, *(first + FIRST_SIMPLEX * np.eye(3))])
        found = minimize(
            at,
            first,
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "maxfev": EVALUATIONS},
        )
        ball = _ball_of(found.x)
        return ball, self.view(ball)


def _ball_of(parameters: FloatArray) -> BallPose:
    x, y, depth = (float(value) for value in parameters)
    return BallPose(x, y, depth * DEPTH_UNIT_M)


def _allowed(ball: BallPose) -> bool:
    return 0.0 <= ball.depth_m <= DEEPEST_M and np.hypot(ball.x, ball.y) <= WIDEST_SINE


def real_pair(*, data: Path = REAL / "densetact", sensor: str = "densetact2") -> dict[str, Any]:
    """One real image of a DenseTact, explained by a press.

    Args:
        data: folder of idle.png, pressed.png and mask.png.
        sensor: name or file of the sensor.

    Raises:
        FileNotFoundError, ValueError: as `read_real_pair`.
    """
    description = parameter_path(DESCRIPTION)
    described = read_description(description)
    disc, (lighting, vignetting) = described.disc, described.lights()
    if disc is None:
        raise ValueError(f"{description} does not say where the lit disc lies")
    pair = read_real_pair(data)
    return evaluate_real_pair(PressSearch(pair, load_sensor(sensor), disc, lighting, vignetting))


def evaluate_real_pair(search: PressSearch) -> dict[str, Any]:
    """Return the figures of the idle image and of the images of the presses that fit best.

    Rows: `idle`; `carried_by_pattern`, the warped image of the press whose pattern is most like the
    measured one; `carried`, the warped image of the press of least squared error of the image;
    `shaded_by_pattern`, the first press with first-order shading; `shaded`, motion and shading of
    the press of least squared error.
    """
    pair = search.pair
    # The disc's rim does not move and would outweigh the pattern.
    inner = cv2.erode(pair.mask.astype(np.uint8), np.ones((9, 9), dtype=np.uint8)) > 0
    measured = pair.pressed.astype(np.float64)

    def squared(image: ImageArray) -> float:
        return float(np.mean((image[pair.mask] - measured[pair.mask]) ** 2))

    def row(image: ImageArray, ball: BallPose | None) -> dict[str, Any]:
        score = score_image(image, pair.pressed, {"frame": None, "mask": pair.mask})
        return {
            **asdict(score["frame"]),
            "mask": asdict(score["mask"]),
            "pattern_likeness": pattern_likeness(image, pair.pressed, inner),
            "press": None if ball is None else asdict(ball),
        }

    rows = {"idle": row(pair.idle, None)}
    print("pressing a ball into the gel, from many sides")
    grid = search.grid()
    print("fitting the press to the pattern")
    ball, view = search.best(
        grid, lambda v: -pattern_likeness(search.warping.warp(v), pair.pressed, inner)
    )
    rows["carried_by_pattern"] = row(search.warping.warp(view), ball)
    rows["shaded_by_pattern"] = row(search.shading.warp(view), ball)
    for name, renderer in (("carried", search.warping), ("shaded", search.shading)):
        print(f"fitting the press to the image, {name}")
        ball, view = search.best(grid, lambda v, r=renderer: squared(r.warp(v)))  # type: ignore[misc]
        rows[name] = row(renderer.warp(view), ball)
    return {"rows": rows, "ball_radius_mm": 1e3 * BALL_RADIUS_M}
