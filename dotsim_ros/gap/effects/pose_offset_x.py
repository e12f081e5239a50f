"""Pose offset along x: every pose lies beside where it is told, base frame."""

from __future__ import annotations

from dotsim_ros.gap.effect import FORCE, SKIN, Effect, EffectParameter, MotionFilter, Values
from dotsim_ros.gap.excitation import touches
from dotsim_ros.gap.pose_terms import OFFSET_M, shift_along


def _motion(values: Values) -> MotionFilter:
    return shift_along(0, values["x_m"])


EFFECT = Effect(
    name="pose_offset_x",
    title="A pose offset along x",
    parameters=(EffectParameter("x_m", "m", 0.0, -OFFSET_M, OFFSET_M, (0.2e-3, -0.2e-3)),),
    channels=(SKIN, FORCE),
    protocol="presses on both sides of the apex along x, with the skin or the image measured",
    excited_by=touches,
    taken_for=("camera extrinsics", "latency"),
    motion=_motion,
)
