# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What two depths of a press say about a third: prediction with everything that is not known.

Draws from the prior are weighted by how well they give the depths that are fitted on. Young's
modulus has no prior: for each draw it is what fits best, with the spread that the model's own error
leaves it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dotsim_ros.data.importers.force_depth import ForceDepth
from dotsim_ros.io.arrays import FloatArray
from studies.real.pad import COMPRESSIBILITY, PadState, PadTable

DRAW_COUNT = 40_000
INTERVAL = (0.025, 0.975)
MODEL_ERROR = 0.025
"""One deviation of a force at one depth: the gel's own error, 2 % from CalculiX, and the gauge."""


@dataclass(frozen=True)
class Prior:
    """What is taken for possible before the press, on each unknown by itself.

    Attributes:
        compressibility: mean and deviation of log(1/2 - nu), as the calibration has them: nu of
            0.49, and from 0.45 to 0.498 within two deviations.
        largest_friction: friction is anything from 0 to this.
        support_m_n: deviation of what a newton moves the support, one-sided: plastic housings of
            such sensors and their mounts give way by some micrometres.
        zero_m: deviation of the zero of depth, as it is found by touch.
        stiffening: deviation of C20 over C10.
    """

    compressibility: tuple[float, float] = (float(np.log(0.01)), 0.8)
    largest_friction: float = 1.0
    support_m_n: float = 5.0e-6
    zero_m: float = 0.05e-3
    stiffening: float = 0.03

    def draw(self, count: int, seed: int) -> PadState:
        """Return `count` draws."""
        random = np.random.default_rng(seed)
        middle, width = self.compressibility
        return PadState(
            compressibility=np.clip(
                random.normal(middle, width, count), COMPRESSIBILITY[0], COMPRESSIBILITY[-1]
            ),
            friction=random.uniform(0.0, self.largest_friction, count),
            support_m_n=np.abs(random.normal(0.0, self.support_m_n, count)),
            zero_m=random.normal(0.0, self.zero_m, count),
            stiffening=random.normal(0.0, self.stiffening, count),
        )


@dataclass(frozen=True)
class Predicted:
    """The force at a depth that was not fitted on.

    Attributes:
        depth_m: that depth.
        fitted_m: those that were fitted on.
        force_n: median.
        interval_n: of 95 %.
        effective_draws: how many equal draws the weights are worth.
    """

    depth_m: float
    fitted_m: tuple[float, ...]
    force_n: float
    interval_n: tuple[float, float]
    effective_draws: float


@dataclass(frozen=True)
class Weighted:
    """Draws, and how well each gives the depths that were fitted on.

    Attributes:
        state: N draws.
        log_scale: (N,) of Young's modulus over the table's.
        weight: (N,) that sum to 1.
        fitted_m: the depths.
    """

    state: PadState
    log_scale: FloatArray
    weight: FloatArray
    fitted_m: tuple[float, ...]

    @property
    def effective_draws(self) -> float:
        """How many draws of equal weight they are worth."""
        return float(1.0 / np.sum(self.weight**2))

    def quantiles(self, values: FloatArray, shares: tuple[float, ...]) -> FloatArray:
        """Return weighted quantiles of the draws' values (N,)."""
        order = np.argsort(values)
        cumulated = np.cumsum(self.weight[order])
        return np.interp(shares, cumulated, values[order])


def residuals(table: PadTable, state: PadState, press: ForceDepth) -> FloatArray:
    """Return log of the measured force over the table's, (N, P) for N states and P depths."""
    columns = [
        np.log(force)
        - table.log_force_at(state, table.depth_inside_m(state, depth, np.asarray(force)))
        for depth, force in zip(press.depth_m.tolist(), press.force_n.tolist(), strict=True)
    ]
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


def weighted_draws(
    table: PadTable,
    press: ForceDepth,
    *,
    prior: Prior,
    count: int = DRAW_COUNT,
    seed: int = 0,
) -> Weighted:
    """Return draws weighted by the depths of a press.

    Args:
        table: of the pad.
        press: at least two depths.
        prior: of what is not known.
        count: draws.
        seed: of them.

    Raises:
        ValueError: one depth, which fits everything.
    """
    if len(press.depth_m) < 2:
        raise ValueError("one depth fits every state of the pad; fit on two at least")
    state = prior.draw(count, seed)
    difference = residuals(table, state, press)
    middle = difference.mean(axis=1)
    misfit = np.sum((difference - middle[:, None]) ** 2, axis=1) / MODEL_ERROR**2
    weight = np.exp(-0.5 * (misfit - misfit.min()))
    spread = np.random.default_rng(seed + 1).normal(
        0.0, MODEL_ERROR / np.sqrt(len(press.depth_m)), count
    )
    return Weighted(state, middle + spread, weight / weight.sum(), tuple(press.depth_m.tolist()))


def predicted(table: PadTable, draws: Weighted, depth_m: float, *, seed: int = 0) -> Predicted:
    """Return the force at another depth, with the model's own error there.

    Args:
        table: of the pad.
        draws: weighted by the depths that are fitted on.
        depth_m: the other one.
        seed: of the error.
    """
    force = table.force_n(draws.state, draws.log_scale, depth_m)
    error = np.random.default_rng(seed + 2).normal(0.0, MODEL_ERROR, len(force))
    low, middle, high = draws.quantiles(
        force * np.exp(error), (INTERVAL[0], 0.5, INTERVAL[1])
    ).tolist()
    return Predicted(depth_m, draws.fitted_m, middle, (low, high), draws.effective_draws)


def each_left_out(table: PadTable, press: ForceDepth, prior: Prior, seed: int) -> list[Predicted]:
    """Return a prediction of every depth from all others."""
    found = []
    for left_out, depth in enumerate(press.depth_m.tolist()):
        kept = np.arange(len(press.depth_m)) != left_out
        fitted_on = ForceDepth(press.depth_m[kept], press.force_n[kept])
        draws = weighted_draws(table, fitted_on, prior=prior, seed=seed)
        found.append(predicted(table, draws, depth, seed=seed))
    return found
