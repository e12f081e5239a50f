"""Pose offset along y: every pose lies beside where it is told, base frame."""

from __future__ import annotations

from dotsim_ros.gap.effect import FORCE, SKIN, Effect, EffectParameter, MotionFilter, Values
from dotsim_ros.gap.excitation import touches
from dotsim_ros.gap.pose_terms import OFFSET_M, shift_along


def _motion(values: Values) -> MotionFilter:
    return shift_along(1, values["y_m"])


EFFECT = Effect(
    name="pose_offset_y",
    title="A pose offset along y",
    parameters=(EffectParameter("y_m", "m", 0.0, -OFFSET_M, OFFSET_M, (0.2e-3, -0.2e-3)),),
    channels=(SKIN, FORCE),
    protocol="presses on both sides of the apex along y, with the skin or the image measured",
    excited_by=touches,
    taken_for=("camera extrinsics", "latency"),
    motion=_motion,
)
