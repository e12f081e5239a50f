# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Backlash: the indenter follows the commanded position with play, and lags at each reversal.

The play operator of hysteresis (Krasnosel'skii and Pokrovskii, "Systems with hysteresis", 1989) on
the position: what follows is dragged once what leads is farther from it than half the play.
"""

from __future__ import annotations

import numpy as np

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import FORCE, SKIN, Effect, EffectParameter, MotionFilter, Values
from dotsim_ros.effects.excitation import reverses
from dotsim_ros.geometry.pose import Pose


def _motion(values: Values) -> MotionFilter:
    half_m = 0.5 * values["width_m"]
    follower_m = None

    def dragged(stamp_s: float, pose: Pose, force_n: FloatArray) -> Pose:
        nonlocal follower_m
        if follower_m is None:
            follower_m = pose.position_m
        lead_m = pose.position_m - follower_m
        distance_m = float(np.linalg.norm(lead_m))
        if distance_m > half_m:
            follower_m = pose.position_m - lead_m * (half_m / distance_m)
        return Pose(follower_m, pose.quaternion_xyzw)

    return dragged


EFFECT = Effect(
    name="backlash",
    title="Backlash of the motion",
    parameters=(EffectParameter("width_m", "m", 0.0, 0.0, 0.2e-3, (0.1e-3,)),),
    channels=(SKIN, FORCE),
    protocol="small reversals in contact, of 0.3 mm, at two speeds: the step is the same at both",
    excited_by=reverses,
    taken_for=("latency", "coulomb_slip", "adhesion"),
    motion=_motion,
)
