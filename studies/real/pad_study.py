# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The press of a GelSight Mini: each depth predicted from the others, and what cannot be told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.data.importers.force_depth import ForceDepth
from dotsim_ros.data.importers.gelsight_mini_force import (
    PAD_SIZE_M,
    ball,
    read_gelsight_mini_force,
)
from dotsim_ros.gel.material import NeoHookean
from dotsim_ros.io.files import cache_directory
from dotsim_ros.specification import ContactSpecification
from dotsim_ros.twin.simulator import REFERENCE_MODULUS_PA
from studies.data import REAL
from studies.real.causes import (
    MAKERS,
    Explained,
    all_explained,
    answer_to,
    proposals,
    separations,
)
from studies.real.inference import (
    DRAW_COUNT,
    MODEL_ERROR,
    Predicted,
    Prior,
    Weighted,
    each_left_out,
    predicted,
    weighted_draws,
)
from studies.real.pad import (
    DEPTH_M,
    PadSolves,
    PadState,
    PadTable,
    pad_table,
    poses_at,
)
from studies.reference.axisymmetric import AxisymmetricDeck, AxisymmetricSettings, disc_section
from studies.reference.blocks import StepControl
from studies.reference.run import CalculixError, CalculixMissingError, solve_section

CHECKED_FRICTION = 0.2
CHECKED_DEPTH_M = 1e-3 * np.array([0.5, 1.0, 1.5, 2.0])
CHECKED_SPACING_M = (0.5e-3, 0.35e-3)
"""Of CalculiX's elements in the contact."""
COMPARED = 4
"""Explanations that proposed presses are to tell apart: the best ones."""


def real_force(
    *,
    data: Path = REAL / "gelsight_mini_force",
    at_mm: tuple[float, ...] = (1.5,),
    seed: int = 0,
    cache: Path | None = None,
) -> dict[str, Any]:
    """Forces of a real ball on a pad, each predicted from the other depths.

    Args:
        data: folder of the set, as published.
        at_mm: further depths to predict, from all that were measured.
        seed: of the draws.
        cache: folder of the gel's solves (the user's cache).

    Raises:
        FileNotFoundError, ValueError: as `read_gelsight_mini_force`; fewer than three depths.
        SolveError: the gel cannot be solved.
    """
    press = read_gelsight_mini_force(data)
    if len(press.depth_m) < 3:
        raise ValueError(
            f"{data}: {len(press.depth_m)} depths, expected three at least: two to fit on and "
            "one to judge on"
        )
    lowest, highest = (1e3 * depth for depth in DEPTH_M[[0, -1]].tolist())
    if not all(lowest <= depth <= highest for depth in at_mm):
        raise ValueError(
            f"depths to predict are {list(at_mm)} mm, expected {lowest:g} to {highest:g} mm, where "
            "the pad is solved"
        )
    solves = PadSolves(cache or cache_directory() / "real_force")
    finite_elements = _against_finite_elements(solves)
    table = pad_table(solves, ball())
    prior = Prior()
    draws = weighted_draws(table, press, prior=prior, seed=seed)
    explanations = all_explained(table, press)
    holding = [one for one in explanations if one.holds]
    single = [one for one in holding if len(one.causes) < 2]
    compared = (single + [one for one in holding if one not in single])[:COMPARED]
    return {
        "left_out": [
            _prediction(found, measured)
            for found, measured in zip(
                each_left_out(table, press, prior, seed), press.force_n.tolist(), strict=True
            )
        ],
        "further": [
            _prediction(predicted(table, draws, 1e-3 * depth, seed=seed), None) for depth in at_mm
        ],
        "posterior": _posterior(draws),
        "makers": _makers(table, press),
        "explanations": [
            {
                "causes": one.name,
                "size": one.size_text(),
                "modulus_pa": REFERENCE_MODULUS_PA * float(np.exp(one.log_scale)),
                "misfit": one.misfit,
                "worst": one.worst,
                "holds": one.holds,
                "count": len(one.causes),
            }
            for one in explanations
        ],
        "proposals": _proposals(solves, compared),
        "finite_elements": finite_elements,
        "draws": DRAW_COUNT,
        "model_error": MODEL_ERROR,
    }


def _prediction(found: Predicted, measured_n: float | None) -> dict[str, Any]:
    return {
        "depth_mm": 1e3 * found.depth_m,
        "fitted_mm": [1e3 * depth for depth in found.fitted_m],
        "measured_n": measured_n,
        "predicted_n": found.force_n,
        "low_n": found.interval_n[0],
        "high_n": found.interval_n[1],
        "effective_draws": found.effective_draws,
    }


def _posterior(draws: Weighted) -> dict[str, list[float]]:
    state = draws.state
    values = {
        "Young's modulus, MPa": 1e-6 * REFERENCE_MODULUS_PA * np.exp(draws.log_scale),
        "nu": state.poisson_ratio,
        "friction": np.asarray(state.friction),
        "support, um/N": 1e6 * np.asarray(state.support_m_n),
        "zero of depth, mm": 1e3 * np.asarray(state.zero_m),
        "C20/C10": np.asarray(state.stiffening),
    }
    return {name: draws.quantiles(v, (0.025, 0.5, 0.975)).tolist() for name, v in values.items()}


def _against_finite_elements(solves: PadSolves) -> dict[str, Any]:
    """Return the gel's and CalculiX's forces of one press, on two meshes of a round pad as large.

    CalculiX's may be missing where it fails; all are where it is not installed.
    """
    state = PadState(friction=CHECKED_FRICTION)
    own = solves.force_n(state, ball(), poses_at(CHECKED_DEPTH_M))[1:, 2]
    rows = []
    for spacing in CHECKED_SPACING_M:
        print(f"pad: CalculiX, elements of {1e3 * spacing:g} mm")
        settings = AxisymmetricSettings(
            spacing, 6.5e-3, 0.6 * spacing, StepControl(first=0.1, largest=0.1)
        )
        radius = float(np.sqrt(PAD_SIZE_M[0] * PAD_SIZE_M[1] / np.pi))
        deck = AxisymmetricDeck(
            section=disc_section(radius, PAD_SIZE_M[2], settings),
            indenter=ball(),
            apex_m=PAD_SIZE_M[2],
            depth_m=[-0.05e-3, *CHECKED_DEPTH_M.tolist()],
            law=NeoHookean(REFERENCE_MODULUS_PA, float(state.poisson_ratio)),
            contact=ContactSpecification(friction_coefficient=CHECKED_FRICTION),
            settings=settings,
        )
        try:
            steps = solve_section(deck, time_limit_s=600.0).steps
        except (CalculixMissingError, CalculixError) as error:
            print(f"pad: {error}")
            steps = ()
        rows.append(
            {"spacing_mm": 1e3 * spacing, "force_n": [float(step.force_n[2]) for step in steps]}
        )
    return {
        "depth_mm": (1e3 * CHECKED_DEPTH_M).tolist(),
        "friction": CHECKED_FRICTION,
        "own_n": own.tolist(),
        "calculix": rows,
    }


def _makers(table: PadTable, press: ForceDepth) -> dict[str, Any]:
    """Return the makers' model as they fitted it: C10 of 0.0725 MPa, nu of 0.49, stuck, bonded."""
    modulus_pa = 4.0 * 0.0725e6 * (1.0 + 0.49)
    scale = np.full(1, np.log(modulus_pa / REFERENCE_MODULUS_PA))
    force = [float(table.force_n(MAKERS, scale, depth)[0]) for depth in press.depth_m.tolist()]
    return {"force_n": force, "ratio": (np.array(force) / press.force_n).tolist()}


def _proposals(solves: PadSolves, compared: list[Explained]) -> list[dict[str, Any]]:
    rows = []
    for proposal in proposals() if len(compared) > 1 else ():
        print(f"pad: {proposal.name}")
        answers = [answer_to(solves, proposal, one) for one in compared]
        nearest, farthest = separations(answers, relative=proposal.relative)
        rows.append(
            {
                "press": proposal.name,
                "answers": {
                    one.name: answer for one, answer in zip(compared, answers, strict=True)
                },
                "nearest": nearest,
                "farthest": farthest,
            }
        )
    return sorted(rows, key=lambda row: -float(row["nearest"]))
