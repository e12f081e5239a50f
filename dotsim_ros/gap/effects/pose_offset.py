"""Pose offset along z: every pose lies higher or lower than it is told, base frame.

Errors of rotation are left to the offsets along x and y: about the base they move the contact by
the sensor's height, and a round indenter that turns about its tip presses alike.
"""

from __future__ import annotations

from dotsim_ros.gap.effect import FORCE, SKIN, Effect, EffectParameter, MotionFilter, Values
from dotsim_ros.gap.excitation import touches
from dotsim_ros.gap.pose_terms import OFFSET_M, shift_along


def _motion(values: Values) -> MotionFilter:
    return shift_along(2, values["z_m"])


EFFECT = Effect(
    name="pose_offset",
    title="A pose offset along z",
    parameters=(EffectParameter("z_m", "m", 0.0, -OFFSET_M, OFFSET_M, (0.2e-3, -0.2e-3)),),
    channels=(SKIN, FORCE),
    protocol="the approach: presses that begin above the skin, at three places of it",
    excited_by=touches,
    taken_for=("base_compliance", "latency", "youngs_modulus"),
    motion=_motion,
)
