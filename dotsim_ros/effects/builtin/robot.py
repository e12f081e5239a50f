# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects of the robot that presses: its controller, a mount that turns, a stage that creeps."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from dotsim_ros.data.recording import Phase
from dotsim_ros.effects.builtin.pose import shifted
from dotsim_ros.effects.effect import (
    FORCE,
    SKIN,
    Effect,
    EffectParameter,
    MotionFilter,
    Values,
    by_frame,
)
from dotsim_ros.effects.excitation import shows_transients
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray


def _controller_motion(values: Values) -> MotionFilter:
    lag_s, damping = values["lag_s"], values["damping"]
    spring = np.array([[0.0, 1.0], [-1.0, -2.0 * damping]])
    before_s, wanted_before = 0.0, None
    # Error of position and quaternion (7,), and how fast they change in units of the frequency.
    state = np.zeros((2, 7))

    def led(stamp_s: float, pose: Pose, force_n: FloatArray) -> Pose:
        nonlocal before_s, wanted_before, state
        if lag_s == 0.0:
            return pose
        wanted = np.concatenate([pose.position_m, pose.quaternion_xyzw])
        if wanted_before is None:
            before_s, wanted_before = stamp_s, wanted
            return pose
        # Of the two quaternions of a rotation the one that is near.
        wanted[3:] *= math.copysign(1.0, float(wanted[3:] @ wanted_before[3:]))
        step_s = stamp_s - before_s
        if step_s > 0.0:
            frequency = 2.0 * damping / lag_s
            slope = (wanted - wanted_before) / step_s
            steady = np.stack([-lag_s * slope, slope / frequency])
            state = expm(frequency * step_s * spring) @ (state - steady) + steady
            before_s, wanted_before = stamp_s, wanted
        reached = wanted + state[0]
        return Pose(reached[:3], reached[3:] / np.linalg.norm(reached[3:]))

    return led


CONTROLLER_LAG = Effect(
    name="controller_lag",
    title="A controller that lags",
    summary="the robot follows the commanded pose with a lag, and overshoots at low damping.",
    parameters=(
        EffectParameter("lag_s", "s", 0.0, 0.0, 0.2, (0.08,)),
        EffectParameter("damping", "", None, 0.15, 5.0, (0.2, 0.5, 1.2, 3.0)),
    ),
    channels=(SKIN, FORCE),
    protocol="fast presses that stop in contact, with frames every 20 ms after the stop",
    excited_by=shows_transients,
    taken_for=("latency", "backlash", "viscoelastic_relaxation"),
    motion=_controller_motion,
)
"""A linear system of second order of unit gain, 1 / (1 + T s + (T s / 2 z)^2): T is by how much it
is late in an even motion, z its damping. At z = 5 it is the lag of first order with the time
constant T within some percent; below 1 it overshoots, by exp(-pi z / sqrt(1 - z^2)) of a step
(Ogata, "Modern control engineering", 2010, section 5.3). Between two frames the command is taken as
straight, and the solution is exact.
"""


def _turned_by_load(values: Values, stamp_s: float, pose: Pose, force_n: FloatArray) -> Pose:
    to_tip_m = -values["lever_m"] * pose.rotation()[:, 2]
    turn = Rotation.from_rotvec(values["compliance_rad_nm"] * np.cross(to_tip_m, force_n))
    if turn.magnitude() == 0.0:
        return pose
    turned = turn * Rotation.from_quat(pose.quaternion_xyzw)
    return Pose(pose.position_m - to_tip_m + turn.apply(to_tip_m), turned.as_quat())


MOUNT_ROTATION = Effect(
    name="mount_rotation",
    title="A mount that turns",
    summary="what holds the indenter bends under a sideways force: the tip gives way and tilts.",
    parameters=(
        EffectParameter("compliance_rad_nm", "rad/(N m)", 0.0, 0.0, 0.03, (0.01,)),
        EffectParameter("lever_m", "m", None, 0.02, 0.5, (0.1,)),
    ),
    channels=(SKIN, FORCE),
    protocol="slides and oblique presses, with the force measured",
    excited_by=lambda recording: recording.has(Phase.SLIDE),
    taken_for=("coulomb_slip", "base_compliance", "backlash", "pose_offset_x", "pose_offset_y"),
    motion=by_frame(_turned_by_load),
)
"""It turns by the force's moment about a point behind the tip, on the indenter's axis. What a force
F along the skin shifts the tip by, compliance * lever^2 * F, is what is seen; a search looks for it
with a lever of 0.1 m, since tilt and shift alone could tell another. Next to `base_compliance`,
which gives way alike in all directions, these are the bending modes of six degrees; torsion about
the axis needs the torque, which a motion is not given.
"""


def _creeping_motion(values: Values) -> MotionFilter:
    compliance_m_n, time_s = values["compliance_m_n"], values["time_s"]
    before_s, load_before = 0.0, None
    crept_m = np.zeros(3)

    def crept(stamp_s: float, pose: Pose, force_n: FloatArray) -> Pose:
        nonlocal before_s, load_before, crept_m
        if load_before is not None and stamp_s > before_s:
            step_s = stamp_s - before_s
            late = time_s * (force_n - load_before) / step_s
            behind_m = crept_m - compliance_m_n * (load_before - late)
            crept_m = compliance_m_n * (force_n - late) + math.exp(-step_s / time_s) * behind_m
        before_s, load_before = stamp_s, force_n
        return shifted(pose, crept_m)

    return crept


STAGE_CREEP = Effect(
    name="stage_creep",
    title="A stage that creeps",
    summary="what holds the indenter gives way slowly under load, and depth drifts in a hold.",
    parameters=(
        EffectParameter("compliance_m_n", "m/N", 0.0, 0.0, 1e-4, (4e-5,)),
        EffectParameter("time_s", "s", None, 0.3, 100.0, (0.7, 3.0, 12.0)),
    ),
    channels=(SKIN, FORCE),
    protocol="a deep press that is held for three times the creep, with skin and force measured",
    excited_by=lambda recording: recording.has(Phase.HOLD),
    taken_for=("base_compliance", "viscoelastic_relaxation", "permanent_set"),
    motion=_creeping_motion,
)
"""Kelvin and Voigt's element: the way approaches compliance * force with one time constant. The
force is straight between frames, and the solution exact.
"""
