# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which of the twin's constants make up for what its file is off by, where no effect is missing.

That no effect is needed does not mean that simulation and measurement agree: the constants were
fitted first. Where the file's own are off by more than the floor, it is asked which constant, with
the stiffness free next to it, would do as well as all together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dotsim_ros.calibration.parameters import PARAMETERS
from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import ChannelGap
from dotsim_ros.gap.presses.assumptions import GEL_CONSTANTS, TOLERANCES, PressNuisance
from dotsim_ros.gap.presses.evidence import Case
from dotsim_ros.gap.presses.inference import Evidence, fit_nuisances
from dotsim_ros.gap.presses.search_state import Search
from dotsim_ros.gap.report import wording
from dotsim_ros.gap.report.wording import MadeUp
from dotsim_ros.gel.values import GelValues

STIFFNESS = "E"
SHOWN_BY = {
    **{name: effect for name, (effect, _) in TOLERANCES.items()},
    "nu": "compressibility",
    "friction": "coulomb_slip",
    "c20": "hyperelastic_stiffening",
    "shift_x": "pose_offset_x",
    "shift_y": "pose_offset_y",
    "shift_z": "pose_offset",
    "clock": "latency",
}
"""The effect whose protocol shows a constant."""


@dataclass(frozen=True)
class _Column:
    """A nuisance of the evidence: its place, its name, and itself."""

    place: int
    name: str
    nuisance: PressNuisance


def made_up(search: Search, gaps: Sequence[ChannelGap]) -> MadeUp | None:
    """Return which constants make up for what the file is off by; None where it is off by no more
    than the floor, or the constants were fitted to a commissioning.
    """
    off = [gap for gap in gaps if gap.before > decision.FAR * gap.floor]
    if not off or any(t.is_reference for t in search.case.trajectories):
        return None
    evidence, case = search.evidence, search.case
    columns = [
        _Column(place, name, nuisance)
        for place, ((nuisance, whose), name) in enumerate(
            zip(case.columns(), case.column_names(), strict=True)
        )
        if not whose
    ]
    centre = np.array([nuisance.centre for nuisance, _ in case.columns()])
    as_filed = evidence.residual + evidence.nuisance @ centre
    stiffness = next(column for column in columns if column.name == STIFFNESS)
    alone = []
    for column in columns:
        kept = sorted({stiffness.place, column.place})
        part = evidence.nuisance[:, kept]
        found = fit_nuisances(Evidence(as_filed - part @ centre[kept], part, evidence.trajectory))
        behind = found.objective - search.base.objective
        moved = dict(zip(kept, (found.nuisance + centre[kept]).tolist(), strict=True))
        alone.append((behind, column, moved))
    alone.sort(key=lambda one: one[0])
    enough = [one for one in alone if one[0] < decision.SAME]
    if any(column is stiffness for _, column, _ in enough):
        # With it, any other seems to be enough.
        enough = [one for one in enough if one[1] is stiffness]
    return MadeUp(
        tuple(off),
        tuple(_text(case, column, stiffness, moved) for _, column, moved in enough),
        tuple(
            f"{column.name}: {case.library[SHOWN_BY[column.name]].protocol}"
            for _, column, _ in enough or alone[:2]
            if column.name in SHOWN_BY
        ),
    )


def _text(case: Case, column: _Column, stiffness: _Column, moved: dict[int, float]) -> str:
    """Return a constant as it was fitted, next to the stiffness."""
    shown = dict.fromkeys((column, stiffness))
    text = " with ".join(_value(case.values, one, moved[one.place]) for one in shown)
    effect = SHOWN_BY.get(column.name)
    return text if effect is None else f"{text} ({wording.amid(case.library[effect].title)})"


def _value(values: GelValues, column: _Column, deviations: float) -> str:
    """Return a constant so many deviations off the file's, in words."""
    nuisance = column.nuisance
    off = deviations * nuisance.deviation
    if column.name not in GEL_CONSTANTS:
        return f"{column.name} = {off:.2g} {nuisance.unit}"
    parameter = PARAMETERS[column.name]
    at = parameter.to_coordinate(getattr(values, parameter.field))
    unit = f" {parameter.unit}" if parameter.unit else ""
    return f"{column.name} = {parameter.to_value(at + off):.3g}{unit}"
