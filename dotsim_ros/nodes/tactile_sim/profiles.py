# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The profiles of `tactile_sim`: how accurately the gel is solved, and at what error. Needs no ROS.

The images have no profile: depth, normals and image are rendered for each pixel of the sensor's
camera, since the idle image is carried pixel by pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dotsim_ros.gel.implicit.gel import LARGEST_SUBSTEP_M
from dotsim_ros.specification import SensorSpecification, SolverSpecification


@dataclass(frozen=True)
class Profile:
    """What the gel of a frame may cost, as bounds on the sensor's own solver.

    Attributes:
        name: as the parameter has it.
        summary: what it does, in one line.
        grid_factor: spacing of the grid as a multiple of the sensor's own, as far as the gel is
            large enough for it.
        smallest_tolerance_m: of Newton's method.
        largest_iterations: of Newton's method, in a substep.
        move_m: how far the indenter may move in contact in one frame.
        skin_error_m: the documented error: no marker of the skin is farther from where `exact` has
            it in the motions of studies/speed/profiles.py, and none jumps farther by a change.
    """

    name: str
    summary: str
    grid_factor: float
    smallest_tolerance_m: float
    largest_iterations: int
    move_m: float
    skin_error_m: float


EXACT = Profile(
    "exact",
    "the sensor's own solver to its tolerance, any motion in one frame; the slowest",
    grid_factor=1.0,
    smallest_tolerance_m=0.0,
    largest_iterations=1000,
    move_m=np.inf,
    skin_error_m=0.0,
)
"""The sensor's own solver, and no limit of motion."""
REALTIME = Profile(
    "realtime",
    "two Newton iterations and 0.6 mm of motion a frame; skin within 1 mm of exact",
    grid_factor=1.0,
    smallest_tolerance_m=30.0e-6,
    largest_iterations=2,
    move_m=LARGEST_SUBSTEP_M,
    skin_error_m=1.0e-3,
)
"""A frame that takes too long is late, has a longer way to go next time, and takes too long again:
better one that misses the tolerance, which is reported. Newton's method ends where it expects to be
right to a fifth of the tolerance, which saves the second solve of most frames; the next frame
continues from there. A frame that took long must not make the next one take longer: with two
substeps a slide had two steady states, one frame of 50 ms and 0.5 mm or one of 100 ms and 1 mm, and
stayed in the second."""
FAST = replace(
    REALTIME,
    name="fast",
    summary="as realtime on a grid four thirds as wide, in about half the time of exact",
    grid_factor=4.0 / 3.0,
)
"""The grid is what saves time. One iteration instead of two saves none, and the contact is as
expensive on either grid."""
PROFILES = {profile.name: profile for profile in (EXACT, REALTIME, FAST)}
"""From the finest to the coarsest."""
AUTO, BY_CLOCK = "auto", "by_clock"
NAMES = (BY_CLOCK, *PROFILES, AUTO)


def resolve_profile(name: str, *, is_lockstep: bool, is_simulated_time: bool = False) -> str:
    """Return the profile that a node runs with: a name of `PROFILES`, or `auto`.

    Args:
        name: one of `NAMES`.
        is_lockstep: whether each pose gets its frame.
        is_simulated_time: whether the time of the frames is that of /clock. What the machine can do
            must then decide nothing, so `auto` is `realtime`.

    Raises:
        ValueError: no such profile, or one that lockstep does not know.
    """
    if name not in NAMES:
        raise ValueError(f"profile is {name!r}, expected one of {', '.join(NAMES)}")
    if is_lockstep:
        if name not in (BY_CLOCK, EXACT.name):
            raise ValueError(
                f"profile is {name!r}, but lockstep shows each pose as the sensor's own solver "
                f"finds it: leave out profile, or set clock to realtime; grid_spacing_m makes "
                "frames of both clocks faster"
            )
        return EXACT.name
    if name == BY_CLOCK or (name == AUTO and is_simulated_time):
        return REALTIME.name
    return name


def solver_of(
    profile: Profile, sensor: SensorSpecification, *, grid_spacing_m: float = 0.0
) -> SolverSpecification:
    """Return a sensor's solver under a profile; a grid spacing other than 0 takes the place of what
    both say."""
    own = sensor.solver
    spacing_m = own.grid_spacing_m
    if profile.grid_factor > 1.0:
        lower, upper = sensor.gel.bounds_m
        coarsest_m = 0.5 * min(b - a for a, b in zip(lower, upper, strict=True))
        # Whole micrometres: 0.0032, as a user would write it, has the same tables on disk.
        coarser_m = round(profile.grid_factor * spacing_m, 6)
        spacing_m = max(spacing_m, min(coarser_m, coarsest_m))
    return replace(
        own,
        grid_spacing_m=grid_spacing_m or spacing_m,
        iterations=min(profile.largest_iterations, own.iterations),
        tolerance_m=max(profile.smallest_tolerance_m, own.tolerance_m),
    )
