# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The image: the idle frame warped along by the skin, and shaded again to first order.

Every pixel shows the material point that it shows in the idle frame somewhere else; the colour is
taken from there and multiplied by the change of the light that reaches the point: the sum over the
LEDs of the cosine of incidence over the squared distance (a Lambertian coat), relative to that at
rest. A glossy coat also mirrors the LEDs, in a lobe around the half-way direction (Blinn, "Models
of light reflection for computer synthesized pictures", 1977). At rest the image is the idle frame,
bit for bit. What this leaves out (shadows, light between parts of the dome) is left to a completion
that may be learned. On a CPU threads share the rows, see `bands`.
"""

from __future__ import annotations

from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io import tracing
from dotsim_ros.io.arrays import BoolArray, Float32Array, ImageArray
from dotsim_ros.io.warp_runtime import wp
from dotsim_ros.optics import host_kernels, kernels
from dotsim_ros.optics.bands import cut, launch_bands, thread_count
from dotsim_ros.optics.frame_memory import FrameMemory
from dotsim_ros.optics.idle import check_fine, check_image, lit_region
from dotsim_ros.optics.lighting import Lighting, Vignetting
from dotsim_ros.optics.renderer import SkinRenderer, View

RIM_PX = 2
"""Width of the soft rim of the lit disc, whose colours are not spread outwards."""


class Completion(Protocol):
    """What a learned model adds to the warped image."""

    def __call__(
        self, depth_m: Float32Array, normal: Float32Array, warped: ImageArray
    ) -> Float32Array:
        """Return grey levels (H, W, 3) to add to the warped image (H, W, 3) of a view's depth
        (H, W) and normals (H, W, 3)."""


def spread_outwards(image: Float32Array, region: BoolArray) -> Float32Array:
    """Return the image (H, W, 3) with every pixel outside the region taken from the nearest pixel
    well inside it, so that what moves in from beyond the rim has the rim's colour."""
    kernel = np.ones((2 * RIM_PX + 1, 2 * RIM_PX + 1), dtype=np.uint8)
    inside = cv2.erode(region.astype(np.uint8), kernel)
    if not inside.any():
        return image
    _, labels = cv2.distanceTransformWithLabels(
        1 - inside, cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    colour = np.zeros((int(labels.max()) + 1, 3), dtype=np.float32)
    colour[labels[inside > 0]] = image[inside > 0]
    return np.where(region[..., None], image, colour[labels])


def double_resolution(image: Float32Array) -> Float32Array:
    """Return the image (H, W[, 3]) with cubic samples half-way between its own, which stay:
    (2 H - 1, 2 W - 1[, 3]). Linear interpolation in it is nearly as sharp as cubic in the image."""
    height, width = image.shape[:2]
    x, y = np.meshgrid(
        0.5 * np.arange(2 * width - 1, dtype=np.float32),
        0.5 * np.arange(2 * height - 1, dtype=np.float32),
    )
    fine = cv2.remap(image, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(fine, dtype=np.float32)


def leds_of(lighting: Lighting, camera: Camera, device: wp.Device) -> wp.array:
    """Return the LEDs in the optical frame, as the kernels' struct."""
    leds = []
    for light in lighting.lights:
        led = kernels.Led()
        led.position = wp.vec3(*camera.to_optical(light.position_m))
        led.intensity = wp.vec3(*light.intensity)
        leds.append(led)
    return wp.array(leds, dtype=kernels.Led, device=device)


def direct_light(
    position: wp.array, outward: wp.array, leds: wp.array, lighting: Lighting
) -> wp.array:
    """Return (N,) vec3 light that the inner side of points sends to the camera.

    Args:
        position: (N,) vec3 in the optical frame, metres.
        outward: (N,) vec3 unit normals out of the gel.
        leds: the LEDs, in the optical frame.
        lighting: the gloss of the coat.
    """
    irradiance = wp.empty_like(position)
    of_device = host_kernels if wp.get_device(position.device).is_cpu else kernels
    wp.launch(
        of_device.irradiate,
        dim=of_device.point_dim(len(position)),
        inputs=[position, outward, leds, lighting.gloss, lighting.gloss_exponent],
        outputs=[irradiance],
        device=position.device,
    )
    return irradiance


class ImageRenderer:
    """Makes images of one skin from one idle frame.

    Args:
        camera: the camera, as of the renderer that makes the views.
        skin_mesh: the skin, as of that renderer.
        idle_image: (H, W, 3) uint8, of the camera's size (`fit_idle_image` brings any to it).
        lighting: the LEDs.
        vignetting: of the camera; it stays while the pattern moves.
        fine: (2 H - 1, 2 W - 1, 3) uint8, the idle image with samples half-way between its own,
            and with the rim's colours beyond the lit disc; None to interpolate them.
        completion: what to add to the warped image; None for nothing.
        device: Warp's name of the device.
        band_count: bands of rows that threads share; None for as many as `bands.thread_count` on a
            CPU, else one. Any number gives the same to the last bit.

    Attributes:
        pixel_kernels: the module whose kernel colours the image; both give the same.
        lighting, leds: the LEDs, in the base frame, and for kernels.
        ambient: what reaches every point from all other directions.
        fine_pattern: (2 H - 1, 2 W - 1, 3) float32, what is warped: the idle image without
            vignetting, with samples half-way between its own.

    Raises:
        ValueError: the idle image has another size than the camera, is a single row or column, or
            is no colour image; or the samples between do not belong to it.
    """

    def __init__(
        self,
        camera: Camera,
        skin_mesh: SkinMesh,
        idle_image: ImageArray,
        *,
        lighting: Lighting | None = None,
        vignetting: Vignetting | None = None,
        fine: ImageArray | None = None,
        completion: Completion | None = None,
        device: str = "cpu",
        band_count: int | None = None,
    ) -> None:
        check_image(idle_image)
        if idle_image.shape[:2] != (camera.height, camera.width):
            raise ValueError(
                f"idle image is {idle_image.shape[1]}x{idle_image.shape[0]}, expected "
                f"{camera.width}x{camera.height}; bring it to the camera with fit_idle_image"
            )
        if min(camera.width, camera.height) < 2:
            raise ValueError(
                f"idle image is {camera.width}x{camera.height}, expected two pixels each way"
            )
        self.completion = completion
        self._camera = camera
        self.lighting = lighting or Lighting()
        self._device = wp.get_device(device)
        self.pixel_kernels = host_kernels if self._device.is_cpu else kernels
        if band_count is None:
            band_count = thread_count() if self._device.is_cpu else 1
        self._bands = cut(camera.height, band_count)
        self._memory = FrameMemory(self._device)
        self.leds = leds_of(self.lighting, camera, self._device)
        self._triangles = self._upload(skin_mesh.triangles, wp.int32)
        self._set_rest(SkinRenderer(camera, skin_mesh, device=device))
        self._set_idle(idle_image, fine, (vignetting or Vignetting()).brightness(camera))

    def _upload(self, array: NDArray[np.generic], dtype: type) -> wp.array:
        # No copy on a CPU: what is uploaded is only read.
        return wp.array(np.ascontiguousarray(array), dtype=dtype, device=self._device, copy=False)

    def _set_rest(self, renderer: SkinRenderer) -> None:
        view = renderer.render(renderer.skin_mesh.rest_position_m)
        self._rest_pixel = self._upload(view.vertex_pixel, wp.vec2)
        self._rest_irradiance = self._irradiance(view)
        mean = self._rest_irradiance.numpy().mean(axis=0)
        # A colour without any direct light keeps its brightness.
        ambient = np.where(mean > 0.0, self.lighting.ambient_fraction * mean, 1.0)
        self.ambient = wp.vec3(*ambient)

    def _set_idle(
        self, idle_image: ImageArray, fine: ImageArray | None, brightness: Float32Array
    ) -> None:
        lit = lit_region(idle_image)
        self._idle = self._upload(idle_image, wp.uint8)
        self._lit = self._upload(lit.astype(np.uint8), wp.uint8)
        self._brightness = self._upload(brightness, wp.float32)
        if fine is None:
            flat = idle_image.astype(np.float32) / brightness[..., None]
            self.fine_pattern = double_resolution(spread_outwards(flat, lit))
        else:
            check_fine(fine, idle_image)
            self.fine_pattern = fine.astype(np.float32)
            self.fine_pattern /= double_resolution(brightness)[..., None]
        self._fine_flat = self._upload(self.fine_pattern, wp.vec3)

    def _irradiance(self, view: View) -> wp.array:
        return direct_light(
            self._upload(view.vertex_position_m, wp.vec3),
            self._upload(view.vertex_normal, wp.vec3),
            self.leds,
            self.lighting,
        )

    def _gain(self, view: View) -> wp.array:
        gain = wp.empty_like(self._rest_irradiance)
        wp.launch(
            kernels.brightness_gain,
            dim=len(gain),
            inputs=[
                self._irradiance(view),
                self._rest_irradiance,
                self.ambient,
                self.lighting.exponent,
            ],
            outputs=[gain],
            device=self._device,
        )
        return gain

    def vertex_gain(self, view: View) -> Float32Array:
        """Return the brightness (V, 3) of each vertex over that at rest, without vignetting."""
        return np.asarray(self._gain(view).numpy(), dtype=np.float32)

    def _change(self, view: View) -> wp.array:
        """Return (T, 3) what pixels of each triangle interpolate, see the kernel."""
        change = wp.empty(self._triangles.shape, dtype=kernels.vec8, device=self._device)
        wp.launch(
            kernels.triangle_changes,
            dim=len(change),
            inputs=[
                self._triangles,
                self._rest_pixel,
                self._upload(view.vertex_pixel, wp.vec2),
                self._gain(view),
            ],
            outputs=[change],
            device=self._device,
        )
        return change

    def pixels_at_rest(self) -> Any:
        """Return a `kernels.ImagePixels` with what all frames have in common."""
        pixels = kernels.ImagePixels()
        pixels.lit, pixels.vignetting = self._lit, self._brightness
        pixels.idle, pixels.fine_flat = self._idle, self._fine_flat
        return pixels

    def warp(self, view: View) -> ImageArray:
        """Return the image (H, W, 3) without the completion."""
        image = self._memory.array(self._idle.shape, wp.uint8)
        pixels = self.pixels_at_rest()
        pixels.triangle_seen = self._upload(view.triangle, wp.int32)
        pixels.barycentric = self._upload(view.barycentric, wp.vec2)
        pixels.image, pixels.change = image, self._change(view)

        def warp_idle(first: int, end: int) -> wp.Launch:
            return wp.launch(
                self.pixel_kernels.warp_idle,
                dim=self.pixel_kernels.launch_dim(end - first, self._camera.width),
                inputs=[pixels, first],
                device=self._device,
                record_cmd=True,
            )

        launch_bands(self._bands, warp_idle)
        return np.asarray(image.numpy(), dtype=np.uint8)

    def render(self, view: View) -> ImageArray:
        """Return the image (H, W, 3), red, green, blue, of what the camera sees."""
        with tracing.span("warp"):
            warped = self.warp(view)
        if self.completion is None:
            return warped
        return self.completed(view.depth_m, view.normal, warped)

    def completed(
        self, depth_m: Float32Array, normal: Float32Array, warped: ImageArray
    ) -> ImageArray:
        """Return the warped image (H, W, 3) of a view's depth (H, W) and normals (H, W, 3) with
        what the completion adds."""
        assert self.completion is not None
        # Rounded and clipped to whole grey levels.
        with tracing.span("network"):
            added = cv2.add(warped, self.completion(depth_m, normal, warped), dtype=cv2.CV_8U)
        return np.asarray(added, dtype=np.uint8)
