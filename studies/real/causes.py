# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which single cause explains a force that grows otherwise than the makers' model, and which press
would tell the causes apart.

The makers' model has a bonded and rigid base, a ball that sticks, nu of 0.49, neo-Hooke's law and a
right zero. Each cause changes one of that; Young's modulus is free in all. A cause explains the
press if its misfit, at its best size within what is plausible, is not one of the 5 % largest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.stats import chi2

from dotsim_ros.data.importers.force_depth import ForceDepth
from dotsim_ros.data.importers.gelsight_mini_force import BALL_RADIUS_M
from dotsim_ros.geometry.indenter import Indenter, flat_punch, sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from studies.real.inference import MODEL_ERROR, residuals
from studies.real.pad import (
    PAD_SIZE_M,
    PadSolves,
    PadState,
    PadTable,
    poses_at,
)

MAKERS = PadState()
SIZE_COUNT = 201
REFUSED = 0.05


@dataclass(frozen=True)
class Cause:
    """One thing that may be otherwise than in the makers' model.

    Attributes:
        name: of it.
        field: of `PadState`.
        plausible: smallest and largest size.
        unit: and `scale`, of the size as it is shown.
        scale: from the field's unit.
    """

    name: str
    field: str
    plausible: tuple[float, float]
    unit: str = ""
    scale: float = 1.0

    def states(self) -> PadState:
        """Return the makers' pad with the cause at each of its plausible sizes."""
        return replace(MAKERS, **{self.field: np.linspace(*self.plausible, SIZE_COUNT)})


CAUSES = (
    Cause("slip of the ball", "friction", (0.0, 1.0)),
    Cause("a support that gives way", "support_m_n", (0.0, 20.0e-6), "um/N", 1e6),
    Cause("compressibility", "compressibility", (float(np.log(0.004)), float(np.log(0.08)))),
    Cause("the zero of depth", "zero_m", (-0.1e-3, 0.1e-3), "mm", 1e3),
    Cause("stiffening or softening of the gel", "stiffening", (-0.06, 0.06), "C20/C10"),
)


@dataclass(frozen=True)
class Explained:
    """How well causes explain a press.

    Attributes:
        causes: one, two, or none.
        state: the best.
        log_scale: of Young's modulus over the table's.
        misfit: sum of squares over the model's own error.
        worst: largest deviation of a force, as a share.
        holds: whether the misfit is none of the 5 % largest, by the depths that are left over; with
            none left over, whether it is nearly none.
    """

    causes: tuple[Cause, ...]
    state: PadState
    log_scale: float
    misfit: float
    worst: float
    holds: bool

    @property
    def name(self) -> str:
        """Names of the causes."""
        return " and ".join(cause.name for cause in self.causes) or "the makers' model"

    def size_text(self) -> str:
        """Return the sizes with their units."""
        parts = []
        for cause in self.causes:
            value = float(getattr(self.state, cause.field))
            if cause.field == "compressibility":
                parts.append(f"nu {0.5 - np.exp(value):.3f}")
            else:
                parts.append(f"{value * cause.scale:.3g} {cause.unit}".strip())
        return ", ".join(parts)


def explained(table: PadTable, press: ForceDepth, causes: Sequence[Cause]) -> Explained:
    """Return the best sizes of causes together, each within what is plausible.

    Args:
        table: of the pad.
        press: what was measured.
        causes: none, one or two.
    """
    axes = [
        np.linspace(*cause.plausible, SIZE_COUNT if len(causes) < 2 else 81) for cause in causes
    ]
    grid = np.meshgrid(*axes, indexing="ij") if axes else []
    fields = {cause.field: values.ravel() for cause, values in zip(causes, grid, strict=True)}
    state = replace(MAKERS, **fields)
    difference = residuals(table, state, press).reshape(-1, len(press.depth_m))
    middle = difference.mean(axis=1)
    left = difference - middle[:, None]
    misfit = np.sum(left**2, axis=1) / MODEL_ERROR**2
    best = int(misfit.argmin())
    spare = len(press.depth_m) - 1 - len(causes)
    limit = float(chi2.ppf(1.0 - REFUSED, max(spare, 1)))
    return Explained(
        tuple(causes),
        replace(MAKERS, **{name: float(values[best]) for name, values in fields.items()}),
        float(middle[best]),
        float(misfit[best]),
        float(np.abs(np.expm1(left[best])).max()),
        bool(misfit[best] <= limit),
    )


def all_explained(table: PadTable, press: ForceDepth) -> list[Explained]:
    """Return the makers' model, each cause alone, then pairs, the best first in each group."""
    found = [explained(table, press, ())]
    for count in (1, 2):
        group = [explained(table, press, chosen) for chosen in combinations(CAUSES, count)]
        found += sorted(group, key=lambda one: one.misfit)
    return found


@dataclass(frozen=True)
class Proposal:
    """A press that may tell causes apart.

    Attributes:
        name: what to do.
        indenter: what presses.
        poses: of it; the last is judged.
        measure: of the last force (3,): what is compared.
        relative: whether the measure scales with Young's modulus and so with the force.
    """

    name: str
    indenter: Indenter
    poses: list[Pose]
    measure: Callable[[FloatArray], float]
    relative: bool = True


def _normal(force_n: FloatArray) -> float:
    return float(force_n[2])


def _share_across(force_n: FloatArray) -> float:
    return float(np.hypot(force_n[0], force_n[1]) / force_n[2])


def proposals() -> tuple[Proposal, ...]:
    """Return presses to choose from."""
    ball = sphere(BALL_RADIUS_M)
    down = poses_at(1e-3 * np.array([0.5, 1.0]))
    across = [Pose(np.array([x, 0.0, PAD_SIZE_M[2] - 1e-3])) for x in (0.25e-3, 0.5e-3, 0.75e-3)]
    return (
        Proposal("the same ball to 1.5 mm", ball, poses_at(1e-3 * np.array([0.75, 1.5])), _normal),
        Proposal("a ball of 3 mm radius to 1 mm", sphere(3e-3), down, _normal),
        Proposal(
            "a flat punch of 5 mm radius to 0.6 mm",
            flat_punch(5e-3, 5e-3, 0.5e-3),
            poses_at(1e-3 * np.array([0.3, 0.6])),
            _normal,
        ),
        Proposal(
            "a slide: the same ball 1 mm deep, then 0.75 mm across",
            ball,
            [*down, *across],
            _share_across,
            relative=False,
        ),
    )


def answer_to(solves: PadSolves, proposal: Proposal, explanation: Explained) -> float:
    """Return what a press would show if an explanation were right.

    A support that gives way and a zero that is off move the ball; how far is found by a few solves.

    Raises:
        SolveError, ValueError: as `PadSolves.force_n`.
    """
    state = explanation.state
    scale = float(np.exp(explanation.log_scale))
    given = 0.0
    force = np.zeros(3)
    rounds = 4 if float(state.support_m_n) > 0.0 else 1
    for _ in range(rounds):
        sunk = float(state.zero_m) - given
        poses = [
            Pose(pose.position_m - np.array([0.0, 0.0, sunk]), pose.quaternion_xyzw)
            for pose in proposal.poses
        ]
        inside = replace(state, zero_m=0.0, support_m_n=0.0)
        force = scale * solves.force_n(inside, proposal.indenter, poses)[-1]
        given = float(state.support_m_n) * float(force[2])
    return proposal.measure(force)


def separations(answers: Sequence[float], *, relative: bool) -> tuple[float, float]:
    """Return by how many deviations the nearest and the farthest two answers differ."""
    values = np.sort(np.log(answers) if relative else np.asarray(answers))
    apart = values / (np.sqrt(2.0) * MODEL_ERROR)
    return float(np.diff(apart).min()), float(np.ptp(apart))
