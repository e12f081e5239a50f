# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a twin may be wrong about without any effect being missing: the nuisances, their priors, and
what each of them does to a trajectory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dotsim_ros.calibration.parameters import PARAMETERS, with_coordinates
from dotsim_ros.data.recording import Recording
from dotsim_ros.effects.effect import Active, Effect
from dotsim_ros.effects.simulate import EffectRequest
from dotsim_ros.gap.presses.observables import PATCH_COUNT
from dotsim_ros.gel.values import GelValues
from dotsim_ros.io.arrays import FloatArray

SHIFT_STEP_M = 0.1e-3
SHIFTS_M = ((SHIFT_STEP_M, 0.0, 0.0), (0.0, SHIFT_STEP_M, 0.0), (0.0, 0.0, SHIFT_STEP_M))
STEPS = {"nu": 0.2, "friction": 0.2, "c20": 0.08}
"""Steps of the finite differences, in the parameters' coordinates: of the size of the priors."""
TOLERANCES = {
    "thickness": ("thickness_error", {"thickness_share": -0.0225}),
    "delay": ("latency", {"latency_s": 0.01}),
    "arm": ("base_compliance", {"compliance_m_n": 2.0e-5}),
    "relaxation": ("viscoelastic_relaxation", {"share": 0.05, "time_s": 10.0}),
}
"""Effects that are there to a small degree in any unit and setup, or that the model's own error
looks like: the effect of each, and the step of the difference, in its first parameter."""
GEL_CONSTANTS = ("E", *STEPS)
"""Nuisances in the coordinates of the parameters of these names; "thickness" is a share of the
gel's, not the length that the parameter of this name is."""
BIASED = ("friction", *TOLERANCES)
"""Nuisances whose means are estimated from presses in which no effect is missing."""
SHARED, OWN, SINCE = "shared", "own", "since"


@dataclass(frozen=True)
class PressNuisance:
    """One thing that a twin may be wrong about.

    Attributes:
        name, unit: for reports.
        deviation: of its prior, in the coordinate of its parameter (the logarithm of a stiffness or
            of friction; the first parameter of its effect, for `TOLERANCES`), metres, or seconds.
        belongs: `SHARED` by all data of a unit, each data set's `OWN`, or what has changed `SINCE`
            the commissioning.
        mean: of its prior, in the unit of the deviation.
    """

    name: str
    unit: str
    deviation: float
    belongs: str
    mean: float = 0.0

    @property
    def centre(self) -> float:
        """The mean in deviations."""
        return self.mean / self.deviation


def _constant(name: str, deviation: float) -> PressNuisance:
    parameter = PARAMETERS[name]
    return PressNuisance(name, parameter.coordinate or parameter.unit, deviation, SHARED)


_OWN_ERRORS = (
    PressNuisance("shift_x", "m", 0.03e-3, OWN),
    PressNuisance("shift_y", "m", 0.03e-3, OWN),
    PressNuisance("shift_z", "m", 0.03e-3, OWN),
    PressNuisance("clock", "s", 0.003, OWN),
)

ABSOLUTE = (
    _constant("E", 0.08),
    _constant("nu", 0.2),
    _constant("friction", 0.2),
    _constant("c20", 0.05),
    PressNuisance("thickness", "share", 0.01, SHARED),
    PressNuisance("delay", "s", 0.005, SHARED),
    PressNuisance("arm", "m/N", 8.0e-6, SHARED),
    PressNuisance("relaxation", "share", 0.03, SHARED),
    *_OWN_ERRORS,
)
"""Against a calibrated sensor's file: units differ by some percent, the arm by some hundredths of a
millimetre. The means of `BIASED` come with the discrepancy; the deviations of `TOLERANCES` are what
halves of the stand-in sensor's presses, and a second unit's, differ by."""

DIFFERENTIAL = (
    _constant("E", 0.3),
    _constant("nu", 0.8),
    _constant("friction", 0.5),
    _constant("c20", 0.2),
    PressNuisance("thickness", "share", 0.03, SHARED),
    PressNuisance("delay", "s", 0.015, SHARED),
    PressNuisance("arm", "m/N", 2.0e-5, SHARED),
    PressNuisance("relaxation", "share", 0.1, SHARED),
    *_OWN_ERRORS,
    PressNuisance("E_since", "log", 0.02, SINCE),
)
"""Against the unit's own commissioning, which gives its constants; since then, its stiffness may
have changed by what a laboratory's temperature does."""


def nuisance_requests(
    recording: Recording, values: GelValues, library: Mapping[str, Effect]
) -> list[EffectRequest]:
    """Return what must be simulated for the columns of a trajectory, the twin as it is first."""
    result = [EffectRequest(recording, values)]
    for name, step in STEPS.items():
        parameter = PARAMETERS[name]
        at = parameter.to_coordinate(getattr(values, parameter.field))
        moved = with_coordinates(values, [parameter], np.array([at + step]))
        result.append(EffectRequest(recording, moved))
    result += [EffectRequest(recording, values, shift_m=shift_m) for shift_m in SHIFTS_M]
    for name, parameters in TOLERANCES.values():
        active = Active(library[name], library[name].checked(parameters))
        result.append(EffectRequest(recording, values, effects=[active]))
    return result


_STEPS_OF_REQUESTS = {
    **STEPS,
    **dict.fromkeys(("shift_x", "shift_y", "shift_z"), SHIFT_STEP_M),
    **{name: next(iter(parameters.values())) for name, (_, parameters) in TOLERANCES.items()},
}
"""The step of each request of `nuisance_requests` after the first, by nuisance."""


def nuisance_columns(
    nuisances: Sequence[PressNuisance], observed: Sequence[FloatArray], *, is_reference: bool
) -> list[FloatArray]:
    """Return what one deviation of each nuisance does to the observables (F, SIZE), from those of
    `nuisance_requests`."""
    base, *others = observed
    slopes = {
        name: (moved - base) / step
        for (name, step), moved in zip(_STEPS_OF_REQUESTS.items(), others, strict=True)
    }
    force_alone = base.copy()
    skin = slice(3 * PATCH_COUNT)
    force_alone[:, skin] = np.where(np.isfinite(base[:, skin]), 0.0, np.nan)
    slopes["E"] = slopes["E_since"] = force_alone
    # What is late in one data set alone does the same as what is late in all.
    slopes["clock"] = slopes["delay"]
    result = []
    for nuisance in nuisances:
        column = nuisance.deviation * slopes[nuisance.name]
        if nuisance.belongs == SINCE and is_reference:
            column = np.zeros_like(column)
        result.append(column)
    return result


def centred(
    nuisances: Sequence[PressNuisance], bias: Mapping[str, float]
) -> tuple[PressNuisance, ...]:
    """Return nuisances about the means of a bias, by name."""
    return tuple(replace(n, mean=bias.get(n.name, n.mean)) for n in nuisances)
