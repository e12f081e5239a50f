# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the twin's camera should see of measured trajectories, and what it did see.

The image of the calibrated gel is made by the frozen network from the twin's own idle frame, or
from that of the unit's commissioning where there is one. The idle images that are searched are not
used for it: whatever changed since then would be in every prediction, and so could not be found.
Optical effects act on these images.

Importing this loads neither Warp nor ONNX Runtime.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.effects.effect import Active, SeenImage, image_filters
from dotsim_ros.io.arrays import Float32Array, FloatArray, ImageArray

if TYPE_CHECKING:
    from dotsim_ros.geometry.camera import Camera
    from dotsim_ros.optics.renderer import View
    from dotsim_ros.specification import SensorSpecification


@dataclass(frozen=True)
class Film:
    """Images of one trajectory, as the twin has them: the fields of `SeenImage`, some by frame.

    Attributes:
        stamp_s: (F,) times of the frames, within the trajectory.
        session_s: (F,) times since the session's start.
        pixels: (F, H, W, 3) linear to the sensor's numbers, 0 to 255, not rounded.
        flow_px_s: (F, H, W, 2) how fast the image moves.
        depth_m: (F, H, W) distance of the skin along the ray; NaN where none is seen.
        normal: (F, H, W, 3) unit normal of the skin, optical frame, on the camera's side; NaN where
            none is seen.
        idle: (H, W, 3) the same camera's image without contact.
        centre_px: (2,) x and y of the optical axis.
        focal_px: pixels a radian at the optical axis, along y.
        projection: of the camera, as a sensor's file names it.
        pixel_aspect: the focal length along x over that along y.
    """

    stamp_s: FloatArray
    session_s: FloatArray
    pixels: Float32Array
    flow_px_s: Float32Array
    depth_m: Float32Array
    normal: Float32Array
    idle: FloatArray
    centre_px: FloatArray
    focal_px: float
    projection: str
    pixel_aspect: float = 1.0
    BY_FRAME: ClassVar = ("stamp_s", "session_s", "pixels", "flow_px_s", "depth_m", "normal")

    def of_frames(self, frames: NDArray[np.integer]) -> Film:
        """Return some of the frames; they keep how fast the image moved there."""
        return replace(self, **{name: getattr(self, name)[frames] for name in self.BY_FRAME})

    def with_effects(self, effects: Sequence[Active]) -> Float32Array:
        """Return the pixels (F, H, W, 3) with effects at work, by fresh filters."""
        filtered = image_filters(effects)
        shared = {
            one.name: getattr(self, one.name)
            for one in fields(self)
            if one.name not in self.BY_FRAME
        }
        images = []
        for frame in range(len(self.stamp_s)):
            own = {name: getattr(self, name)[frame].astype(np.float64) for name in self.BY_FRAME}
            images.append(filtered(SeenImage(**own, **shared)))
        return np.stack(images).astype(np.float32)


def resized(film: Film, width: int, height: int) -> Film:
    """Return a film of another size and the same view."""
    if film.pixels.shape[1:3] == (height, width):
        return film
    scale = width / film.pixels.shape[2]

    def each(images: NDArray[Any]) -> NDArray[Any]:
        return np.stack([resized_image(one, width, height) for one in images])

    normal = each(film.normal)
    return replace(
        film,
        pixels=each(film.pixels),
        flow_px_s=np.float32(scale) * each(film.flow_px_s),
        depth_m=each(film.depth_m),
        normal=normal / np.linalg.norm(normal, axis=-1, keepdims=True),
        idle=resized_image(film.idle, width, height),
        # The centre of the first pixel is (0, 0).
        centre_px=scale * (film.centre_px + 0.5) - 0.5,
        focal_px=scale * film.focal_px,
    )


def resized_image(image: NDArray[Any], width: int, height: int) -> NDArray[Any]:
    """Return an image (H, W, C) of another size; each new pixel is the mean of what it covers."""
    smaller = width < image.shape[1]
    way = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, (width, height), interpolation=way))


class TwinCamera:
    """Makes the images of skins with a sensor's calibrated camera and its frozen network.

    Args:
        sensor: the twin; without a network its image is the warped one.
        width, height: of the images.
        idle: (H, W, 3) uint8 of that size, the unit's idle frame at its commissioning; None for the
            twin's own.

    Attributes:
        camera: of that size.
        idle: (H, W, 3) uint8, the idle frame.

    Raises:
        FileNotFoundError: the sensor's idle image or network is missing.
        ValueError: a size of another aspect ratio, or a network of another sensor.
    """

    def __init__(
        self,
        sensor: SensorSpecification,
        *,
        width: int,
        height: int,
        idle: ImageArray | None = None,
    ) -> None:
        # Loaded on use: they start Warp.
        from dotsim_ros.gel.make import skin_of
        from dotsim_ros.geometry.camera import Camera
        from dotsim_ros.twin.footage import twin_renderers

        full = Camera.from_specification(sensor.camera)
        self.camera: Camera = full.scaled(width, height)
        skin = skin_of(sensor.gel)
        self._triangles = skin.triangles
        self._renderer, self._image, self.idle = twin_renderers(sensor, self.camera, idle=idle)
        self._untouched = self._renderer.render(skin.rest_position_m)

    def film(
        self, skin_position_m: NDArray[np.floating], stamp_s: FloatArray, start_s: float
    ) -> Film:
        """Return what the camera sees of a skin that moves.

        Args:
            skin_position_m: (F, V, 3) of the sensor's skin, base frame.
            stamp_s: (F,) times of the frames.
            start_s: time of the first frame since the session's start.
        """
        images, flows, views = [], [], []
        before: View | None = None
        for frame, position in enumerate(skin_position_m):
            view = self._renderer.render(position)
            images.append(self._seen(view))
            if before is None:
                flows.append(np.zeros((*view.triangle.shape, 2), dtype=np.float32))
            else:
                lapse_s = float(stamp_s[frame] - stamp_s[frame - 1])
                flows.append(flow_of(before, view, self._triangles) / np.float32(lapse_s))
            before = view
            views.append(view)
        return self._film(
            stamp_s, start_s + (stamp_s - stamp_s[0]), np.stack(images), np.stack(flows), views
        )

    def idle_film(self) -> Film:
        """Return the film of one frame that shows the gel untouched, at the session's start."""
        height, width = self.idle.shape[:2]
        flow = np.zeros((1, height, width, 2), dtype=np.float32)
        pixels = self.idle[None].astype(np.float32)
        return self._film(np.zeros(1), np.zeros(1), pixels, flow, [self._untouched])

    def _film(
        self,
        stamp_s: FloatArray,
        session_s: FloatArray,
        pixels: Float32Array,
        flow_px_s: Float32Array,
        views: Sequence[View],
    ) -> Film:
        return Film(
            stamp_s,
            session_s,
            pixels,
            flow_px_s,
            np.stack([view.depth_m for view in views]),
            np.stack([view.normal for view in views]),
            self.idle.astype(np.float64),
            self.camera.principal_point_px,
            self.camera.focal_px,
            self.camera.projection,
            self.camera.pixel_aspect,
        )

    def _seen(self, view: View) -> Float32Array:
        warped = self._image.warp(view)
        image = warped.astype(np.float32)
        if self._image.completion is not None:
            image = image + self._image.completion(view.depth_m, view.normal, warped)
        return np.clip(image, np.float32(0.0), np.float32(255.0))


def flow_of(before: View, view: View, triangles: NDArray[np.integer]) -> Float32Array:
    """Return (H, W, 2) how far, px, what each pixel of a view shows has moved since another view;
    zero where no skin is seen.

    Args:
        before, view: of one skin.
        triangles: (T, 3) of it.
    """
    moved = view.vertex_pixel - before.vertex_pixel
    seen = view.mask
    corners = np.asarray(triangles)[view.triangle[seen]]
    second, third = view.barycentric[seen].T
    weight = np.stack([1.0 - second - third, second, third], axis=1)
    flow = np.zeros((*view.triangle.shape, 2), dtype=np.float32)
    flow[seen] = np.einsum("nk,nkd->nd", weight, np.nan_to_num(moved[corners]))
    return flow
