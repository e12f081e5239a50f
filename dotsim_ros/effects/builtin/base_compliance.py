# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Base compliance: what holds the sensor or the indenter gives way, and depth is lost."""

from __future__ import annotations

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import FORCE, SKIN, Effect, EffectParameter, MotionFilter, Values
from dotsim_ros.effects.excitation import touches
from dotsim_ros.effects.pose_terms import shifted
from dotsim_ros.geometry.pose import Pose


def _motion(values: Values) -> MotionFilter:
    compliance = values["compliance_m_n"]

    def pushed_back(stamp_s: float, pose: Pose, force_n: FloatArray) -> Pose:
        return shifted(pose, compliance * force_n)

    return pushed_back


EFFECT = Effect(
    name="base_compliance",
    title="A base that gives way",
    parameters=(EffectParameter("compliance_m_n", "m/N", 0.0, 0.0, 1e-4, (2e-5, 6e-5)),),
    channels=(SKIN, FORCE),
    protocol="presses with two radii to the same depth, with the force measured",
    excited_by=touches,
    taken_for=("youngs_modulus", "pose_offset"),
    motion=_motion,
)
