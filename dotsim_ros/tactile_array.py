# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Many sensors of one kind, solved and seen together in torch's memory. Entry: `TactileArray`.

from dotsim_ros import TactileArray

array = TactileArray("densetact2", 16)
frame = array.step(position_m, quaternion_xyzw)  # (16, 3), (16, 4)
frame.depth_m  # (16, 64, 64)
array.image()  # (16, 64, 64, 3)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike

from dotsim_ros.gel.batched.gel import BatchedGel
from dotsim_ros.gel.batched.memory import TABLE_BYTES, Grid, expect_room
from dotsim_ros.gel.clearance import Clearance
from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.camera import Camera, middle_part
from dotsim_ros.geometry.indenter import Indenter, load_indenter
from dotsim_ros.geometry.markers import PrintedMarkers
from dotsim_ros.io.warp_runtime import known_device, on_torch_stream
from dotsim_ros.optics.batched import BatchedImages, BatchedRenderer
from dotsim_ros.optics.idle import part_of_idle
from dotsim_ros.optics.network import completion_network
from dotsim_ros.optics.pattern import idle_frame_of
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.sensor import FARTHEST_M, FRAME_S
from dotsim_ros.specification import SensorSpecification, given_sensor

AnIndenter = str | Path | Mapping[str, Any] | Indenter

AWAY_M = 5.0e-3
"""From the gel to an indenter that is away, at least."""
SMALLEST_NORM = 1.0e-6
"""Of a quaternion."""
PIXEL_BYTES = 8 + 4 + 2 * (4 + 12)
"""Of z-buffer, triangle, and depth and normal twice: the renderer's and the frame's."""


@dataclass(frozen=True)
class ArrayFrame:
    """What B sensors give for one pose of each indenter; the tensors belong to this frame alone.

    Attributes:
        depth_m: (B, H, W) range, the distance along the ray; NaN where no skin is seen.
        normal: (B, H, W, 3) unit normal in the optical frame, towards the camera; NaN likewise.
        marker_px: (B, M, 2) x and y of the printed markers, also of one beyond the image's edge;
            NaN where the camera has no image of it.
        skin_position_m: (B, V, 3) skin markers, base frame.
        force_n, torque_nm: (B, 3) of the gel on the indenter, torque about the base's origin.
        is_valid: (B,) whether the pose was one that the sensor takes. Where it was not, the sensor
            shows its last valid state.
        converged: (B,) whether the gel's solver ended before its steps did: its last one moved
            nothing by 4 um.
    """

    depth_m: torch.Tensor
    normal: torch.Tensor
    marker_px: torch.Tensor
    skin_position_m: torch.Tensor
    force_n: torch.Tensor
    torque_nm: torch.Tensor
    is_valid: torch.Tensor
    converged: torch.Tensor


class TactileArray:
    """B sensors of one kind, each with its indenter.

    A pose is not valid where a number is not finite, the quaternion is zero, the indenter is
    farther than `FARTHEST_M`, or comes too near to the gel's core or base, also on its straight way
    from the last pose. That sensor then stays as it is, and the others go on. So it is where a gel
    could not be solved; that one is at rest again once its indenter has left it.

    Args:
        sensor: a name below `params/sensors`, a YAML file, or a specification.
        count: B.
        indenters: one for all sensors, or one for each: a name below `params/indenters`, a YAML
            file, a mesh in metres, a mapping as `load_indenter` takes it, or an indenter.
        image_size: width and height of depth, normals and image. What is seen is the part in the
            middle of the camera's image that has this shape.
        friction: (B,) coefficients; None for the sensor's.
        modulus_factor: (B,) each gel's Young's modulus over the sensor's; None for 1.
        grid: of the gel; `fine`, of half the spacing, is for small contacts, edges and cones.
        device: torch's name of the device.

    Attributes:
        camera: of the images.
        rest_position_m: (V, 3) the skin at rest, base frame.

    Raises:
        FileNotFoundError: no such sensor or indenter.
        ValueError: an argument is not valid, the gel is one that `BatchedGel` does not take, or
            the sensors do not fit into the device's memory.
    """

    _position_m: torch.Tensor
    _quaternion: torch.Tensor
    _skin_m: torch.Tensor
    _force_n: torch.Tensor
    _torque_nm: torch.Tensor

    def __init__(
        self,
        sensor: str | Path | SensorSpecification,
        count: int,
        indenters: AnIndenter | Sequence[AnIndenter] = "sphere_4mm",
        *,
        image_size: tuple[int, int] = (64, 64),
        friction: ArrayLike | None = None,
        modulus_factor: ArrayLike | None = None,
        grid: Grid = "default",
        device: str = "cpu",
    ) -> None:
        if count < 1:
            raise ValueError(f"count is {count}, expected at least one sensor")
        if min(image_size) < 1:
            raise ValueError(f"image_size is {image_size}, expected a width and a height in pixels")
        device = known_device(device)
        specification = given_sensor(sensor)
        skin = skin_of(specification.gel)
        markers = None
        if specification.markers.columns:
            markers = PrintedMarkers(specification.markers, skin)
        marker_count = 0 if markers is None else len(markers.corner)
        if grid not in TABLE_BYTES:
            raise ValueError(f"grid is {grid!r}, expected {' or '.join(TABLE_BYTES)}")
        image_bytes = PIXEL_BYTES * image_size[0] * image_size[1] + 16.0 * marker_count
        expect_room(count, skin.vertex_count, grid, device, image_bytes=image_bytes, what="sensors")
        each = _each_of(indenters, count)
        self.count, self.device = count, device
        self._specification, self._skin_mesh, self._markers = specification, skin, markers
        self._whole_camera = Camera.from_specification(specification.camera)
        whole_size = self._whole_camera.width, self._whole_camera.height
        self._part = middle_part(whole_size, image_size)
        self.camera = self._whole_camera.part(*self._part).scaled(*image_size)
        # It takes tensors too.
        self._gel: Any = BatchedGel(
            specification,
            each,
            count,
            friction=friction,
            modulus_factor=modulus_factor,
            grid=grid,
            device=device,
        )
        self._renderer = BatchedRenderer(self.camera, skin, count, markers=markers, device=device)
        self._clearance = Clearance(specification.gel, self._gel.field, device)
        reach_m = max(float(np.linalg.norm(one.bounds_m(), axis=1).max()) for one in each)
        self._away_m = float(np.linalg.norm(skin.rest_position_m, axis=1).max()) + reach_m + AWAY_M
        self.rest_position_m = torch.as_tensor(
            skin.rest_position_m, dtype=torch.float32, device=device
        )
        self.reset()

    def reset(self, sensors: torch.Tensor | None = None) -> None:
        """Return sensors to rest, with their indenters away.

        Args:
            sensors: (B,) bool, which; None for all.
        """
        self._gel.reset(sensors)
        if sensors is None:
            self._noise = torch.Generator(self.device).manual_seed(self._specification.noise.seed)
        b = self.count
        rest = {
            "_position_m": torch.tensor([[0.0, 0.0, self._away_m]], device=self.device),
            "_quaternion": torch.tensor([[0.0, 0.0, 0.0, 1.0]], device=self.device),
            "_skin_m": self.rest_position_m[None],
            "_force_n": torch.zeros(1, 3, device=self.device),
            "_torque_nm": torch.zeros(1, 3, device=self.device),
        }
        for name, value in rest.items():
            if sensors is None:
                setattr(self, name, value.repeat(b, *(1,) * (value.dim() - 1)))
            else:
                chosen = sensors.view(-1, *(1,) * (value.dim() - 1))
                setattr(self, name, torch.where(chosen, value, getattr(self, name)))
        self._renderer.render(self._skin_m)

    @on_torch_stream
    def step(
        self,
        position_m: ArrayLike | torch.Tensor,
        quaternion_xyzw: ArrayLike | torch.Tensor,
        dt_s: float = FRAME_S,
    ) -> ArrayFrame:
        """Move each indenter to its pose on a straight way and return what the sensors give.

        The first pose after a reset is approached along the indenter's axis.

        Args:
            position_m: (B, 3) of the indenters' frames (origin at the tip, +z away from the gel),
                base frame.
            quaternion_xyzw: (B, 4), of any length but zero.
            dt_s: seconds since the last step; they matter to a gel that relaxes.

        Raises:
            ValueError: another shape, what is no number, or a duration that is not positive.
            DeviceError: the device lacks memory or has failed; the sensors are as they were after
                the last part of their way that was solved, and go on from there if it works again.
        """
        if not dt_s > 0.0:
            raise ValueError(f"dt_s is {dt_s}, expected a positive number of seconds")
        position = self._given(position_m, "position_m", 3)
        quaternion = self._given(quaternion_xyzw, "quaternion_xyzw", 4)
        norm = quaternion.norm(dim=1, keepdim=True)
        is_valid = (
            torch.isfinite(position).all(dim=1)
            & (position.abs() <= FARTHEST_M).all(dim=1)
            & torch.isfinite(norm[:, 0])
            & (norm[:, 0] >= SMALLEST_NORM)
        )
        # An indenter that is farther touches nothing either, and takes longer to get there.
        nearness = self._away_m / position.norm(dim=1, keepdim=True)
        position, quaternion = position * nearness.clamp(max=1.0), quaternion / norm
        position, quaternion = self._or_last(is_valid, position, quaternion)
        is_valid &= self._clearance.suffices(self._position_m, position, quaternion)
        position, quaternion = self._or_last(is_valid, position, quaternion)
        state = self._gel.step(position, quaternion, dt_s)
        self._position_m, self._quaternion = position, quaternion
        is_valid &= torch.isfinite(state.left_m)
        changed = is_valid[:, None]
        self._skin_m = torch.where(changed[:, None], state.skin_position_m, self._skin_m)
        self._force_n = torch.where(changed, state.force_n, self._force_n)
        self._torque_nm = torch.where(changed, state.torque_nm, self._torque_nm)
        view = self._renderer.render(self._skin_m)
        return ArrayFrame(
            view.depth_m.clone(),
            view.normal.clone(),
            view.marker_px.clone(),
            self._skin_m.clone(),
            self._force_n.clone(),
            self._torque_nm.clone(),
            is_valid,
            state.left_m < self._gel.effort.tolerance_m,
        )

    @on_torch_stream
    def image(self) -> torch.Tensor:
        """Return the images (B, H, W, 3) of the last frame, uint8, red, green, blue: those of
        `TactileSensor` but for what their noise is drawn by.

        Raises:
            FileNotFoundError: the sensor's idle image or network is not there.
            ValueError: one of them is not valid, or a network completes the image and `image_size`
                has another shape than the camera's: it knows the whole view only.
        """
        image = self._images.render()
        levels = self._specification.noise.deviation_levels
        if levels <= 0.0:
            return image
        size = *image.shape[:3], self._specification.camera.channel_count
        noise = levels * torch.randn(size, generator=self._noise, device=self.device)
        noisy = (image + noise).round().clamp(0.0, 255.0).to(torch.uint8)
        return torch.where(image > 0, noisy, 0)

    @cached_property
    def _images(self) -> BatchedImages:
        """Made on first use: depth and markers need none of it."""
        size = self.camera.width, self.camera.height
        whole = 0, 0, self._whole_camera.width, self._whole_camera.height
        residual = self._specification.camera.residual
        if residual and self._part != whole:
            raise ValueError(
                f"a network ({residual}) completes the image and knows the whole view only: "
                f"image_size is {size}, expected the shape of {whole[2:]}"
            )
        idle = idle_frame_of(self._specification, self._whole_camera)
        if (self._part, size) != (whole, whole[2:]):
            idle = part_of_idle(idle, self._part, size)
        network = completion_network(self._specification, self.camera)
        completion = None
        if network is not None:
            untouched = SkinRenderer(self.camera, self._skin_mesh).render(
                self._skin_mesh.rest_position_m
            )
            completion = network.at_rest(untouched, idle.image)
        return BatchedImages(self._renderer, self._skin_mesh, idle, completion=completion)

    def _or_last(
        self, is_valid: torch.Tensor, position_m: torch.Tensor, quaternion: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return poses (B, 3), (B, 4), the last ones where (B,) these are not valid."""
        takes = is_valid[:, None]
        return (
            torch.where(takes, position_m, self._position_m),
            torch.where(takes, quaternion, self._quaternion),
        )

    def _given(self, values: ArrayLike | torch.Tensor, name: str, width: int) -> torch.Tensor:
        """Return what a caller gives for each sensor (B, width).

        Raises:
            ValueError: it is something else.
        """
        if not isinstance(values, torch.Tensor):
            try:
                values = torch.from_numpy(np.array(values, dtype=np.float32))
            except (TypeError, ValueError) as error:
                raise ValueError(f"{name} holds what is not a number: {error}") from error
        given = values.detach().to(self.device, torch.float32)
        if given.shape != (self.count, width):
            raise ValueError(
                f"{name} has the shape {tuple(given.shape)}, expected ({self.count}, {width}): a "
                "row for each sensor"
            )
        return given


def _each_of(indenters: AnIndenter | Sequence[AnIndenter], count: int) -> list[Indenter]:
    """Return an indenter for each of B sensors.

    Raises:
        ValueError: another number of them.
    """
    if isinstance(indenters, str | Path | Mapping | Indenter):
        indenters = [indenters]
    if len(indenters) not in (1, count):
        raise ValueError(f"{len(indenters)} indenters for {count} sensors, expected one or each")
    # Equal names are one indenter.
    named: dict[str, Indenter] = {}
    loaded = [
        one
        if isinstance(one, Indenter)
        else named.get(str(one)) or named.setdefault(str(one), load_indenter(one))
        for one in indenters
    ]
    return loaded * (count // len(loaded))
