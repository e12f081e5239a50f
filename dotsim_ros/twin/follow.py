# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A gel follows recorded poses: the one loop that turns poses into skin and force."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from dotsim_ros.geometry.pose import Pose, Wrench, interpolate
from dotsim_ros.io.arrays import FloatArray

FIRST_STEP_S = 0.1
"""Duration of the way to the first pose, which no stamp gives."""


class SolveError(ValueError):
    """The gel could not be solved at the poses of a press."""


class GelAnswer(Protocol):
    """What a gel gives for one pose."""

    @property
    def skin_position_m(self) -> FloatArray:
        """(V, 3) skin markers, base frame."""

    @property
    def wrench(self) -> Wrench:
        """Force and torque of the gel on the indenter."""

    @property
    def converged(self) -> bool:
        """Whether the solver met its tolerance."""


@dataclass(frozen=True)
class SimulatedPress:
    """What a gel gives for the F frames of a press: skin (F, V, 3) and force (F, 3) on the
    indenter, base frame, and whether every frame met the solver's tolerance."""

    skin_position_m: FloatArray
    force_n: FloatArray
    converged: bool


def steps(
    poses: Sequence[Pose], stamp_s: FloatArray, *, longest_step_s: float = np.inf
) -> Iterator[tuple[Pose, float, bool]]:
    """Yield (pose, duration in seconds, whether it ends a frame) along F poses and their times.

    One step leads to the first frame; what lies between two frames is divided evenly, into steps
    that are not too long.
    """
    yield poses[0], min(FIRST_STEP_S, longest_step_s), True
    for (start, end), (before_s, after_s) in zip(
        pairwise(poses), pairwise(stamp_s.tolist()), strict=True
    ):
        # A share of a step too long is rounding, not another step.
        count = max(1, int(np.ceil((after_s - before_s) / longest_step_s - 1e-9)))
        for part in range(1, count + 1):
            pose = end if part == count else interpolate(start, end, part / count)
            yield pose, (after_s - before_s) / count, part == count


def follow(
    step: Callable[[Pose, float], GelAnswer],
    poses: Sequence[Pose],
    stamp_s: FloatArray,
    *,
    longest_step_s: float = np.inf,
) -> SimulatedPress:
    """Return what a gel gives at F poses, one after the other.

    Args:
        step: moves the gel's indenter to a pose in so many seconds; the gel is at rest.
        poses, stamp_s: of the indenter, base frame.
        longest_step_s: steps between two frames are no longer; the gel itself takes substeps.

    Raises:
        SolveError: a pose presses too deep, or the gel has no equilibrium that can be found; the
            text names the frame.
    """
    skins: list[FloatArray] = []
    forces: list[FloatArray] = []
    converged = True
    for pose, dt_s, ends_frame in steps(poses, stamp_s, longest_step_s=longest_step_s):
        try:
            answer = step(pose, dt_s)
        except (ValueError, RuntimeError, np.linalg.LinAlgError) as error:
            raise SolveError(f"frame {len(skins)} could not be solved: {error}") from error
        if not np.all(np.isfinite(answer.skin_position_m)):
            raise SolveError(f"frame {len(skins)} could not be solved: the skin is not finite")
        if ends_frame:
            skins.append(answer.skin_position_m)
            forces.append(answer.wrench.force_n)
        converged = converged and answer.converged
    return SimulatedPress(np.stack(skins), np.stack(forces), converged)
