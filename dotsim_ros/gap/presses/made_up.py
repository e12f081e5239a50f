# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which of the twin's constants make up for what its file is off by, where no effect is missing.

That no effect is needed does not mean that simulation and measurement agree: the constants were
fitted first. Where the file's own are off by more than the floor, it is asked which constant, with
the stiffness free next to it, would do as well as all together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dotsim_ros.calibration.parameters import PARAMETERS
from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import ChannelGap
from dotsim_ros.gap.presses.assumptions import GEL_CONSTANTS, TOLERANCES, PressNuisance
from dotsim_ros.gap.presses.inference import Evidence, fit_nuisances
from dotsim_ros.gap.presses.search_state import Search
from dotsim_ros.gap.report import wording
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


def no_gap_sentence(search: Search, gaps: Sequence[ChannelGap]) -> str:
    """Return that no effect is missing, and which constants make up for what the file is off by;
    the latter only beyond the floor, and where the constants were not fitted to a commissioning.
    """
    case, evidence = search.case, search.evidence
    off = [gap for gap in gaps if gap.before > decision.FAR * gap.floor]
    if not off or any(t.is_reference for t in case.trajectories):
        return wording.NO_GAP
    columns = case.columns()
    centre = np.array([column.nuisance.centre for column in columns])
    as_filed = evidence.residual + evidence.nuisance @ centre
    names = {k: column.name for k, column in enumerate(columns) if not column.of_reference}
    stiffness = next(k for k, name in names.items() if name == STIFFNESS)
    alone = []
    for k in names:
        kept = sorted({stiffness, k})
        part = evidence.nuisance[:, kept]
        found = fit_nuisances(Evidence(as_filed - part @ centre[kept], part, evidence.trajectory))
        moved = dict(zip(kept, (found.nuisance + centre[kept]).tolist(), strict=True))
        alone.append((found.objective - search.base.objective, k, moved))
    alone.sort(key=lambda one: one[0])
    enough = [one for one in alone if one[0] < decision.SAME]
    # With the stiffness, any other seems to be enough.
    enough = [one for one in enough if one[1] == stiffness] or enough
    constants = []
    for _, k, moved in enough:
        texts = [
            _value(case.values, columns[c].nuisance, moved[c])
            for c in dict.fromkeys((k, stiffness))
        ]
        effect = SHOWN_BY.get(names[k])
        shown = "" if effect is None else f" ({wording.amid(case.library[effect].title)})"
        constants.append(" with ".join(texts) + shown)
    nearest = [names[k] for _, k, _ in enough or alone[:2]]
    protocols = [
        f"{name}: {case.library[SHOWN_BY[name]].protocol}" for name in nearest if name in SHOWN_BY
    ]
    return wording.made_up(off, constants, protocols)


def _value(values: GelValues, nuisance: PressNuisance, deviations: float) -> str:
    """Return a constant so many deviations off the file's, in words."""
    off = deviations * nuisance.deviation
    if nuisance.name not in GEL_CONSTANTS:
        return f"{nuisance.name} = {off:.2g} {nuisance.unit}"
    parameter = PARAMETERS[nuisance.name]
    at = parameter.to_coordinate(getattr(values, parameter.field))
    return f"{nuisance.name} = {parameter.to_value(at + off):.3g} {parameter.unit}".rstrip()
