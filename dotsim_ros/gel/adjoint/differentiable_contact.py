# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The contact law with friction limited by the current pressure, and its derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dotsim_ros.gel.adjoint.kernels import adjoint_kernels
from dotsim_ros.gel.implicit.contact import Contact
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.warp_runtime import wp


@dataclass(frozen=True)
class ContactAdjoint:
    """A loss's derivatives by what the force of markers depends on.

    Attributes:
        position: (A, 3) by their positions, base frame.
        memory: (A, 3) by slip minus position at the end of the last step, indenter's frame.
        stiffness, tangential_stiffness: by those of the law, Pa/m.
        friction: by its coefficient.
        shape: by the indenter's parameters.
        twist: (6,) by a translation of the indenter and a rotation about the base's origin.
    """

    position: FloatArray
    memory: FloatArray
    stiffness: float
    tangential_stiffness: float
    friction: float
    shape: FloatArray
    twist: FloatArray


class MarkerContact:
    """Markers at given positions, in contact with an indenter at a pose.

    At convergence the solver's lagged pressure is the current one, so these are its forces.

    Args:
        contact: law and indenter.
        area_m2: (A,) rest areas of the markers.
        position_m: (A, 3), base frame.
        pose: of the indenter.
        memory_m: (A, 3) slip minus position at the end of the last step, indenter's frame.

    Attributes:
        force_n: (A, 3) on the markers, base frame.
        pressure_pa: (A,).
        slip_m: (A, 3) elastic slip at the end of the step, indenter's frame.
    """

    def __init__(
        self,
        contact: Contact,
        area_m2: FloatArray,
        position_m: FloatArray,
        pose: Pose,
        memory_m: FloatArray,
    ) -> None:
        self._kernels, self._device = adjoint_kernels(), contact.device
        self._field: Any = contact.field
        self._rotation, self._position_m = pose.rotation(), position_m
        law, unit = contact.law, self._kernels.ContactLaw()
        unit.stiffness, unit.onset, unit.smoothing = 1.0, law.onset, law.smoothing
        vec3 = self._kernels.vec3
        local = np.ascontiguousarray((position_m - pose.position_m) @ self._rotation)
        self._local = self._array(local, vec3)
        self._memory = self._array(memory_m, vec3)
        self._constants = self._array(
            np.array([law.stiffness, law.tangential_stiffness, law.friction]), wp.float64
        )
        self._force = self._array(np.zeros((len(area_m2), 3)), vec3)
        self._slip = self._array(np.zeros((len(area_m2), 3)), vec3)
        pressure = wp.zeros(len(area_m2), dtype=wp.float64, device=self._device)
        self._tape = wp.Tape()
        with self._tape:
            wp.launch(
                self._kernels.marker_force,
                dim=len(area_m2),
                inputs=[
                    self._local,
                    wp.array(local, dtype=vec3, device=self._device),
                    self._memory,
                    wp.array(area_m2, dtype=wp.float64, device=self._device),
                    self._field,
                    unit,
                    self._constants,
                ],
                outputs=[self._force, self._slip, pressure],
                device=self._device,
            )
        self.force_n: FloatArray = self._force.numpy() @ self._rotation.T
        self.pressure_pa: FloatArray = pressure.numpy()
        self.slip_m: FloatArray = self._slip.numpy().copy()

    def _array(self, values: FloatArray, dtype: Any) -> Any:
        contiguous = np.ascontiguousarray(values)
        return wp.array(contiguous, dtype=dtype, device=self._device, requires_grad=True)

    def _backward(self, local_force: FloatArray, slip: FloatArray) -> None:
        for array in (self._local, self._memory, self._constants, self._field.parameters):
            array.grad.zero_()
        self._force.grad.assign(np.ascontiguousarray(local_force))
        self._slip.grad.assign(np.ascontiguousarray(slip))
        self._tape.backward()

    def stiffness(self) -> FloatArray:
        """Return (A, 3, 3) derivatives of the forces by the positions, [.., force, position]; with
        friction they are not symmetric."""
        count = len(self.force_n)
        rows = np.empty((count, 3, 3))
        for i in range(3):
            seed = np.zeros((count, 3))
            seed[:, i] = 1.0
            self._backward(seed, np.zeros((count, 3)))
            rows[:, i] = self._local.grad.numpy()
        turned: FloatArray = self._rotation @ rows @ self._rotation.T
        return turned

    def adjoint(self, force: FloatArray, slip: FloatArray) -> ContactAdjoint:
        """Return the derivatives from those by the forces (A, 3), base frame, and by the slip
        (A, 3), indenter's frame."""
        self._backward(force @ self._rotation, slip)
        position = self._local.grad.numpy() @ self._rotation.T
        stiffness, tangential_stiffness, friction = self._constants.grad.numpy().tolist()
        turning = np.cross(self.force_n, force) - np.cross(self._position_m, position)
        return ContactAdjoint(
            position=position,
            memory=self._memory.grad.numpy().copy(),
            stiffness=stiffness,
            tangential_stiffness=tangential_stiffness,
            friction=friction,
            shape=self._field.parameters.grad.numpy().copy(),
            twist=np.concatenate([-position.sum(axis=0), turning.sum(axis=0)]),
        )
