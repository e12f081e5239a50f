# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Idle frames: the image without contact, from any camera, brought to the sensor's own camera."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dotsim_ros.geometry.camera import Camera, FisheyeCamera
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import BoolArray, ImageArray
from dotsim_ros.io.documents import read_yaml
from dotsim_ros.io.files import given_path, read_image
from dotsim_ros.io.quantity import section_from
from dotsim_ros.optics.lighting import Lighting, Vignetting
from dotsim_ros.specification import (
    LightingSpecification,
    SensorSpecification,
    VignettingSpecification,
)

DARK_LEVEL = 10
"""Grey level up to which a pixel counts as unlit."""
MOST_LIT_BEYOND, MOST_DARK_WITHIN = 0.05, 0.15
"""Shares of the pixels that may be lit beyond the gel, by what holds it, and dark within it, under
a lens mount or in a dim corner: of the shipped sensors at most 0.006 and 0.07 are."""
MOST_LENS_CHANGE = 0.1
"""By which share the angle of a lens may differ; that of sensor_a moved by 0.01 when fitted."""


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

    def camera(self, width: int, height: int, pose: Pose) -> FisheyeCamera:
        """Return the undistorted camera of an image of a size (px), at the pose of its optical
        frame in the base frame.

        Raises:
            ValueError: radius or angle is not positive, or the angle exceeds 180 degrees.
        """
        if not self.radius_px > 0.0:
            raise ValueError(f"radius_px is {self.radius_px}, expected a positive number of pixels")
        if not 0.0 < self.rim_angle_deg <= 180.0:
            raise ValueError(
                f"rim_angle_deg is {self.rim_angle_deg}, expected above 0 and at most 180"
            )
        focal_px = self.radius_px / np.radians(self.rim_angle_deg)
        centre_px = np.asarray(self.centre_px, dtype=np.float64)
        return FisheyeCamera(width, height, focal_px, centre_px, pose=pose)


def check_image(image: ImageArray) -> None:
    """Raise ValueError unless the image is (H, W, 3) uint8."""
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise ValueError(
            f"idle image has shape {image.shape} and type {image.dtype}, expected (H, W, 3) uint8 "
            "in the order red, green, blue"
        )


def check_fine(fine: ImageArray, idle: ImageArray) -> None:
    """Raise ValueError unless `fine` (2 H - 1, 2 W - 1, 3) holds the lit pixels of an idle image
    (H, W, 3), with others half-way between them."""
    height, width = idle.shape[:2]
    if fine.shape != (2 * height - 1, 2 * width - 1, 3) or fine.dtype != np.uint8:
        raise ValueError(
            f"the samples between the idle image's pixels have shape {fine.shape} and type "
            f"{fine.dtype}, expected {(2 * height - 1, 2 * width - 1, 3)} uint8"
        )
    if not np.array_equal(fine[::2, ::2][lit_region(idle)], idle[lit_region(idle)]):
        raise ValueError(
            "the samples between the idle image's pixels belong to another idle image; remove "
            "them, or learn them again with train-optics"
        )


def lit_region(image: ImageArray) -> BoolArray:
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


def resample(image: ImageArray, source: Camera, target: Camera) -> ImageArray:
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


def enlarged_fine(
    fine: ImageArray, image: ImageArray, width: int, height: int
) -> tuple[ImageArray, ImageArray]:
    """Return an idle image and its samples half-way between, for a larger camera of one view.

    Args:
        fine: (2 h - 1, 2 w - 1, 3) of an idle image (h, w, 3).
        image: (height, width, 3) that idle image as the camera sees it, from its own pixels.
        width, height: of the camera.

    Returns:
        (height, width, 3) the image, by the samples but for its rim, and (2 height - 1,
        2 width - 1, 3).
    """
    rows, columns = (fine.shape[0] + 1) // 2, (fine.shape[1] + 1) // 2
    # Pixels cover areas: the outer edges of both images coincide, not the outer pixels' centres.
    x = (np.arange(2 * width - 1) + 1.0) * columns / width - 1.0
    y = (np.arange(2 * height - 1) + 1.0) * rows / height - 1.0
    grid_x, grid_y = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
    enlarged = np.asarray(
        cv2.remap(fine, grid_x, grid_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE),
        dtype=np.uint8,
    )
    # The samples know nothing of the soft rim, which the image keeps.
    reach = 2 * int(np.ceil(2.0 * width / columns)) + 1
    inside = cv2.erode(lit_region(image).astype(np.uint8), np.ones((reach, reach))) > 0
    joined = np.where(inside[..., None], enlarged[::2, ::2], image)
    enlarged[::2, ::2] = np.where(lit_region(joined)[..., None], joined, enlarged[::2, ::2])
    return joined, enlarged


def fine_path(path: Path) -> Path:
    """Return where the samples between the pixels of an idle image's file lie."""
    return path.with_name(f"{path.stem}_fine.png")


def fit_idle_image(image: ImageArray, camera: Camera, *, disc: LitDisc | None = None) -> ImageArray:
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
        return resample(image, disc.camera(width, height, camera.pose), camera)
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
        fine: (2 H - 1, 2 W - 1, 3) uint8, the image with samples half-way between its own; None
            where they are not known.
        half_height_angle_deg: of the lens that it was taken through; None where it is not known.
    """

    image: ImageArray
    lighting: Lighting = field(default_factory=Lighting)
    vignetting: Vignetting = field(default_factory=Vignetting)
    fine: ImageArray | None = None
    half_height_angle_deg: float | None = None

    def as_grey(self) -> IdleFrame:
        """Return what a camera sees that tells no colours apart, in three equal channels."""
        fine = None if self.fine is None else _grey(self.fine)
        return replace(self, image=_grey(self.image), lighting=self.lighting.as_grey(), fine=fine)

    def misfit(self, sees_gel: BoolArray, half_height_angle_deg: float) -> str:
        """Return why this image was not taken through a camera, or "" where it may have been.

        Args:
            sees_gel: (H, W) where the camera sees the untouched gel.
            half_height_angle_deg: of its lens.
        """
        lit = lit_region(self.image)
        beyond, dark = float(np.mean(lit & ~sees_gel)), float(np.mean(sees_gel & ~lit))
        taken_deg = self.half_height_angle_deg or half_height_angle_deg
        if abs(half_height_angle_deg / taken_deg - 1.0) > MOST_LENS_CHANGE:
            return (
                f"it was taken through a lens that sees {taken_deg:g} degrees at half the height, "
                f"and the camera's sees {half_height_angle_deg:g}"
            )
        if beyond > MOST_LIT_BEYOND:
            return f"in {beyond:.0%} of its pixels it is lit where the camera sees no gel"
        if dark > MOST_DARK_WITHIN:
            return f"in {dark:.0%} of its pixels it is dark where the camera sees gel"
        return ""


def _grey(image: ImageArray) -> ImageArray:
    one = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)
    return np.asarray(cv2.cvtColor(one, cv2.COLOR_GRAY2RGB), dtype=np.uint8)


def part_of_idle(
    idle: IdleFrame, crop_px: tuple[int, int, int, int], size_px: tuple[int, int]
) -> IdleFrame:
    """Return what a part of the sensor's camera sees without contact.

    Args:
        idle: of the whole camera.
        crop_px: x, y, width, height of the part.
        size_px: width and height that the part is seen at.
    """
    x, y, width, height = crop_px
    cut = np.ascontiguousarray(idle.image[y : y + height, x : x + width])
    is_smaller = size_px[0] < width
    # What is made smaller must be averaged, or its pattern would flicker.
    interpolation = cv2.INTER_AREA if is_smaller else cv2.INTER_CUBIC
    image = np.asarray(cv2.resize(cut, size_px, interpolation=interpolation), dtype=np.uint8)
    fine = None
    if idle.fine is not None and not is_smaller:
        samples = idle.fine[2 * y : 2 * (y + height) - 1, 2 * x : 2 * (x + width) - 1]
        image, fine = enlarged_fine(np.ascontiguousarray(samples), image, *size_px)
    vignetting = idle.vignetting.of_part(height / idle.image.shape[0])
    return IdleFrame(image, idle.lighting, vignetting, fine)


def read_idle_frame(
    path: Path,
    camera: Camera,
    *,
    lighting: Lighting | None = None,
    vignetting: Vignetting | None = None,
) -> IdleFrame:
    """Read an idle frame and bring it to the sensor's camera.

    A YAML file of the same name next to the image may describe it, in four optional sections:
    `disc` (the fields of LitDisc; without it the image must show the camera's own view), `lens`
    (its half_height_angle_deg, that of the camera that took the image), and `lighting` and
    `vignetting` as a sensor's file has them. So may an image NAME_fine.png of samples between the
    image's pixels, as train-optics learns it.

    Args:
        path: of the image.
        camera: the sensor's.
        lighting, vignetting: of an image that nothing describes; None for the defaults.

    Raises:
        FileNotFoundError: no such image.
        ValueError: the file is no image, its description has an unknown or missing entry, or as
            `fit_idle_image`.
    """
    image = _read_image(path)
    description = path.with_suffix(".yaml")
    disc, lens_deg = None, None
    lighting, vignetting = lighting or Lighting(), vignetting or Vignetting()
    if description.exists():
        read = read_description(description)
        disc, lens_deg = read.disc, read.half_height_angle_deg
        lighting, vignetting = read.lights()
    try:
        fitted = fit_idle_image(image, camera, disc=disc)
        fine = None
        if disc is None and fine_path(path).exists():
            fine = _read_image(fine_path(path))
            check_fine(fine, image)
            if camera.width < image.shape[1]:
                fine = None  # A smaller image leaves no sharper pattern to carry.
            elif camera.width > image.shape[1]:
                fitted, fine = enlarged_fine(fine, fitted, camera.width, camera.height)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return IdleFrame(fitted, lighting, vignetting, fine, lens_deg)


def _read_image(path: Path) -> ImageArray:
    if not path.exists():
        raise FileNotFoundError(f"no idle image {path}")
    return read_image(path)


def _numbers(section: dict[str, Any]) -> dict[str, Any]:
    return {
        name: tuple(float(entry) for entry in value) if isinstance(value, list) else float(value)
        for name, value in section.items()
    }


@dataclass(frozen=True)
class IdleDescription:
    """What the file next to an idle image says; see `read_idle_frame`.

    Attributes:
        disc: where the lit disc lies; None where the image shows the camera's own view.
        half_height_angle_deg: of the lens that it was taken through; None where it is not known.
        lighting, vignetting: of the sensor that it shows.
    """

    disc: LitDisc | None
    half_height_angle_deg: float | None
    lighting: LightingSpecification
    vignetting: VignettingSpecification

    def lights(self) -> tuple[Lighting, Vignetting]:
        """Return lights and vignetting, ready for rendering."""
        return (
            Lighting.from_specification(self.lighting),
            Vignetting.from_specification(self.vignetting),
        )


def read_description(path: Path) -> IdleDescription:
    """Read what is known of an idle image.

    Raises:
        ValueError: an entry is unknown, missing, of the wrong type or out of range; the message
            names the file.
    """
    try:
        document = read_yaml(path) or {}
        known = ("disc", "lens", "lighting", "vignetting")
        unknown = sorted(map(str, set(document) - set(known)))
        if unknown:
            raise ValueError(f"unknown sections {unknown}; known are {', '.join(known)}")
        lens_deg = None
        if "lens" in document:
            lens = _numbers(document["lens"])
            lens_deg = lens.get("half_height_angle_deg", 0.0)
            if len(lens) != 1 or not 0.0 < lens_deg <= 180.0:
                raise ValueError(
                    f"lens is {document['lens']}, expected half_height_angle_deg, above 0 and at "
                    "most 180 degrees"
                )
        return IdleDescription(
            LitDisc(**_numbers(document["disc"])) if "disc" in document else None,
            lens_deg,
            section_from(LightingSpecification, "lighting", document.get("lighting")),
            section_from(VignettingSpecification, "vignetting", document.get("vignetting")),
        )
    except (TypeError, ValueError, AttributeError) as error:
        raise ValueError(f"{path} describes no idle image: {error}") from error


def description_of(sensor: SensorSpecification) -> Path | None:
    """Return the file that describes a sensor's idle image; None where there is none.

    Raises:
        FileNotFoundError: the sensor names an image that is not there.
    """
    if not sensor.camera.idle_image:
        return None
    path = given_path(sensor.camera.idle_image).with_suffix(".yaml")
    return path if path.exists() else None


def stated_lights(
    sensor: SensorSpecification,
) -> tuple[LightingSpecification, VignettingSpecification]:
    """Return lights and vignetting that the description next to a sensor's idle image states, or
    the sensor's file where there is none.

    Raises:
        FileNotFoundError: the sensor names an image that is not there.
        ValueError: as `read_description`.
    """
    description = description_of(sensor)
    if description is None:
        return sensor.lighting, sensor.vignetting
    read = read_description(description)
    return read.lighting, read.vignetting


def lights_of(sensor: SensorSpecification) -> tuple[Lighting, Vignetting]:
    """Return what `stated_lights` does, ready for rendering."""
    lighting, vignetting = stated_lights(sensor)
    return Lighting.from_specification(lighting), Vignetting.from_specification(vignetting)
