"""The models of the image on a real flat sensor: presses of a ball on a GelSight.

The recording (Rancho-zhao/FOTS, `mlp_calib/`, MIT) holds images of a ball of known diameter, with
the circle of contact marked by hand in each, and one image without contact. The pose of the ball
and the force were not recorded, so the shape of the gel is inferred from the circle:

- by this package's gel: a flat pad pressed by the ball, as deep as makes the circle of contact. The
  pad is wide, so the press is solved once in its middle, and its displacement, a function of the
  distance from the ball's axis, is laid where the circle is.
- as a cap: the ball's surface inside the circle and a flat gel around it, which is how Taxim and
  FOTS label such presses for their own calibration.

The camera looks straight at the pad through a lens without distortion, so that a millimetre of the
flat gel has the recording's number of pixels everywhere. How far away it is was not recorded.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dotsim_ros.arrays import BoolArray, FloatArray, ImageArray
from dotsim_ros.baselines.optics import per_pixel
from dotsim_ros.evaluation.optics.judge import Factory, mean_score
from dotsim_ros.evaluation.optics.models import FitSettings, factory_of
from dotsim_ros.evaluation.table import Column, entry_list, markdown_table
from dotsim_ros.gel.make import make_gel, skin_of
from dotsim_ros.geometry.camera import Camera, FisheyeCamera
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.metrics.images import score_image
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.lighting import Lighting
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import (
    GelSpecification,
    SensorSpecification,
    SolverSpecification,
)
from dotsim_ros.twin.footage import OpticalPress, Rest

BALL_RADIUS_M = 2.35e-3
PIXELS_PER_METRE = 19.58e3
HELD_OUT = 8
CONTACT_REACH = 1.5
"""Radius of the judged region around a contact, over the circle's."""

SENSOR = SensorSpecification(
    name="gelsight",
    gel=GelSpecification(
        shape="flat_pad", pad_size_m=(0.020, 0.025, 0.004), skin_spacing_m=0.25e-3
    ),
    solver=SolverSpecification(grid_spacing_m=1.0e-3, refined=False),
)
"""The pad's thickness is not recorded; silicone as its maker states that of a DenseTact."""
CAMERA_DISTANCE_M = 0.03
"""Distance of the camera from the pad's face; such sensors are about as large."""
PINHOLE = (1.0 / 3.0, 2.0 / 15.0, 17.0 / 315.0, 62.0 / 2835.0)
"""Coefficients of the tangent's series: an equidistant lens with them is a pinhole."""
FIRST_DEPTH_M = 0.4e-3
LAST_DEPTH_M = 2.4e-3
DEPTH_STEP_M = 0.1e-3
STEP_S = 0.05
TOUCHING_M = 40.0e-6
PROFILE_STEP_M = 0.1e-3
UNCHANGING = Lighting(ambient_fraction=1e9)
"""The real sensor's lights are not known; what changes is left to be learned."""


@dataclass(frozen=True)
class BallPress:
    """One image of the ball.

    Attributes:
        name: of the file.
        centre_px: (2,) centre of the circle of contact, x then y.
        radius_px: its radius.
        image: (H, W, 3) uint8, red, green, blue.
    """

    name: str
    centre_px: FloatArray
    radius_px: float
    image: ImageArray


def read_ball_presses(directory: Path) -> tuple[ImageArray, list[BallPress]]:
    """Return the image without contact, and the presses sorted by name.

    Args:
        directory: with idle.png, contact_circles.csv and the images that it names.

    Raises:
        FileNotFoundError: one of them is not there.
        ValueError: a file that is no image or of another size, or a row that is no circle.
    """
    idle = _read_image(directory / "idle.png")
    table = directory / "contact_circles.csv"
    if not table.is_file():
        raise FileNotFoundError(f"no {table}; expected rows of file, centre x, centre y, radius")
    presses = []
    with table.open(newline="", encoding="utf-8") as stream:
        for number, row in enumerate(csv.DictReader(stream), start=2):
            try:
                name = str(row["img_names"])
                centre = np.array([float(row["center_x"]), float(row["center_y"])])
                radius = float(row["radius"])
            except (KeyError, TypeError, ValueError) as error:
                raise ValueError(
                    f"{table}, line {number}: {row} is no circle; expected the columns img_names, "
                    "center_x, center_y, radius"
                ) from error
            image = _read_image(directory / name)
            if image.shape != idle.shape:
                raise ValueError(
                    f"{directory / name} has shape {image.shape}, expected that of idle.png, "
                    f"{idle.shape}"
                )
            presses.append(BallPress(name, centre, radius, image))
    return idle, sorted(presses, key=lambda press: press.name)


def _read_image(path: Path) -> ImageArray:
    if not path.is_file():
        raise FileNotFoundError(f"no image {path}")
    pixels = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if pixels is None:
        raise ValueError(f"{path} is no image that OpenCV can read")
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def flat_camera(width: int, height: int, thickness_m: float) -> Camera:
    """Return the camera that looks up at a pad's face from below."""
    return FisheyeCamera(
        width=width,
        height=height,
        focal_px=PIXELS_PER_METRE * CAMERA_DISTANCE_M,
        principal_point_px=np.array([0.5 * (width - 1), 0.5 * (height - 1)]),
        distortion=np.array(PINHOLE),
        pose=Pose(np.array([0.0, 0.0, thickness_m - CAMERA_DISTANCE_M])),
    )


@dataclass(frozen=True)
class PressProfiles:
    """How a ball moves a wide pad's face, D depths.

    Attributes:
        contact_radius_m: (D,) radius of the circle of contact, increasing.
        distance_m: (N,) from the ball's axis, at rest.
        outward_m: (D, N) displacement away from the axis.
        upward_m: (D, N) displacement along +z, negative under the ball.
    """

    contact_radius_m: FloatArray
    distance_m: FloatArray
    outward_m: FloatArray
    upward_m: FloatArray

    def displace(self, skin: SkinMesh, axis_m: FloatArray, contact_radius_m: float) -> FloatArray:
        """Return the skin (V, 3) pressed beside the middle.

        Args:
            skin: at rest.
            axis_m: (2,) where the ball's axis meets the pad, x and y in the base frame.
            contact_radius_m: of the circle of contact; beyond those known, the nearest one.
        """
        known = self.contact_radius_m
        place = float(np.interp(contact_radius_m, known, np.arange(len(known), dtype=np.float64)))
        lower = min(int(place), len(known) - 2)
        share = place - lower
        offset = skin.rest_position_m[:, :2] - axis_m
        distance = np.linalg.norm(offset, axis=1)
        outward, upward = (
            np.interp(
                distance,
                self.distance_m,
                (1.0 - share) * field[lower] + share * field[lower + 1],
            )
            for field in (self.outward_m, self.upward_m)
        )
        direction = offset / np.maximum(distance, 1e-9)[:, None]
        moved = skin.rest_position_m.copy()
        moved[:, :2] += outward[:, None] * direction
        moved[:, 2] += upward
        return moved


def press_profiles(sensor: SensorSpecification, ball_radius_m: float) -> PressProfiles:
    """Press a ball into the middle of a pad, ever deeper, and return what its face does.

    Raises:
        ValueError: the gel could not be solved.
    """
    skin = skin_of(sensor.gel)
    gel = make_gel(sensor, skin, sphere(ball_radius_m))
    top = sensor.gel.pad_size_m[2]
    rest = skin.rest_position_m
    distance = np.linalg.norm(rest[:, :2], axis=1)
    # One ring of vertices after the other: their mean has no direction that the grid prefers.
    ring = np.minimum(distance / PROFILE_STEP_M, 1e6).astype(np.int64)
    inside = distance < 0.5 * min(sensor.gel.pad_size_m[:2])
    counts = np.bincount(ring[inside])
    filled = counts > 0
    mean_distance = np.bincount(ring[inside], distance[inside])[filled] / counts[filled]
    radial = rest[:, :2] / np.maximum(distance, 1e-9)[:, None]
    radii: list[float] = []
    outward: list[FloatArray] = []
    upward: list[FloatArray] = []
    for depth in np.arange(FIRST_DEPTH_M, LAST_DEPTH_M + 1e-9, DEPTH_STEP_M):
        pose = Pose(np.array([0.0, 0.0, top - depth]))
        position = gel.step(pose, STEP_S).skin_position_m
        motion = position - rest
        gap = np.linalg.norm(position - pose.position_m - [0.0, 0.0, ball_radius_m], axis=1)
        touching = np.linalg.norm(position[:, :2], axis=1)[gap < ball_radius_m + TOUCHING_M]
        radii.append(float(touching.max(initial=0.0)))
        for kept, values in (
            (outward, np.sum(motion[:, :2] * radial, axis=1)),
            (upward, motion[:, 2]),
        ):
            kept.append(np.bincount(ring[inside], values[inside])[filled] / counts[filled])
    # The outermost vertex in contact steps from ring to ring; a parabola goes through the middle.
    depths = np.arange(len(radii), dtype=np.float64)
    smooth = np.polynomial.Polynomial.fit(depths, radii, 2)(depths)
    rising = np.maximum.accumulate(smooth) + 1e-9 * depths
    return PressProfiles(rising, mean_distance, np.stack(outward), np.stack(upward))


@dataclass(frozen=True)
class FlatScene:
    """A camera over a pad, and what it sees at rest."""

    camera: Camera
    skin: SkinMesh
    rest: Rest

    def axis_m(self, press: BallPress) -> FloatArray:
        """Return (2,) where the ball's axis meets the pad, base frame."""
        return np.asarray((press.centre_px - self.camera.principal_point_px) / PIXELS_PER_METRE)


def flat_scene(idle: ImageArray, sensor: SensorSpecification = SENSOR) -> FlatScene:
    """Return the camera over a pad, with the image without contact."""
    height, width = idle.shape[:2]
    camera = flat_camera(width, height, sensor.gel.pad_size_m[2])
    skin = skin_of(sensor.gel)
    view = SkinRenderer(camera, skin).render(skin.rest_position_m)
    lit = np.ones(idle.shape[:2], dtype=np.bool_)
    return FlatScene(camera, skin, Rest(idle, view.depth_m, view.normal, lit))


def gel_presses(
    presses: Sequence[BallPress], scene: FlatScene, profiles: PressProfiles
) -> list[OpticalPress]:
    """Return the presses with the shape of this package's gel, one frame each."""
    renderer = SkinRenderer(scene.camera, scene.skin)
    image = ImageRenderer(scene.camera, scene.skin, scene.rest.idle, lighting=UNCHANGING)
    seen = []
    for press in presses:
        position = profiles.displace(
            scene.skin, scene.axis_m(press), press.radius_px / PIXELS_PER_METRE
        )
        view = renderer.render(position)
        deepest = float((scene.skin.rest_position_m - position)[:, 2].max())
        seen.append(
            OpticalPress(
                name=press.name,
                indenter="ball",
                tip_depth_m=np.array([deepest]),
                measured=press.image[None],
                depth_m=view.depth_m[None],
                normal=view.normal[None],
                warped=image.warp(view)[None],
            )
        )
    return seen


def cap_presses(
    presses: Sequence[BallPress], given: Sequence[OpticalPress], scene: FlatScene
) -> list[OpticalPress]:
    """Return the presses with the ball's cap on a flat pad instead of the gel's shape.

    Args:
        presses: their circles; that the cap is nearer to the camera moves no pixel.
        given: the same presses, whose other arrays are kept.
        scene: camera and rest.
    """
    height, width = scene.rest.lit.shape
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    capped = []
    for press, other in zip(presses, given, strict=True):
        across = (np.stack([x, y], axis=-1) - press.centre_px) / PIXELS_PER_METRE
        square = np.sum(across**2, axis=-1)
        # A circle as wide as the ball has nowhere deeper to be.
        contact = min(press.radius_px / PIXELS_PER_METRE, 0.999 * BALL_RADIUS_M)
        inside = square < contact**2
        height_m = np.sqrt(np.where(inside, BALL_RADIUS_M**2 - square, 1.0))
        sunk = np.where(inside, height_m - np.sqrt(BALL_RADIUS_M**2 - contact**2), 0.0)
        nearer = 1.0 - sunk / CAMERA_DISTANCE_M
        ball = np.concatenate([across, -height_m[..., None]], axis=-1) / BALL_RADIUS_M
        normal = np.where(inside[..., None], ball, scene.rest.normal)
        capped.append(
            replace(
                other,
                depth_m=(scene.rest.depth_m * nearer).astype(np.float32)[None],
                normal=normal.astype(np.float32)[None],
            )
        )
    return capped


def near_contact(press: BallPress) -> BoolArray:
    """Return (H, W) the pixels within one and a half radii of the circle's centre."""
    height, width = press.image.shape[:2]
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    distance = np.hypot(x - press.centre_px[0], y - press.centre_px[1])
    return np.asarray(distance < CONTACT_REACH * press.radius_px)


def evaluate_gelsight(
    directory: Path,
    *,
    models: Sequence[str],
    settings: FitSettings,
    state: Path,
    held_out: int = HELD_OUT,
    progress: Callable[[str], None] = lambda _line: None,
) -> dict[str, Any]:
    """Return the figures of the models, fitted on some presses and judged on those held out.

    Args:
        directory: of the recording.
        models: names of `MODELS`.
        settings: how models are fitted; the seed draws the presses held out too.
        state: folder of a network's training.
        held_out: how many.
        progress: called with a line that says what is being done.

    Raises:
        FileNotFoundError, ValueError: as `read_ball_presses`, or too few presses.
    """
    idle, presses = read_ball_presses(directory)
    if not 0 < held_out < len(presses):
        raise ValueError(
            f"{held_out} of {len(presses)} presses cannot be held out; expected 1 to "
            f"{len(presses) - 1}"
        )
    progress(f"pressing the ball into a pad, {len(presses)} images to explain")
    scene = flat_scene(idle)
    profiles = press_profiles(SENSOR, BALL_RADIUS_M)
    by_gel = gel_presses(presses, scene, profiles)
    by_cap = cap_presses(presses, by_gel, scene)
    random = np.random.default_rng(settings.seed)
    test = sorted(random.choice(len(presses), size=held_out, replace=False).tolist())
    train = [k for k in range(len(presses)) if k not in test]
    rows: dict[str, Any] = {}
    for model in models:
        shapes = by_cap if model.endswith(CAP) else by_gel
        progress(f"{model}: fitting on {len(train)} presses")
        fitted = _factory(model.removesuffix(CAP), settings, state, progress)(
            [shapes[k] for k in train], scene.rest, scene.camera
        )
        scores = []
        for k in test:
            predicted = fitted.predict(shapes[k], scene.rest)[0]
            regions = {"frame": None, "contact": near_contact(presses[k])}
            scores.append(score_image(predicted, presses[k].image, regions))
        rows[model] = {
            **mean_score([score["frame"] for score in scores]),
            "contact": mean_score([score["contact"] for score in scores]),
        }
    return {
        "rows": rows,
        "train": [presses[k].name for k in train],
        "test": [presses[k].name for k in test],
        "contact_radius_mm": {
            "marked": [1e3 * press.radius_px / PIXELS_PER_METRE for press in presses],
            "of_the_gel": (1e3 * profiles.contact_radius_m).tolist(),
        },
    }


CAP = "_cap"
MODELS = ("idle", "taxim", "taxim_cap", "fots", "fots_cap", "carried", "ours")


def _factory(
    model: str, settings: FitSettings, state: Path, progress: Callable[[str], None]
) -> Factory:
    if model == "fots":
        return lambda t, r, c: per_pixel.fit(t, r, c, seed=settings.seed, settings=per_pixel.FOTS)
    return factory_of(model, settings, state=state, progress=progress)


GELSIGHT_COLUMNS = (
    Column("psnr_db", "PSNR dB ↑", 2),
    Column("mean_l2", "mean L2 x 10⁻² ↓", 2, 100.0),
    Column("significant_l2", "sig. L2 x 10⁻² ↓", 2, 100.0),
    Column("ssim", "SSIM ↑", 4),
    Column("contact_psnr_db", "contact PSNR ↑", 2),
    Column("contact_ssim", "contact SSIM ↑", 4),
)


def gelsight_page(figures: dict[str, Any]) -> str:
    """Return the table as a Markdown page."""
    rows = []
    for name, row in figures["rows"].items():
        contact = {f"contact_{key}": value for key, value in row["contact"].items()}
        rows.append(([name], row | contact))
    return "\n".join(
        [
            "# Images of a real GelSight\n",
            f"Fitted on {len(figures['train'])} real presses of a ball, judged on "
            f"{len(figures['test'])} held out.\n",
            markdown_table(["method"], rows, GELSIGHT_COLUMNS),
            "Means over the images held out. Contact: pixels within one and a half radii of the "
            "marked circle's centre. `_cap`: with the ball's cap on a flat gel, as Taxim and FOTS "
            "label such presses; the others with the shape of this package's gel.\n",
            entry_list(figures["provenance"]),
        ]
    )
