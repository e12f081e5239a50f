# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How near the indenters of many gels come to what the gel is bonded to, in torch's memory."""

# Warp reads kernels by its own rules, which are none of a type checker's.
# mypy: disable-error-code="no-untyped-def, valid-type, misc"

from typing import Any

import torch

from dotsim_ros.gel.batched.kernels import IndenterField, indenter_distance
from dotsim_ros.gel.implicit.gel import CORE_CLEARANCE_M, rigid_points_m
from dotsim_ros.gel.make import body_of
from dotsim_ros.io.warp_runtime import on_torch_stream, wp
from dotsim_ros.specification import GelSpecification

PLACES = 4
"""Looked at on the way to a pose, the last one included."""


@wp.kernel(enable_backward=False)
def _nearest_on_way(
    point: wp.array(dtype=wp.vec3),
    field: wp.array(dtype=IndenterField),
    start: wp.array(dtype=wp.vec3),
    end: wp.array(dtype=wp.vec3),
    rotation: wp.array(dtype=wp.quat),
    places: int,
    distance: wp.array(dtype=wp.float32),
):
    """Least distance of any point from an indenter on a straight way, turned as at its end."""
    b, i = wp.tid()
    for k in range(places):
        share = float(k + 1) / float(places)
        place = point[i] - start[b] - share * (end[b] - start[b])
        d, _gradient, _hessian = indenter_distance(field[b], wp.quat_rotate_inv(rotation[b], place))
        wp.atomic_min(distance, b, d)


class Clearance:
    """Judges poses of B indenters as `ImplicitGel.check_depth` does one.

    Args:
        gel: of the sensor.
        field: Warp array (B,) of the indenters, as `BatchedGel` holds it.
        device: torch's name of the device.
    """

    def __init__(self, gel: GelSpecification, field: Any, device: str) -> None:
        points = torch.as_tensor(rigid_points_m(body_of(gel)), dtype=torch.float32, device=device)
        self._point = wp.from_torch(points, dtype=wp.vec3)
        self._field, self.device = field, device

    @on_torch_stream
    def suffices(
        self, start_m: torch.Tensor, end_m: torch.Tensor, quaternion_xyzw: torch.Tensor
    ) -> torch.Tensor:
        """Return whether (B,) each indenter keeps its distance from core and base.

        Args:
            start_m, end_m: (B, 3) of a straight way, base frame.
            quaternion_xyzw: (B, 4) at its end, of unit length.
        """
        distance = torch.full((len(end_m),), torch.inf, device=end_m.device)
        wp.launch(
            _nearest_on_way,
            dim=(len(end_m), len(self._point)),
            inputs=[
                self._point,
                self._field,
                wp.from_torch(start_m.contiguous(), dtype=wp.vec3),
                wp.from_torch(end_m.contiguous(), dtype=wp.vec3),
                wp.from_torch(quaternion_xyzw.contiguous(), dtype=wp.quat),
                PLACES,
            ],
            outputs=[wp.from_torch(distance)],
            device=self.device,
        )
        return distance >= CORE_CLEARANCE_M
