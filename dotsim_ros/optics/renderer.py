# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the camera sees of the deformed skin: depth, normals, and the material point of each pixel.

The skin is a triangle mesh of fixed topology; its corners are warped by the gel. Within a
triangle, depth is that of the plane, normals and material points are interpolated from the
corners. On a CPU threads share the rows, see `bands`.

All of the skin is drawn at each touch: a press of 0.6 mm moves 95 % of a dome's markers by more
than 3 um, and 1 um can change a grey level.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io import tracing
from dotsim_ros.io.arrays import BoolArray, Float32Array, FloatArray, IndexArray
from dotsim_ros.io.warp_runtime import wp
from dotsim_ros.optics import host_kernels, kernels
from dotsim_ros.optics.bands import cut, launch_bands, thread_count
from dotsim_ros.optics.frame_memory import FrameMemory
from dotsim_ros.optics.visibility import RasterFinder, RayQueryFinder, lens_of


@dataclass(frozen=True)
class View:
    """What the camera sees of one shape of the skin. Every array belongs to this view alone.

    Attributes:
        depth_m: (H, W) range, the distance along the ray; NaN where no skin is seen.
        triangle: (H, W) the triangle that is seen, -1 for none.
        barycentric: (H, W, 2) weights of that triangle's second and third corner.
        vertex_position_m: (V, 3) the skin's vertices in the optical frame.
        vertex_normal: (V, 3) unit normals out of the gel, in the optical frame.
        vertex_pixel: (V, 2) the vertices' images, x then y.
    """

    depth_m: Float32Array
    triangle: IndexArray
    barycentric: Float32Array
    vertex_position_m: Float32Array
    vertex_normal: Float32Array
    vertex_pixel: Float32Array
    _renderer: SkinRenderer | None = field(repr=False)

    def __getstate__(self) -> dict[str, Any]:
        # Pickled without the renderer, so what only it can compute goes along.
        computed = {"normal": self.normal, "material_point_m": self.material_point_m}
        return {**self.__dict__, **computed, "_renderer": None}

    @cached_property
    def normal(self) -> Float32Array:
        """(H, W, 3) unit normal in the optical frame, on the camera's side; NaN where no skin is
        seen. Computed when first read."""
        assert self._renderer is not None
        return self._renderer.normals_of(self)

    @cached_property
    def material_point_m(self) -> Float32Array:
        """(H, W, 3) where the skin point that is seen lies at rest, in the base frame; NaN where no
        skin is seen. Computed when first read."""
        assert self._renderer is not None
        return self._renderer.material_points_of(self)

    @cached_property
    def mask(self) -> BoolArray:
        """Return (H, W) whether skin is seen."""
        return self.triangle != kernels.NO_TRIANGLE

    def motion_px(self, triangles: IndexArray, pixel_before: FloatArray) -> FloatArray:
        """Return how far (H, W, 2) what each pixel shows has moved in the image, x then y.

        Args:
            triangles: (T, 3) of the skin.
            pixel_before: (V, 2) images of the vertices before; NaN where they had none.

        Returns:
            Pixels, linear within each triangle; zero where no skin is seen or it had no image
            before.
        """
        moved: FloatArray = self.vertex_pixel.astype(np.float64) - pixel_before
        second, third = self.barycentric[..., 0], self.barycentric[..., 1]
        weight = np.stack([1.0 - second - third, second, third], axis=-1)
        corners = triangles[np.where(self.mask, self.triangle, 0)]
        motion = np.einsum("hwk,hwkc->hwc", weight, moved[corners])
        seen = self.mask[..., None] & np.isfinite(motion)
        return np.where(seen, motion, 0.0)


def faces_around_vertices(
    triangles: IndexArray, vertex_count: int
) -> tuple[IndexArray, IndexArray]:
    """Return the faces at each vertex, (V + 1,) first entries and (3 T,) face numbers."""
    corners = triangles.ravel()
    first = np.concatenate([[0], np.cumsum(np.bincount(corners, minlength=vertex_count))])
    faces = np.argsort(corners, kind="stable") // 3
    return first.astype(np.int32), faces.astype(np.int32)


class SkinRenderer:
    """Renders shapes of one skin through one camera.

    Args:
        camera: the camera, fixed in the base frame.
        skin_mesh: the skin at rest.
        device: Warp's name of the device, such as "cpu" or "cuda:0".
        band_count: bands of rows that threads share; None for as many as `bands.thread_count` on a
            CPU, else one. Any number gives the same to the last bit.

    Attributes:
        pixel_kernels: the module whose kernel fills in normals; both give the same to the last bit.

    Raises:
        ValueError: the image has too few pixels for the rasteriser of a CPU.
    """

    def __init__(
        self,
        camera: Camera,
        skin_mesh: SkinMesh,
        *,
        device: str = "cpu",
        band_count: int | None = None,
    ) -> None:
        self.camera = camera
        self.skin_mesh = skin_mesh
        self._device = wp.get_device(device)
        rays = camera.rays()[0].astype(np.float32)
        first, faces = faces_around_vertices(skin_mesh.triangles, skin_mesh.vertex_count)
        self._memory = FrameMemory(self._device)
        self._lens = lens_of(camera)
        self._rays = self._upload(rays, wp.vec3)
        self._triangles = self._upload(skin_mesh.triangles, wp.int32)
        self._first_face = self._upload(first, wp.int32)
        self._faces_around = self._upload(faces, wp.int32)
        self._rest_position = self._upload(skin_mesh.rest_position_m.astype(np.float32), wp.vec3)
        self.pixel_kernels = host_kernels if self._device.is_cpu else kernels
        if band_count is None:
            band_count = thread_count() if self._device.is_cpu else 1
        self._bands = cut(camera.height, band_count)
        self._finder: RasterFinder | RayQueryFinder
        if self._device.is_cpu:
            rest_pixel = camera.project(skin_mesh.rest_position_m)
            self._finder = RasterFinder(camera, rays, skin_mesh.triangles, rest_pixel, band_count)
        else:
            vertices = self._optical(skin_mesh.rest_position_m)
            self._finder = RayQueryFinder(self._rays, self._triangles, vertices)

    def _upload(self, array: NDArray[np.generic], dtype: type) -> wp.array:
        # No copy on a CPU: what is uploaded is only read.
        return wp.array(np.ascontiguousarray(array), dtype=dtype, device=self._device, copy=False)

    def _optical(self, position_m: ArrayLike) -> wp.array:
        return self._upload(self.camera.to_optical(position_m).astype(np.float32), wp.vec3)

    def render(self, position_m: ArrayLike) -> View:
        """Return what the camera sees.

        Args:
            position_m: (V, 3) the skin's vertices, in the base frame.

        Raises:
            ValueError: another number of vertices than the skin's, or one that is not finite.
        """
        position = np.asarray(position_m, dtype=np.float64)
        if position.shape != (self.skin_mesh.vertex_count, 3):
            raise ValueError(
                f"position_m has shape {position.shape}, expected "
                f"({self.skin_mesh.vertex_count}, 3) as the skin mesh"
            )
        if not np.all(np.isfinite(position)):
            raise ValueError("position_m holds a vertex that is not finite")
        vertices = self._optical(position)
        count = len(position)
        size = (self.camera.height, self.camera.width)
        vertex_pixel = wp.empty(count, dtype=wp.vec2, device=self._device)
        vertex_normal = wp.empty(count, dtype=wp.vec3, device=self._device)
        triangle = self._memory.array(size, wp.int32)
        barycentric = self._memory.array(size, wp.vec2)
        depth = self._memory.array(size, wp.float32)
        # As it stays where no skin is seen.
        barycentric.zero_()
        depth.fill_(np.nan)
        wp.launch(
            kernels.project_vertices,
            dim=count,
            inputs=[vertices, self._lens],
            outputs=[vertex_pixel],
            device=self._device,
        )
        wp.launch(
            kernels.vertex_normals,
            dim=count,
            inputs=[vertices, self._triangles, self._first_face, self._faces_around],
            outputs=[vertex_normal],
            device=self._device,
        )
        self._finder.find(vertices, vertex_pixel, triangle, barycentric, depth)
        # On a CPU these share memory with Warp's arrays, which live as long as they do.
        return View(
            depth_m=depth.numpy(),
            triangle=triangle.numpy(),
            barycentric=barycentric.numpy(),
            vertex_position_m=vertices.numpy(),
            vertex_normal=vertex_normal.numpy(),
            vertex_pixel=vertex_pixel.numpy(),
            _renderer=self,
        )

    def normals_of(self, view: View) -> Float32Array:
        """Return `View.normal` of a view of this renderer."""
        pixels = kernels.NormalPixels()
        pixels.triangle_seen = self._upload(view.triangle, wp.int32)
        pixels.barycentric = self._upload(view.barycentric, wp.vec2)
        pixels.vertex_normal = self._upload(view.vertex_normal, wp.vec3)
        pixels.ray, pixels.triangles = self._rays, self._triangles
        pixels.normal = normal = self._memory.array(view.triangle.shape, wp.vec3)

        def fill(first: int, end: int) -> wp.Launch:
            return wp.launch(
                self.pixel_kernels.fill_normals,
                dim=self.pixel_kernels.launch_dim(end - first, self.camera.width),
                inputs=[pixels, first],
                device=self._device,
                record_cmd=True,
            )

        with tracing.span("normals"):
            launch_bands(self._bands, fill)
        return np.asarray(normal.numpy(), dtype=np.float32)

    def material_points_of(self, view: View) -> Float32Array:
        """Return `View.material_point_m` of a view of this renderer."""
        material_point = self._memory.array(view.triangle.shape, wp.vec3)
        wp.launch(
            kernels.fill_material_points,
            dim=view.triangle.shape,
            inputs=[
                self._upload(view.triangle, wp.int32),
                self._upload(view.barycentric, wp.vec2),
                self._triangles,
                self._rest_position,
            ],
            outputs=[material_point],
            device=self._device,
        )
        return np.asarray(material_point.numpy(), dtype=np.float32)
