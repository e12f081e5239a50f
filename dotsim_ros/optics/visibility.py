# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which triangle of the skin every pixel sees: the same answer on a CPU and on CUDA.

Both send the same ray through each pixel's centre, in single precision. A CPU walks over the
triangles and tests the pixels in the box around each: 640x480 in a few milliseconds, since the
skin's triangles are a few pixels large. CUDA traces the rays through Warp's bounding volumes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dotsim_ros.geometry.camera import Camera, PinholeCamera
from dotsim_ros.io.arrays import Float32Array, FloatArray, IndexArray
from dotsim_ros.io.warp_runtime import wp
from dotsim_ros.optics import host_kernels, kernels
from dotsim_ros.optics.bands import cut, launch_bands


def lens_of(camera: Camera) -> Any:
    """Return the camera's model as the kernels' struct."""
    lens = kernels.Lens()
    lens.focal_x, lens.focal_y = camera.focal_xy_px
    lens.principal_x, lens.principal_y = camera.principal_point_px
    lens.distortion = wp.vec4(*camera.distortion)
    lens.widest_angle = camera.widest_angle_rad
    lens.least_cotangent = 1.0 / np.tan(camera.widest_angle_rad)
    lens.pinhole = int(camera.projection == PinholeCamera.projection)
    lens.edge_curvature = camera.edge_curvature
    return lens


class RasterFinder:
    """The rasteriser of a CPU, whose triangles share pixels.

    Args:
        camera: the camera.
        rays: (H, W, 3) in the optical frame; one that is not finite sees nothing.
        triangles: (T, 3) int32 vertices of each.
        rest_pixel: (V, 2) images of the vertices at rest, NaN where they have none.
        band_count: bands of rows that threads share.

    Raises:
        ValueError: the image has fewer pixels than are tested at once.
    """

    def __init__(
        self,
        camera: Camera,
        rays: Float32Array,
        triangles: IndexArray,
        rest_pixel: FloatArray,
        band_count: int,
    ) -> None:
        if camera.width * camera.height < host_kernels.LANES:
            raise ValueError(
                f"image is {camera.width}x{camera.height}, the rasteriser needs at least "
                f"{host_kernels.LANES} pixels"
            )
        self._lens = lens_of(camera)
        parts = np.ascontiguousarray(np.moveaxis(rays, 2, 0))
        self._rays: wp.array = wp.array(parts, dtype=wp.float32, device="cpu")
        self._triangles: wp.array = wp.array(triangles, dtype=wp.int32, device="cpu")
        # Row by row, so that pixels stay in a core's cache while neighbours are drawn.
        order = np.argsort(np.floor(rest_pixel[triangles[:, 0], 1]), kind="stable")
        self._order: wp.array = wp.array(order, dtype=wp.int32, device="cpu")
        fewest_rows = -(-host_kernels.LANES // camera.width)
        self._bands = cut(camera.height, band_count, smallest=fewest_rows)

    def find(
        self,
        position: wp.array,
        pixel: wp.array,
        triangle: wp.array,
        barycentric: wp.array,
        depth: wp.array,
    ) -> None:
        """Write the nearest triangle along every ray from the origin of the optical frame.

        Args:
            position: (V,) vec3 vertices in the optical frame, metres.
            pixel: (V,) vec2 their images.
            triangle: (H, W) int32, written: the triangle, or NO_TRIANGLE.
            barycentric: (H, W) vec2, written where a triangle is seen: the weights of its second
                and third corner.
            depth: (H, W) float32, written where a triangle is seen: metres along the ray.
        """
        triangle.fill_(kernels.NO_TRIANGLE)

        def rasterize(first: int, end: int) -> wp.Launch:
            return wp.launch(
                host_kernels.rasterize,
                dim=len(self._triangles),
                inputs=[
                    position,
                    pixel,
                    self._triangles,
                    self._order,
                    self._rays,
                    self._lens,
                    first,
                    end,
                ],
                outputs=[triangle, barycentric, depth],
                device="cpu",
                record_cmd=True,
            )

        launch_bands(self._bands, rasterize)


class RayQueryFinder:
    """Warp's mesh query, for CUDA; the hierarchy is built once and refitted to every new shape."""

    def __init__(self, rays: wp.array, triangles: wp.array, vertices: wp.array) -> None:
        self._rays = rays
        self._mesh = wp.Mesh(points=wp.clone(vertices), indices=triangles.flatten())

    def find(
        self,
        position: wp.array,
        pixel: wp.array,
        triangle: wp.array,
        barycentric: wp.array,
        depth: wp.array,
    ) -> None:
        """Write what `RasterFinder.find` does."""
        wp.copy(self._mesh.points, position)
        self._mesh.refit()
        wp.launch(
            kernels.cast_rays,
            dim=self._rays.shape,
            inputs=[self._mesh.id, self._rays],
            outputs=[triangle, barycentric, depth],
            device=self._rays.device,
        )
