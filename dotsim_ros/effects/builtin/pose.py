# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects of the recorded pose: its offset, its delay, and what gives way below it.

An offset is constant in the base frame, where the sensor stands elsewhere than it is taken to, or
in the indenter's, where its tip does.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from scipy.spatial.transform import Rotation

from dotsim_ros.data.recording import Recording
from dotsim_ros.effects.effect import (
    FORCE,
    SKIN,
    Effect,
    EffectParameter,
    MotionFilter,
    Values,
    by_frame,
)
from dotsim_ros.effects.excitation import moves_in_contact, reverses, touches
from dotsim_ros.geometry.indenter import IndenterKind
from dotsim_ros.geometry.pose import Pose, interpolate
from dotsim_ros.io.arrays import FloatArray

OFFSET_M = 0.5e-3
"""Largest pose offset that is taken for an error of calibration; more is a wrong sensor file."""


def shifted(pose: Pose, shift_m: FloatArray) -> Pose:
    """Return a pose moved by (3,) in the frame that it is given in."""
    return Pose(pose.position_m + shift_m, pose.quaternion_xyzw)


def offset_effect(axis: str, *, name: str, protocol: str, taken_for: tuple[str, ...]) -> Effect:
    """Return the effect that moves every pose along an axis, x, y or z, of the base frame."""
    parameter = EffectParameter(f"{axis}_m", "m", 0.0, -OFFSET_M, OFFSET_M, (0.2e-3, -0.2e-3))
    direction = np.eye(3)["xyz".index(axis)]

    def moved(values: Values, stamp_s: float, pose: Pose, force_n: FloatArray) -> Pose:
        return shifted(pose, values[parameter.name] * direction)

    return Effect(
        name=name,
        title=f"A pose offset along {axis}",
        summary=f"every true pose is displaced from the recorded one along {axis}, base frame.",
        parameters=(parameter,),
        channels=(SKIN, FORCE),
        protocol=protocol,
        excited_by=touches,
        taken_for=taken_for,
        motion=by_frame(moved),
    )


POSE_OFFSET = offset_effect(
    "z",
    name="pose_offset",
    protocol="the approach: presses that begin above the skin, at three places of it",
    taken_for=("base_compliance", "latency", "youngs_modulus"),
)
"""A sensor that is turned about its base is left to the offsets along x and y: the contact moves by
the sensor's height.
"""

POSE_OFFSET_X = offset_effect(
    "x",
    name="pose_offset_x",
    protocol="presses on both sides of the apex along x, with the skin or the image measured",
    taken_for=("camera extrinsics", "latency"),
)

POSE_OFFSET_Y = offset_effect(
    "y",
    name="pose_offset_y",
    protocol="presses on both sides of the apex along y, with the skin or the image measured",
    taken_for=("camera extrinsics", "latency"),
)

TURNED = 0.1
"""rad; an indenter whose axes are within this angle of the base frame's shows an offset in its own
frame as one in the base frame, and is not used to name it."""


def _is_turned(recording: Recording) -> bool:
    turns = Rotation.from_quat([pose.quaternion_xyzw for pose in recording.press.poses])
    return touches(recording) and bool(np.any(turns.magnitude() > TURNED))


def _is_no_sphere(recording: Recording) -> bool:
    return touches(recording) and recording.indenter.kind is not IndenterKind.SPHERE


def tool_offset_effect(axis: str) -> Effect:
    """Return the effect that moves every pose along an axis, x or y, of the indenter's frame."""
    name, along = f"{axis}_m", "xyz".index(axis)

    def moved(values: Values, stamp_s: float, pose: Pose, force_n: FloatArray) -> Pose:
        return shifted(pose, values[name] * pose.rotation()[:, along])

    return Effect(
        name=f"tool_offset_{axis}",
        title=f"A tip displaced along its own {axis}",
        summary=f"the tip is off its place in the robot's tool frame, along that frame's {axis}.",
        parameters=(EffectParameter(name, "m", 0.0, -OFFSET_M, OFFSET_M, (0.2e-3, -0.2e-3)),),
        channels=(SKIN, FORCE),
        protocol="presses with the indenter turned in many ways, about its own axis too",
        excited_by=_is_turned,
        taken_for=(f"pose_offset_{axis}", "pose_offset", f"tool_tilt_{'yx'['xy'.index(axis)]}"),
        motion=by_frame(moved),
    )


def tool_tilt_effect(axis: str) -> Effect:
    """Return the effect that tilts every pose at the tip about an axis, x or y, of the indenter's
    frame."""
    name, about = f"{axis}_rad", np.eye(3)["xyz".index(axis)]
    other = "yx"["xy".index(axis)]

    def tilted(values: Values, stamp_s: float, pose: Pose, force_n: FloatArray) -> Pose:
        if values[name] == 0.0:
            return pose
        turn = Rotation.from_quat(pose.quaternion_xyzw) * Rotation.from_rotvec(values[name] * about)
        return Pose(pose.position_m, turn.as_quat())

    return Effect(
        name=f"tool_tilt_{axis}",
        title=f"A tool tilted about its own {axis}",
        summary=f"the indenter is tilted at its tip in the robot's tool frame, about its {axis}.",
        parameters=(EffectParameter(name, "rad", 0.0, -0.06, 0.06, (0.03, -0.03)),),
        channels=(SKIN, FORCE),
        protocol="presses with an edge, a punch or another shape that is no sphere",
        excited_by=_is_no_sphere,
        taken_for=(f"pose_offset_{other}", f"tool_offset_{other}"),
        motion=by_frame(tilted),
    )


TOOL_OFFSET_X, TOOL_OFFSET_Y = tool_offset_effect("x"), tool_offset_effect("y")
TOOL_TILT_X, TOOL_TILT_Y = tool_tilt_effect("x"), tool_tilt_effect("y")


def _latency_motion(values: Values) -> MotionFilter:
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


LATENCY = Effect(
    name="latency",
    title="Latency of the pose",
    summary=("the recorded pose is ahead of the true one; the gel is where the pose was earlier."),
    parameters=(EffectParameter("latency_s", "s", 0.0, 0.0, 0.15, (0.03, 0.1)),),
    channels=(SKIN, FORCE),
    protocol="there and back at two speeds, the faster 20 mm/s or more; at one speed and in one "
    "direction a latency can hardly be distinguished from an offset of the pose",
    excited_by=moves_in_contact,
    taken_for=("controller_lag", "backlash", "viscoelastic_relaxation", "pose_offset"),
    motion=_latency_motion,
)


def _backlash_motion(values: Values) -> MotionFilter:
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


BACKLASH = Effect(
    name="backlash",
    title="Backlash of the motion",
    summary=("the indenter follows the commanded position with play, and lags at each reversal."),
    parameters=(EffectParameter("width_m", "m", 0.0, 0.0, 0.2e-3, (0.1e-3,)),),
    channels=(SKIN, FORCE),
    protocol="small reversals in contact, of 0.3 mm, at two speeds: the step is the same at both",
    excited_by=reverses,
    taken_for=("latency", "coulomb_slip", "adhesion"),
    motion=_backlash_motion,
)
"""The play operator of hysteresis (Krasnosel'skii and Pokrovskii, "Systems with hysteresis", 1989)
on the position: what follows is dragged once what leads is farther from it than half the play.
"""


def _pushed_back(values: Values, stamp_s: float, pose: Pose, force_n: FloatArray) -> Pose:
    return shifted(pose, values["compliance_m_n"] * force_n)


BASE_COMPLIANCE = Effect(
    name="base_compliance",
    title="A base that gives way",
    summary="what holds the sensor or the indenter gives way, and depth is lost.",
    parameters=(EffectParameter("compliance_m_n", "m/N", 0.0, 0.0, 1e-4, (2e-5, 6e-5)),),
    channels=(SKIN, FORCE),
    protocol="presses with two radii to the same depth, with the force measured",
    excited_by=touches,
    taken_for=("youngs_modulus", "pose_offset", "stage_creep", "mount_rotation"),
    motion=by_frame(_pushed_back),
)
