"""What a twin may be wrong about without any effect being missing: the nuisances, their priors, and
what each of them does to a trajectory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.calibration.parameters import PARAMETERS, GelValues, with_coordinates
from dotsim_ros.gap.effect import Active, Effect
from dotsim_ros.gap.observables import PATCH_COUNT
from dotsim_ros.gap.recording import Recording
from dotsim_ros.gap.simulate import Request, request_of

Array = NDArray[np.float64]

CLOCK_STEP_S = 0.01
SHIFT_STEP_M = 0.1e-3
STEPS = {"nu": 0.2, "friction": 0.2, "c20": 0.08}
"""Of the differences, in the parameters' coordinates: of the size of the priors."""
SHARED, OWN, SINCE = "shared", "own", "since"


@dataclass(frozen=True)
class Nuisance:
    """One thing that a twin may be wrong about.

    Attributes:
        name, unit: for reports.
        deviation: of its prior, in the coordinate of its parameter (the logarithm of a stiffness or
            of friction), metres, or seconds.
        belongs: `SHARED` by all data of a unit, each data set's `OWN`, or what has changed `SINCE`
            the commissioning.
    """

    name: str
    unit: str
    deviation: float
    belongs: str


ABSOLUTE = (
    Nuisance("E", "log", 0.08, SHARED),
    Nuisance("nu", "log(1/2 - nu)", 0.2, SHARED),
    Nuisance("friction", "log", 0.2, SHARED),
    Nuisance("c20", "of C10", 0.05, SHARED),
    Nuisance("shift_x", "m", 0.03e-3, OWN),
    Nuisance("shift_y", "m", 0.03e-3, OWN),
    Nuisance("shift_z", "m", 0.03e-3, OWN),
    Nuisance("clock", "s", 0.003, OWN),
)
"""Against a calibrated sensor's file: units differ by some percent, the arm by some hundredths of a
millimetre."""

DIFFERENTIAL = (
    Nuisance("E", "log", 0.3, SHARED),
    Nuisance("nu", "log(1/2 - nu)", 0.8, SHARED),
    Nuisance("friction", "log", 0.5, SHARED),
    Nuisance("c20", "of C10", 0.2, SHARED),
    *ABSOLUTE[4:],
    Nuisance("E_since", "log", 0.02, SINCE),
)
"""Against the unit's own commissioning, which tells its constants; since then, its stiffness may
have changed by what a laboratory's temperature does."""


def nuisance_requests(
    recording: Recording, values: GelValues, library: Mapping[str, Effect]
) -> list[Request]:
    """Return what must be simulated for the columns of a trajectory, the twin as it is first."""
    result = [request_of(recording, values)]
    for name, step in STEPS.items():
        parameter = PARAMETERS[name]
        at = parameter.to_coordinate(getattr(values, parameter.field))
        moved = with_coordinates(values, [parameter], np.array([at + step]))
        result.append(request_of(recording, moved))
    result += [
        request_of(recording, values, shift_m=axis.tolist()) for axis in SHIFT_STEP_M * np.eye(3)
    ]
    late = library["latency"]
    result.append(
        request_of(
            recording, values, effects=[Active(late, late.checked({"latency_s": CLOCK_STEP_S}))]
        )
    )
    return result


def nuisance_columns(
    nuisances: Sequence[Nuisance], observed: Sequence[Array], *, is_reference: bool
) -> list[Array]:
    """Return what each nuisance does to the observables (F, SIZE) when it moves by one deviation.

    Args:
        nuisances: q of them.
        observed: observables of `nuisance_requests`, in their order.
        is_reference: whether the trajectory is of the commissioning.
    """
    base = observed[0]
    force_alone = base.copy()
    force_alone[:, : 3 * PATCH_COUNT] = np.where(
        np.isfinite(base[:, : 3 * PATCH_COUNT]), 0.0, np.nan
    )
    slopes = {
        "E": force_alone,
        "E_since": force_alone,
        "clock": (observed[7] - base) / CLOCK_STEP_S,
    }
    for place, (name, step) in enumerate(STEPS.items()):
        slopes[name] = (observed[1 + place] - base) / step
    for axis, name in enumerate(("shift_x", "shift_y", "shift_z")):
        slopes[name] = (observed[4 + axis] - base) / SHIFT_STEP_M
    result = []
    for nuisance in nuisances:
        column = nuisance.deviation * slopes[nuisance.name]
        if nuisance.belongs == SINCE and is_reference:
            column = np.zeros_like(column)
        result.append(column)
    return result


def values_after(values: GelValues, nuisances: Sequence[Nuisance], moved: Array) -> GelValues:
    """Return the gel with its nuisances moved by (q,) deviations."""
    for nuisance, deviations in zip(nuisances, moved.tolist(), strict=True):
        if nuisance.name not in PARAMETERS:
            continue
        parameter = PARAMETERS[nuisance.name]
        at = parameter.to_coordinate(getattr(values, parameter.field))
        place = np.array([at + deviations * nuisance.deviation])
        values = with_coordinates(values, [parameter], place)
    return values
