# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frictional contact of the skin's markers with a rigid indenter.

Pressure grows with the penetration of a marker, C2 near zero; friction is Coulomb's law with a
tangential spring while sticking and return to the limit while slipping (Wriggers, "Computational
Contact Mechanics", 2006, chapters 5 and 9). Its limit and its plane use pressure and normal of the
previous iteration, so that every iteration has an energy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dotsim_ros.gel.distance_field import indenter_field
from dotsim_ros.gel.implicit.contact_kernels import contact_kernels
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose, Wrench
from dotsim_ros.io.arrays import FloatArray, IndexArray
from dotsim_ros.io.warp_runtime import wp
from dotsim_ros.specification import ContactSpecification

REFERENCE_SPACING_M = 1.2e-3
ONSET_M = 5.0e-6
"""Distance at which the pressure begins; about half the penetration under a usual pressure, so
that gap and penetration share the error of the penalty."""
SMOOTHING_M = 4.0e-6


@dataclass(frozen=True)
class ContactResponse:
    """What the indenter does to the candidates.

    Attributes:
        distance_m: (C,) signed distance to the indenter.
        pressure_pa: (C,) contact pressure per rest area.
        force_n: (C, 3) force on the markers, base frame.
        energy_j: sum of the contact energies.
        stiffness: (C, 3, 3) minus the derivative of the forces, N/m: of lagged friction the
            positive semi-definite part, of Coulomb's law all of it.
        local_position_m, slip_m: (C, 3) in the indenter's frame, the history if the step ends.
        normal: (C, 3) gradient of the distance, base frame.
    """

    distance_m: FloatArray
    pressure_pa: FloatArray
    force_n: FloatArray
    energy_j: float
    stiffness: FloatArray
    local_position_m: FloatArray
    slip_m: FloatArray
    normal: FloatArray


NO_RESPONSE = ContactResponse(
    distance_m=np.zeros(0),
    pressure_pa=np.zeros(0),
    force_n=np.zeros((0, 3)),
    energy_j=0.0,
    stiffness=np.zeros((0, 3, 3)),
    local_position_m=np.zeros((0, 3)),
    slip_m=np.zeros((0, 3)),
    normal=np.zeros((0, 3)),
)
"""The response of no candidates."""


@dataclass(frozen=True)
class Lag:
    """What the friction of an iteration takes from the previous one: pressure (C,) and normal
    (C, 3) of the candidates, a zero normal for none."""

    pressure_pa: FloatArray
    normal: FloatArray


@dataclass
class ContactHistory:
    """Memory of friction: position and elastic slip (V, 3) of the markers in the indenter's frame
    at the end of the last step, the pressure then (V,), and the signed distance (V,), infinite
    where it was not asked for."""

    local_position_m: FloatArray
    slip_m: FloatArray
    pressure_pa: FloatArray
    distance_m: FloatArray


def fresh_history(rest_position_m: FloatArray, pose: Pose) -> ContactHistory:
    """Return the history of a skin that has touched nothing."""
    local = (rest_position_m - pose.position_m) @ pose.rotation()
    count = len(local)
    return ContactHistory(local, np.zeros_like(local), np.zeros(count), np.full(count, np.inf))


def contact_law(kind: Any, specification: ContactSpecification, youngs_modulus_pa: float) -> Any:
    """Return what kernels know of the contact, as one of their structs `ContactLaw`; its
    stiffnesses are scaled to E."""
    law = kind()
    law.stiffness = specification.stiffness * youngs_modulus_pa / REFERENCE_SPACING_M
    law.tangential_stiffness = specification.tangential_ratio * law.stiffness
    law.friction = specification.friction_coefficient
    law.onset = ONSET_M
    law.smoothing = SMOOTHING_M
    return law


class Contact:
    """The contact law with one indenter, for a skin of V markers.

    Args:
        indenter: the rigid shape.
        area_m2: (V,) rest area of the markers.
        youngs_modulus_pa: E, to which the stiffnesses are scaled.
        specification: friction and stiffness.

    Attributes:
        least_compliance_m_n: of a marker under pressure.
    """

    def __init__(
        self,
        indenter: Indenter,
        area_m2: FloatArray,
        youngs_modulus_pa: float,
        specification: ContactSpecification,
        *,
        device: str = "cpu",
    ) -> None:
        self.indenter = indenter
        self.device = device
        self.kernels = contact_kernels(wp.float64)
        self.field: Any = indenter_field(indenter, scalar=wp.float64, device=device)
        self.area: Any = wp.array(area_m2, dtype=wp.float64, device=device)
        self.law = law = contact_law(self.kernels.ContactLaw, specification, youngs_modulus_pa)
        self.least_compliance_m_n = 1.0 / (law.stiffness * float(area_m2.max()))
        self._history: ContactHistory | None = None
        self._pose: Pose | None = None
        self._record(len(area_m2))

    def set_area(self, area_m2: FloatArray) -> None:
        """Let each marker bear for another area (V,)."""
        self.area.assign(area_m2)

    def respond(
        self,
        candidate: IndexArray,
        position_m: FloatArray,
        pose: Pose,
        history: ContactHistory,
        lag: Lag,
    ) -> ContactResponse:
        """Return the response of candidate markers (C,) at positions (C, 3) to the indenter, with
        friction limited by a lag."""
        count = len(candidate)
        self._inputs["lagged_pressure"][:count] = lag.pressure_pa
        self._inputs["lagged_normal"][:count] = lag.normal
        return self._launched(self._lagged, candidate, position_m, pose, history)

    def respond_now(
        self, candidate: IndexArray, position_m: FloatArray, pose: Pose, history: ContactHistory
    ) -> ContactResponse:
        """Return the response of candidate markers (C,) at positions (C, 3) to the indenter, with
        friction limited by the pressure that there is."""
        return self._launched(self._coulomb, candidate, position_m, pose, history)

    def _launched(
        self,
        launch: Any,
        candidate: IndexArray,
        position_m: FloatArray,
        pose: Pose,
        history: ContactHistory,
    ) -> ContactResponse:
        count = len(candidate)
        if count == 0:
            return NO_RESPONSE
        host = self._inputs
        host["candidate"][:count] = candidate
        host["position"][:count] = position_m
        if history is not self._history:
            host["start_position"][:] = history.local_position_m
            host["start_slip"][:] = history.slip_m
            self._history = history
        if not self._is_shared:
            for name, array in self._device_inputs.items():
                array.assign(host[name])
        if pose is not self._pose:
            k = self.kernels
            self._indenter.rotation = k.mat33(*pose.rotation().ravel().tolist())
            self._indenter.origin = k.vec3(*pose.position_m.tolist())
            for recorded in (self._lagged, self._coulomb):
                recorded.set_param_by_name("indenter", self._indenter)
            self._pose = pose
        launch.set_dim(count)
        launch.launch()
        distance, pressure, force, energy, *others = (
            output[:count].copy() for output in self._output_arrays()
        )
        return ContactResponse(distance, pressure, force, float(energy.sum()), *others)

    def _record(self, count: int) -> None:
        """Record the launches for at most `count` candidates: recorded, they cost a tenth."""
        k, device = self.kernels, self.device
        self._inputs: dict[str, Any] = {
            "candidate": np.zeros(count, dtype=np.int32),
            "position": np.zeros((count, 3)),
            "lagged_pressure": np.zeros(count),
            "lagged_normal": np.zeros((count, 3)),
            "start_position": np.zeros((count, 3)),
            "start_slip": np.zeros((count, 3)),
        }
        input_dtypes = (wp.int32, k.vec3, wp.float64, k.vec3, k.vec3, k.vec3)
        # On a CPU they share their memory with the arrays of the host.
        self._device_inputs: dict[str, Any] = {
            name: wp.array(values, dtype=dtype, device=device, copy=False)
            for (name, values), dtype in zip(self._inputs.items(), input_dtypes, strict=True)
        }
        self._is_shared = self._device_inputs["position"].device.is_cpu
        dtypes = (wp.float64, wp.float64, k.vec3, wp.float64, k.mat33, k.vec3, k.vec3, k.vec3)
        self._outputs = [wp.empty(count, dtype=dtype, device=device) for dtype in dtypes]
        on_host = [output.numpy() for output in self._outputs]
        # A view that is taken once: to take it costs more than a launch.
        self._output_arrays: Callable[[], list[FloatArray]] = (
            (lambda: on_host)
            if self._is_shared
            else (lambda: [output.numpy() for output in self._outputs])
        )
        candidate, position, pressure, normal, start, slip = self._device_inputs.values()
        markers = _filled(k.Markers, candidate, position, self.area, start, slip)
        self._indenter = _filled(k.PlacedIndenter, self.field, k.mat33(), k.vec3())
        response = _filled(k.Response, *self._outputs)

        def record(kernel: Any, *lag: Any) -> Any:
            inputs = [markers, self._indenter, self.law, *lag, response]
            return wp.launch(kernel, dim=count, inputs=inputs, device=device, record_cmd=True)

        self._lagged = record(k.contact_response, pressure, normal)
        self._coulomb = record(k.coulomb_response)


def _filled(kind: Any, *values: Any) -> Any:
    """Return a struct of kernels with values in the order of its fields."""
    made = kind()
    for name, value in zip(kind.vars, values, strict=True):
        setattr(made, name, value)
    return made


def wrench_on_indenter(position_m: FloatArray, force_on_marker_n: FloatArray) -> Wrench:
    """Return the force of the gel on the indenter and its torque about the base frame's origin."""
    return Wrench(
        -force_on_marker_n.sum(axis=0), -np.cross(position_m, force_on_marker_n).sum(axis=0)
    )
