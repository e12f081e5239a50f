# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The part, size and colour order of the sensor's image that a node publishes. Needs no ROS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.geometry.camera import Camera, PinholeCamera
from msg_adapters import EQUIDISTANT, PLUMB_BOB, CameraCalibration, calibration_of

MESSAGE_BYTES = 25.0
"""For a pixel of the published image: with readers of colours, depth and compressed images the node
grew by 20."""
LARGEST_MESSAGES_BYTES = 0.21e9
"""Of an image of 3840 x 2160, which the node still publishes several times a second."""
SMALLEST_SIDE_PX = 16
"""Of an image that still shows anything."""
KEEP, STRETCH = "keep", "stretch"
"""Of the aspect ratio."""


@dataclass(frozen=True)
class Framing:
    """Crop, then another size.

    Attributes:
        crop_px: x, y, width, height of the part, in pixels of the sensor's image.
        size_px: width and height that the part is published at.
        rendered_px: width and height that the part is best rendered at: `size_px`, unless its
            aspect ratio is another.
    """

    crop_px: tuple[int, int, int, int]
    size_px: tuple[int, int]
    rendered_px: tuple[int, int]

    @classmethod
    def of_camera(
        cls,
        camera: Camera,
        *,
        crop_px: tuple[int, int, int, int],
        image_size_px: tuple[int, int],
        image_aspect: str = KEEP,
    ) -> Framing:
        """Return the framing of a camera's image; arguments as the node's parameters.

        Raises:
            ValueError: the part reaches beyond the image, or the size has another aspect ratio
                than the part and may not be stretched, or its messages would take more memory than
                `LARGEST_MESSAGES_BYTES`.
        """
        x, y, width, height = crop_px if crop_px[2] else (0, 0, camera.width, camera.height)
        if x + width > camera.width or y + height > camera.height:
            raise ValueError(
                f"crop_px {list(crop_px)} reaches beyond the sensor's image of {camera.width} x "
                f"{camera.height} pixels"
            )
        size = image_size_px if image_size_px[0] else (width, height)
        largest = max(int(LARGEST_MESSAGES_BYTES / MESSAGE_BYTES), camera.width * camera.height)
        if size[0] * size[1] > largest:
            raise ValueError(
                f"image_size_px is {list(image_size_px)}: the messages would take "
                f"{1e-9 * MESSAGE_BYTES * size[0] * size[1]:.1f} GB of memory, expected at most "
                f"{1e-9 * LARGEST_MESSAGES_BYTES:.2f} GB or the sensor's own image; that is "
                f"{largest} pixels"
            )
        if min(*size, width, height) < SMALLEST_SIDE_PX:
            raise ValueError(
                f"crop_px {list(crop_px)} and image_size_px {list(image_size_px)} give an image of "
                f"{size[0]} x {size[1]} pixels from {width} x {height}, expected at least "
                f"{SMALLEST_SIDE_PX} each way"
            )
        part = camera.part(x, y, width, height)
        rendered = size
        try:
            part.scaled(*size)
        except ValueError as error:
            if image_aspect == KEEP:
                raise ValueError(
                    f"image_size_px is {list(image_size_px)}: {error}; set image_aspect to "
                    f"{STRETCH} for an image that is squeezed to it"
                ) from None
            across = max(size[0], round(width * size[1] / height))
            rendered = (across, round(height * across / width))
        return cls((x, y, width, height), size, rendered)

    def apply(self, pixels: NDArray[Any], *, interpolation: int = cv2.INTER_AREA) -> NDArray[Any]:
        """Return the part of the sensor's whole image (H, W) or (H, W, C) at its size; a view where
        neither cut nor resized. Give cv2.INTER_NEAREST for what must not be averaged."""
        x, y, width, height = self.crop_px
        return self.fit(pixels[y : y + height, x : x + width], interpolation=interpolation)

    def fit(self, part: NDArray[Any], *, interpolation: int = cv2.INTER_AREA) -> NDArray[Any]:
        """Return the part, rendered at any size, at its own; otherwise as `apply`."""
        if self.size_px == (part.shape[1], part.shape[0]):
            return part
        return np.asarray(cv2.resize(part, self.size_px, interpolation=interpolation))

    def camera(self, camera: Camera) -> Camera:
        """Return the camera that sees the part at the size that it is best rendered at."""
        return camera.part(*self.crop_px).scaled(*self.rendered_px)

    def intrinsics(self, camera: Camera) -> CameraCalibration:
        """Return the calibration of the published image, given the sensor's own camera."""
        part = self.camera(camera)
        scale = np.array(self.size_px) / np.array(self.rendered_px)
        model, coefficients = EQUIDISTANT, camera.distortion
        if camera.projection == PinholeCamera.projection:
            # Of CameraInfo's five, the last is k3.
            model, coefficients = PLUMB_BOB, np.append(camera.distortion, 0.0)
        return calibration_of(
            width=self.size_px[0],
            height=self.size_px[1],
            focal_px=part.focal_xy_px * scale,
            principal_point_px=(part.principal_point_px + 0.5) * scale - 0.5,
            distortion=coefficients,
            distortion_model=model,
        )


def encoded_pixels(rgb: NDArray[np.uint8], encoding: str) -> NDArray[np.uint8]:
    """Return the pixels of an (H, W, 3) RGB image as rgb8, bgr8 or mono8 has them."""
    if encoding == "rgb8":
        return rgb
    code = {"bgr8": cv2.COLOR_RGB2BGR, "mono8": cv2.COLOR_RGB2GRAY}[encoding]
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(rgb), code), dtype=np.uint8)
