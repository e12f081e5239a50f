# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Latency: the recorded pose is ahead of the true one; the gel is where the pose was earlier."""

from __future__ import annotations

from collections import deque

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import FORCE, SKIN, Effect, EffectParameter, MotionFilter, Values
from dotsim_ros.effects.excitation import touches
from dotsim_ros.geometry.pose import Pose, interpolate
from dotsim_ros.measured.recording import Phase, Recording


def _motion(values: Values) -> MotionFilter:
    latency_s = values["latency_s"]
    past: deque[tuple[float, Pose]] = deque()

    def delayed(stamp_s: float, pose: Pose, force_n: FloatArray) -> Pose:
        past.append((stamp_s, pose))
        then_s = stamp_s - latency_s
        while len(past) > 1 and past[1][0] <= then_s:
            past.popleft()
        (begin_s, begin) = past[0]
        if len(past) == 1 or then_s <= begin_s:
            return begin
        (end_s, end) = past[1]
        return interpolate(begin, end, (then_s - begin_s) / (end_s - begin_s))

    return delayed


def _moves_in_contact(recording: Recording) -> bool:
    return touches(recording) and recording.has(Phase.LOAD, Phase.SLIDE, Phase.RELEASE)


EFFECT = Effect(
    name="latency",
    title="Latency of the pose",
    parameters=(EffectParameter("latency_s", "s", 0.0, 0.0, 0.15, (0.03, 0.1)),),
    channels=(SKIN, FORCE),
    protocol="there and back at two speeds, the faster 20 mm/s or more; at one speed and in one "
    "direction a latency can hardly be distinguished from an offset of the pose",
    excited_by=_moves_in_contact,
    taken_for=("backlash", "viscoelastic_relaxation", "pose_offset"),
    motion=_motion,
)
