"""The part, size and colour order of the sensor's image that a node publishes. Needs no ROS."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.geometry.camera import FisheyeCamera

MESSAGE_BYTES = 25.0
"""For a pixel of the published image: with readers of colours, depth and compressed images the node
grew by 20."""
LARGEST_MESSAGES_BYTES = 0.21e9
"""Of an image of 3840 x 2160, which the node still publishes several times a second."""


@dataclass(frozen=True)
class Framing:
    """Crop, then resize.

    Attributes:
        crop_px: x, y, width, height of the part, in pixels of the sensor's image.
        size_px: width and height that the part is resized to.
    """

    crop_px: tuple[int, int, int, int]
    size_px: tuple[int, int]

    @classmethod
    def of_camera(
        cls,
        camera: FisheyeCamera,
        *,
        crop_px: tuple[int, int, int, int],
        image_size_px: tuple[int, int],
    ) -> Framing:
        """Return the framing of a camera's image; zeros as in the node's parameters.

        Raises:
            ValueError: the part reaches beyond the image, or the size has another aspect ratio
                than the part (then no equidistant camera has that image), or its messages would
                take more memory than `LARGEST_MESSAGES_BYTES`.
        """
        x, y, width, height = crop_px if crop_px[2] else (0, 0, camera.width, camera.height)
        if x + width > camera.width or y + height > camera.height:
            raise ValueError(
                f"crop_px {list(crop_px)} reaches beyond the sensor's image of {camera.width} x "
                f"{camera.height} pixels"
            )
        framing = cls((x, y, width, height), image_size_px if image_size_px[0] else (width, height))
        pixel_count = framing.size_px[0] * framing.size_px[1]
        largest = max(int(LARGEST_MESSAGES_BYTES / MESSAGE_BYTES), camera.width * camera.height)
        if pixel_count > largest:
            raise ValueError(
                f"image_size_px is {list(image_size_px)}: the messages would take "
                f"{1e-9 * MESSAGE_BYTES * pixel_count:.1f} GB of memory, expected at most "
                f"{1e-9 * LARGEST_MESSAGES_BYTES:.2f} GB or the sensor's own image; that is "
                f"{largest} pixels"
            )
        framing.camera(camera)
        return framing

    def apply(self, pixels: NDArray[Any], *, interpolation: int = cv2.INTER_AREA) -> NDArray[Any]:
        """Return the part of an image (H, W) or (H, W, C) at its size; a view where neither cut
        nor resized. Give cv2.INTER_NEAREST for what must not be averaged."""
        x, y, width, height = self.crop_px
        part = pixels[y : y + height, x : x + width]
        if self.size_px == (width, height):
            return part
        return np.asarray(cv2.resize(part, self.size_px, interpolation=interpolation))

    def camera(self, camera: FisheyeCamera) -> FisheyeCamera:
        """Return the camera that sees the part at its size."""
        x, y, width, height = self.crop_px
        part = replace(
            camera,
            width=width,
            height=height,
            principal_point_px=camera.principal_point_px - np.array([x, y]),
        )
        return part.scaled(*self.size_px)


def encoded_pixels(rgb: NDArray[np.uint8], encoding: str) -> NDArray[np.uint8]:
    """Return the pixels of an (H, W, 3) RGB image as rgb8, bgr8 or mono8 has them."""
    if encoding == "rgb8":
        return rgb
    code = {"bgr8": cv2.COLOR_RGB2BGR, "mono8": cv2.COLOR_RGB2GRAY}[encoding]
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(rgb), code), dtype=np.uint8)
