"""Idle frames: the image without contact, from any camera, brought to the sensor's own camera."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from dotsim_ros.geometry.camera import FisheyeCamera, camera_of_disc
from dotsim_ros.optics.lighting import Lighting, Vignetting, led_ring

ByteImage = NDArray[np.uint8]
BoolArray = NDArray[np.bool_]

DARK_LEVEL = 10
"""Grey level up to which a pixel counts as unlit."""


@dataclass(frozen=True)
class LitDisc:
    """Where the lit disc lies in an image of an unknown camera.

    Attributes:
        centre_px: its centre, x then y, the centre of the first pixel being (0, 0).
        radius_px: its radius.
        rim_angle_deg: the angle from the optical axis that its rim shows.
    """

    centre_px: tuple[float, float]
    radius_px: float
    rim_angle_deg: float


def check_image(image: ByteImage) -> None:
    """Raise ValueError unless the image is (H, W, 3) uint8."""
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise ValueError(
            f"idle image has shape {image.shape} and type {image.dtype}, expected (H, W, 3) uint8 "
            "in the order red, green, blue"
        )


def lit_region(image: ByteImage) -> BoolArray:
    """Return (H, W) where the image (H, W, 3) shows the lit gel: the largest bright region,
    dark spots of the pattern inside it included."""
    bright = (image.max(axis=2) > DARK_LEVEL).astype(np.uint8)
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(bright, connectivity=4)
    if count < 2:
        return np.zeros(bright.shape, dtype=np.bool_)
    largest = 1 + int(np.argmax(statistics[1:, cv2.CC_STAT_AREA]))
    region = (labels == largest).astype(np.uint8)
    contours, _ = cv2.findContours(region, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = cv2.drawContours(region, contours, -1, color=1, thickness=cv2.FILLED)
    return np.asarray(filled, dtype=np.bool_)


def resample(image: ByteImage, source: FisheyeCamera, target: FisheyeCamera) -> ByteImage:
    """Return the image (H, W, 3) as a camera of another size, direction or lens sees it.

    Both cameras stand at the same place; directions that the source does not see become black.

    Raises:
        ValueError: the image is not (H, W, 3) uint8, or not of the source's size.
    """
    check_image(image)
    if image.shape[:2] != (source.height, source.width):
        raise ValueError(
            f"image is {image.shape[1]}x{image.shape[0]}, its camera {source.width}x{source.height}"
        )
    directions = target.rays()[0] @ (source.pose.rotation().T @ target.pose.rotation()).T
    pixels = source.project_optical(directions).astype(np.float32)
    outside = np.float32(-10.0)
    pixels = np.where(np.isfinite(pixels), pixels, outside)
    resampled = cv2.remap(
        image, pixels[..., 0], pixels[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT
    )
    return np.asarray(resampled, dtype=np.uint8)


def fit_idle_image(
    image: ByteImage, camera: FisheyeCamera, *, disc: LitDisc | None = None
) -> ByteImage:
    """Return an idle frame (H, W, 3) of any size as the sensor's camera would see it.

    Args:
        image: (h, w, 3) uint8, red, green, blue.
        camera: the sensor's camera.
        disc: where the lit disc lies in the image; without it the image must show the same view
            as the sensor's camera, at any resolution.

    Raises:
        ValueError: the image is no colour image, has another aspect ratio and no disc is given, or
            shows no lit disc.
    """
    check_image(image)
    height, width = image.shape[:2]
    if not lit_region(image).any():
        raise ValueError(
            f"idle image has no pixel above grey level {DARK_LEVEL}; expected the lit gel"
        )
    if disc is not None:
        source = camera_of_disc(
            width,
            height,
            centre_px=disc.centre_px,
            radius_px=disc.radius_px,
            rim_angle_deg=disc.rim_angle_deg,
            pose=camera.pose,
        )
        return resample(image, source, camera)
    if (width, height) == (camera.width, camera.height):
        return image.copy()
    try:
        source = camera.scaled(width, height)
    except ValueError as error:
        raise ValueError(
            f"idle image of another view: {error}; or say where its lit disc lies"
        ) from error
    return resample(image, source, camera)


@dataclass(frozen=True)
class IdleFrame:
    """An idle frame in the sensor's camera, and what is known of how it came about.

    Attributes:
        image: (H, W, 3) uint8, red, green, blue.
        lighting: the LEDs that it was taken under.
        vignetting: of its camera.
    """

    image: ByteImage
    lighting: Lighting = field(default_factory=Lighting)
    vignetting: Vignetting = field(default_factory=Vignetting)


def read_idle_frame(path: Path, camera: FisheyeCamera) -> IdleFrame:
    """Read an idle frame and bring it to the sensor's camera.

    A YAML file of the same name beside the image may describe it, in three optional sections:
    `disc` (the fields of LitDisc; without it the image must show the camera's own view), `lighting`
    (the arguments of led_ring, and Lighting's other fields) and `vignetting` (`falloff`).

    Raises:
        FileNotFoundError: no such image.
        ValueError: the file is no image, its description has an unknown or missing entry, or as
            `fit_idle_image`.
    """
    if not path.exists():
        raise FileNotFoundError(f"no idle image {path}")
    pixels = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if pixels is None:
        raise ValueError(f"{path} is no image that OpenCV can read; expected a PNG or JPEG file")
    image = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), dtype=np.uint8)
    description = path.with_suffix(".yaml")
    disc, lighting, vignetting = None, Lighting(), Vignetting()
    if description.exists():
        disc, lighting, vignetting = read_description(description)
    try:
        return IdleFrame(fit_idle_image(image, camera, disc=disc), lighting, vignetting)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


_WHOLE = tuple(entry.name for entry in fields(Lighting) if entry.name != "lights")


def _numbers(section: dict[str, Any]) -> dict[str, Any]:
    return {
        name: tuple(float(entry) for entry in value) if isinstance(value, list) else float(value)
        for name, value in section.items()
    }


def read_description(path: Path) -> tuple[LitDisc | None, Lighting, Vignetting]:
    """Read what is known of an idle image; see `read_idle_frame`.

    Raises:
        ValueError: an entry is unknown, missing or of the wrong type; the message names the file.
    """
    try:
        document = yaml.safe_load(path.read_text()) or {}
        unknown = sorted(set(document) - {"disc", "lighting", "vignetting"})
        if unknown:
            raise ValueError(f"unknown sections {unknown}; known are disc, lighting, vignetting")
        disc = LitDisc(**_numbers(document["disc"])) if "disc" in document else None
        ring = _numbers(document.get("lighting", {}))
        whole = {name: ring.pop(name) for name in _WHOLE if name in ring}
        lighting = Lighting(led_ring(**ring), **whole)
        vignetting = Vignetting(**_numbers(document.get("vignetting", {})))
    except (TypeError, ValueError, AttributeError, yaml.YAMLError) as error:
        raise ValueError(f"{path} describes no idle image: {error}") from error
    return disc, lighting, vignetting
