"""Frictional contact of the skin's markers with a rigid indenter.

Pressure grows with the penetration of a marker, C2 near zero; friction is Coulomb's law with a
tangential spring while sticking and return to the limit while slipping (Wriggers, "Computational
Contact Mechanics", 2006, chapters 5 and 9). Its limit and its plane use pressure and normal of the
previous iteration, so that every iteration has an energy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from dotsim_ros.gel.contact_kernels import contact_kernels
from dotsim_ros.gel.distance_field import indenter_field
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose, Wrench
from dotsim_ros.geometry.specification import ContactSpecification

Array = NDArray[np.float64]
IntArray = NDArray[np.int32]

REFERENCE_SPACING_M = 1.2e-3
ONSET_M = 10.0e-6
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
        hessian: (C, 3, 3) positive semi-definite part of the stiffness, N/m.
        local_position_m, slip_m: (C, 3) in the indenter's frame, the history if the step ends.
        normal: (C, 3) gradient of the distance, base frame.
    """

    distance_m: Array
    pressure_pa: Array
    force_n: Array
    energy_j: float
    hessian: Array
    local_position_m: Array
    slip_m: Array
    normal: Array


@dataclass(frozen=True)
class Lag:
    """What an iteration's friction takes from the one before: pressure (C,) and normal (C, 3) of
    the candidates, a zero normal for none."""

    pressure_pa: Array
    normal: Array


@dataclass
class ContactHistory:
    """Memory of friction: position and elastic slip (V, 3) of the markers in the indenter's frame
    at the end of the last step, and the pressure then (V,)."""

    local_position_m: Array
    slip_m: Array
    pressure_pa: Array


def fresh_history(rest_position_m: Array, pose: Pose) -> ContactHistory:
    """Return the history of a skin that has touched nothing."""
    local = (rest_position_m - pose.position_m) @ pose.rotation()
    return ContactHistory(local, np.zeros_like(local), np.zeros(len(local)))


class Contact:
    """The contact law with one indenter, for a skin of V markers.

    Args:
        indenter: the rigid shape.
        area_m2: (V,) rest area of the markers.
        youngs_modulus_pa: E, to which the stiffnesses are scaled.
        specification: friction and stiffness.
    """

    def __init__(
        self,
        indenter: Indenter,
        area_m2: Array,
        youngs_modulus_pa: float,
        specification: ContactSpecification,
        *,
        device: str = "cpu",
    ) -> None:
        self.indenter = indenter
        self.device = device
        self.kernels = contact_kernels(wp.float64)
        self.field: Any = indenter_field(indenter, scalar=wp.float64, device=device)
        self._area_m2 = area_m2
        self.area: Any = wp.array(area_m2, dtype=wp.float64, device=device)
        law = self.kernels.ContactLaw()
        law.stiffness = specification.stiffness * youngs_modulus_pa / REFERENCE_SPACING_M
        law.tangential_stiffness = specification.tangential_ratio * law.stiffness
        law.friction = specification.friction_coefficient
        law.onset = ONSET_M
        law.smoothing = SMOOTHING_M
        self.law = law

    def marker_stiffness(self, marker: IntArray) -> Array:
        """Return (A, 3, 3) stiffness of markers that are stuck to the indenter, N/m."""
        return self.normal_stiffness(marker)[:, None, None] * np.eye(3)

    def normal_stiffness(self, marker: IntArray) -> Array:
        """Return (A,) stiffness of markers in full contact along the normal, N/m."""
        return np.asarray(self.law.stiffness * self._area_m2[marker])

    def respond(
        self,
        candidate: IntArray,
        position_m: Array,
        pose: Pose,
        history: ContactHistory,
        lag: Lag,
    ) -> ContactResponse:
        """Return the response of candidate markers (C,) at positions (C, 3) to the indenter."""
        k, device, count = self.kernels, self.device, len(candidate)

        def vectors(values: Array) -> wp.array:
            return wp.array(values, dtype=k.vec3, device=device, copy=False)

        def empty(dtype: Any) -> wp.array:
            return wp.empty(count, dtype=dtype, device=device)

        outputs = [empty(wp.float64), empty(wp.float64), empty(k.vec3), empty(wp.float64)]
        outputs += [empty(k.mat33), empty(k.vec3), empty(k.vec3), empty(k.vec3)]
        wp.launch(
            k.contact_response,
            dim=count,
            inputs=[
                wp.array(candidate, dtype=wp.int32, device=device, copy=False),
                vectors(np.ascontiguousarray(position_m)),
                self.area,
                self.field,
                k.mat33(*pose.rotation().ravel().tolist()),
                k.vec3(*pose.position_m.tolist()),
                self.law,
                wp.array(lag.pressure_pa, dtype=wp.float64, device=device, copy=False),
                vectors(lag.normal),
                vectors(history.local_position_m),
                vectors(history.slip_m),
            ],
            outputs=outputs,
            device=device,
        )
        distance, pressure, force, energy, *others = (o.numpy() for o in outputs)
        return ContactResponse(distance, pressure, force, float(energy.sum()), *others)


def wrench_on_indenter(position_m: Array, force_on_marker_n: Array) -> Wrench:
    """Return the force of the gel on the indenter and its torque about the base frame's origin."""
    return Wrench(
        -force_on_marker_n.sum(axis=0), -np.cross(position_m, force_on_marker_n).sum(axis=0)
    )
