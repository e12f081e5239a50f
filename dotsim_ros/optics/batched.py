# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What one camera sees of many shapes of its skin, in torch's memory: a z-buffer for each.

The same kernels run on a CPU and on CUDA, for all skins at once; nothing waits for the device.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.markers import PrintedMarkers
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.warp_runtime import on_torch_stream, wp
from dotsim_ros.optics import batched_kernels as kernels
from dotsim_ros.optics.idle import IdleFrame
from dotsim_ros.optics.image import Completion, ImageRenderer, direct_light
from dotsim_ros.optics.renderer import faces_around_vertices
from dotsim_ros.optics.visibility import lens_of


@dataclass(frozen=True)
class BatchView:
    """What the camera sees of B skins; the next call of `BatchedRenderer.render` writes over it.

    Attributes:
        depth_m: (B, H, W) range, the distance along the ray; NaN where no skin is seen.
        normal: (B, H, W, 3) unit normal in the optical frame, on the camera's side; NaN where no
            skin is seen.
        triangle: (B, H, W) the triangle that is seen, -1 for none.
        marker_px: (B, M, 2) x and y of the printed markers, also of one beyond the image's edge;
            NaN where the camera has no image of it.
    """

    depth_m: torch.Tensor
    normal: torch.Tensor
    triangle: torch.Tensor
    marker_px: torch.Tensor


class BatchedRenderer:
    """Renders B shapes of one skin through one camera.

    Args:
        camera: the camera, fixed in the base frame.
        skin: at rest.
        count: B.
        markers: printed on the skin; None for none.
        device: torch's name of the device.

    Attributes:
        view: what was seen last.
        rays, triangles, position, vertex_normal, pixel: for kernels, of the camera, the skin, and
            the skins that were seen last.
    """

    def __init__(
        self,
        camera: Camera,
        skin: SkinMesh,
        count: int,
        *,
        markers: PrintedMarkers | None = None,
        device: str = "cpu",
    ) -> None:
        self.camera, self.count, self.device = camera, count, device
        self._lens = lens_of(camera)
        self._origin = wp.vec3d(*camera.pose.position_m)
        self._rotation = wp.mat33d(*camera.pose.rotation().ravel())
        first, faces = faces_around_vertices(skin.triangles, skin.vertex_count)
        self.triangles = self._upload(skin.triangles, wp.int32)
        self._first_face = self._upload(first, wp.int32)
        self._faces_around = self._upload(faces, wp.int32)
        self.rays = self._upload(camera.rays()[0].astype(np.float32), wp.vec3)
        corner = np.zeros((0, 3), np.int32) if markers is None else markers.corner
        weight = np.zeros((0, 3)) if markers is None else markers.weight
        self._corner = self._upload(corner.astype(np.int32), wp.int32)
        self._weight = self._upload(weight.astype(np.float32), wp.vec3)
        size = (count, camera.height, camera.width)
        self._skin_shape = (count, skin.vertex_count, 3)

        def empty(*shape: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
            return torch.empty(*shape, dtype=dtype, device=device)

        self._nearest = empty(*size, dtype=torch.int64)
        self.position = _as(empty(*self._skin_shape), wp.vec3)
        self.vertex_normal = _as(empty(*self._skin_shape), wp.vec3)
        self.pixel = _as(empty(*self._skin_shape[:2], 2), wp.vec2)
        self.view = BatchView(
            depth_m=empty(*size),
            normal=empty(*size, 3),
            triangle=empty(*size, dtype=torch.int32),
            marker_px=empty(count, len(corner), 2),
        )

    def _upload(self, array: NDArray[Any], dtype: Any) -> Any:
        return wp.array(np.ascontiguousarray(array), dtype=dtype, device=self.device)

    @on_torch_stream
    def render(self, skin_position_m: torch.Tensor) -> BatchView:
        """Return what the camera sees.

        Args:
            skin_position_m: (B, V, 3) the skins' vertices, base frame, single precision, on the
                renderer's device.

        Raises:
            ValueError: another shape or precision.
        """
        skin = skin_position_m
        if skin.shape != self._skin_shape or skin.dtype != torch.float32:
            raise ValueError(
                f"skin_position_m is {tuple(skin.shape)} of {skin.dtype}, expected "
                f"{self._skin_shape} of torch.float32"
            )
        vertices, view = _as(skin.contiguous(), wp.vec3), self.view
        count, vertex_count, _ = self._skin_shape
        nearest = wp.from_torch(self._nearest)
        # What a caller has changed in the view before is written again.
        normal = _as(view.normal, wp.vec3)
        self._nearest.fill_(kernels.EMPTY)
        self.launch(
            kernels.place_vertices,
            (count, vertex_count),
            [vertices, self._origin, self._rotation, self._lens],
            [self.position, self.pixel],
        )
        self.launch(
            kernels.vertex_normals,
            (count, vertex_count),
            [self.position, self.triangles, self._first_face, self._faces_around],
            [self.vertex_normal],
        )
        self.launch(
            kernels.rasterize,
            (count, len(self.triangles)),
            [self.position, self.pixel, self.triangles, self.rays, self._lens],
            [nearest],
        )
        self.launch(
            kernels.fill_view,
            tuple(nearest.shape),
            [nearest, self.rays, self.triangles, self.position, self.vertex_normal],
            [wp.from_torch(view.depth_m), normal, wp.from_torch(view.triangle)],
        )
        if view.marker_px.shape[1]:
            self.launch(
                kernels.project_markers,
                tuple(view.marker_px.shape[:2]),
                [vertices, self._corner, self._weight, self._origin, self._rotation, self._lens],
                [_as(view.marker_px, wp.vec2)],
            )
        return view

    def launch(
        self, kernel: Any, dim: tuple[int, ...], inputs: list[Any], outputs: list[Any]
    ) -> None:
        """Run a kernel on the renderer's device."""
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.device)


class BatchedImages:
    """Images of what a renderer sees, as `ImageRenderer` makes them of one skin.

    Args:
        renderer: what sees the skins.
        skin: at rest.
        idle: frame of the renderer's camera.
        completion: what to add to the warped images, each on the CPU; None for nothing.
    """

    def __init__(
        self,
        renderer: BatchedRenderer,
        skin: SkinMesh,
        idle: IdleFrame,
        *,
        completion: Completion | None = None,
    ) -> None:
        self._renderer = renderer
        one = ImageRenderer(
            renderer.camera,
            skin,
            idle.image,
            lighting=idle.lighting,
            vignetting=idle.vignetting,
            fine=idle.fine,
            completion=completion,
            device=renderer.device,
        )
        self._one, self._shared = one, one.pixels_at_rest()
        lighting = one.lighting
        self._light = [one.leds, lighting.gloss, lighting.gloss_exponent]
        # What the same kernels see of the skin at rest, so that there the image is the idle frame.
        at_rest = BatchedRenderer(renderer.camera, skin, 1, device=renderer.device)
        at_rest.render(torch.as_tensor(skin.rest_position_m, device=renderer.device).float()[None])
        self._rest_pixel = at_rest.pixel[0]
        rest_light = direct_light(at_rest.position[0], at_rest.vertex_normal[0], one.leds, lighting)
        self._rest = [rest_light, one.ambient, lighting.exponent]

    def render(self) -> torch.Tensor:
        """Return the images (B, H, W, 3) uint8 of the skins that the renderer saw last."""
        given, view = self._renderer, self._renderer.view
        gain = torch.empty(*given.position.shape, 3, device=given.device)
        image = torch.empty(*view.triangle.shape, 3, dtype=torch.uint8, device=given.device)
        given.launch(
            kernels.brightness_gain,
            tuple(given.position.shape),
            [given.position, given.vertex_normal, *self._light, *self._rest],
            [_as(gain, wp.vec3)],
        )
        given.launch(
            kernels.warp_idle,
            tuple(view.triangle.shape),
            [
                self._shared,
                given.triangles,
                self._rest_pixel,
                wp.from_torch(view.triangle),
                wp.from_torch(view.depth_m),
                given.rays,
                given.position,
                given.pixel,
                _as(gain, wp.vec3),
            ],
            [wp.from_torch(image)],
        )
        if self._one.completion is None:
            return image
        completed = [
            self._one.completed(*(part.cpu().numpy() for part in parts))
            for parts in zip(view.depth_m, view.normal, image, strict=True)
        ]
        return torch.as_tensor(np.stack(completed), device=given.device)


def _as(tensor: torch.Tensor, dtype: Any) -> Any:
    """Return a tensor whose last axis is a vector as a Warp array, without a copy."""
    return wp.from_torch(tensor, dtype=dtype)
