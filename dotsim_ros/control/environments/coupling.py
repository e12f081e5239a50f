# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sensors on bodies of a MuJoCo world, coupled in both directions: `MujocoCoupling` has one,
`MujocoGripper` as many as the world has fingers.

MuJoCo moves the bodies, the gel answers where they are. The gel costs some 20 ms and is stiff, so
it is solved seldom, and in between its wrench follows the tangent of its last solution,

    w = w0 - K (x - x0) - c K dx/dt,

in each of MuJoCo's steps: the gel's stiffness as an implicit term. With the wrench held constant
between solutions, as a plain staggered scheme does, a body of mass m is unstable from steps of
2 sqrt(m / K) on: 10 ms for 50 g on 2 N/mm. The gel is solved at the end of each coupling time, when
the geom has moved too far for its tangent, and when it meets the skin: a body that touches late has
fallen too deep, and is thrown out with more energy than it had.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from weakref import WeakValueDictionary

import mujoco
import numpy as np
from scipy import linalg

from dotsim_ros.control.environments.geoms import indenter_of, pose_of
from dotsim_ros.gel.make import GelFrame
from dotsim_ros.geometry.pose import Pose, Wrench
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.exclusive_use import ExclusiveUse, exclusive
from dotsim_ros.sensor import TactileSensor

DAMPING_S = 2.0e-3
"""c: the gel's loss, as the time that its stiffness is multiplied by. Silicone loses some tenth of
the energy of a swing; without any a body on the gel would swing for ever."""
ALIGNED = 0.9
"""A geom that lies as it did, by the cosine of the angle between, comes to the gel from the same
side."""


@dataclass(frozen=True)
class _Frame:
    """A frame in another: its axes as columns (3, 3), and its origin (3,)."""

    axes: FloatArray
    origin_m: FloatArray

    def in_world(self, child: _Frame) -> _Frame:
        """Return a frame that is given in this one as this one is given."""
        return _Frame(self.axes @ child.axes, self.origin_m + self.axes @ child.origin_m)

    def seen_from(self, other: _Frame) -> _Frame:
        """Return this frame in another one."""
        return _Frame(other.axes.T @ self.axes, other.axes.T @ (self.origin_m - other.origin_m))

    def pose(self) -> Pose:
        """Return the same as a pose."""
        return pose_of(self.origin_m, self.axes)


@dataclass(frozen=True)
class _Anchor:
    """The last solution: the indenter in the sensor's base frame, the wrench on it (6,) about that
    frame's origin, its stiffness (6, 6), and the skin (V, 3)."""

    indenter: _Frame
    wrench: FloatArray
    stiffness: FloatArray
    skin_m: FloatArray


@dataclass(frozen=True)
class Finger:
    """A sensor of a gripper, and what presses it.

    Attributes:
        sensor: a tactile sensor of this finger alone; its indenter is replaced by the geom.
        sensor_body: name of the body that the sensor is on.
        pressed_geom: name of the geom that presses it. MuJoCo must not make contacts of its own
            between the gel and this geom: give the sensor's body no geom where the gel is.
        mount: pose of the sensor's base frame in the frame of its body.
    """

    sensor: TactileSensor
    sensor_body: str
    pressed_geom: str
    mount: Pose = field(default_factory=Pose)


class CoupledFinger:
    """A finger in its world: where it is, and the wrench between its gel and its geom.

    Args:
        move_m: farthest that the geom moves on the gel between two solutions.

    Attributes:
        work_j: that the gel has done on geom and sensor since the last reset. A gel that was not
            pressed then gives back what it was given at most: this stays at or below zero.

    Raises:
        ValueError: no such body or geom.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, finger: Finger, move_m: float
    ) -> None:
        self.sensor = finger.sensor
        self._model, self._data = model, data
        self._mount = _frame_of(finger.mount)
        self._sensor_body = _number(model, mujoco.mjtObj.mjOBJ_BODY, "body", finger.sensor_body)
        self._geom = _number(model, mujoco.mjtObj.mjOBJ_GEOM, "geom", finger.pressed_geom)
        self._pressed_body = int(model.geom_bodyid[self._geom])
        self._step_s, self._move_m = float(model.opt.timestep), move_m
        self._away: FloatArray | None = None
        self.solution_count = 0

    def reset(self) -> GelFrame:
        """Forget what was pressed, and begin from where MuJoCo's bodies are now."""
        away = self._geom_frame().axes.T @ self._base().axes[:, 2]
        # To set an indenter takes as long as several solutions.
        if self._away is None or float(self._away @ away) < ALIGNED:
            indenter, placed = indenter_of(self._model, self._geom, away)
            self._placed = _frame_of(placed)
            self.sensor.set_indenter(indenter)
            self._away = away
        else:
            self.sensor.reset()
        self._before, self._waited_s = self._indenter(self._base()), 0.0
        self._pushed, self.work_j = np.zeros(6), 0.0
        return self._solve(self._before)

    def base_pose(self) -> Pose:
        """Return the pose of the sensor's base frame in the world."""
        return self._base().pose()

    def indenter_pose(self) -> Pose:
        """Return the pose of the indenter in the sensor's base frame."""
        return self._indenter(self._base()).pose()

    # Poses check what they are given, at a cost that each of MuJoCo's steps would pay ten times.
    def _base(self) -> _Frame:
        body = self._sensor_body
        axes = self._data.xmat[body].reshape(3, 3)
        return _Frame(axes, self._data.xpos[body]).in_world(self._mount)

    def _geom_frame(self) -> _Frame:
        axes = self._data.geom_xmat[self._geom].reshape(3, 3)
        return _Frame(axes, self._data.geom_xpos[self._geom])

    def _indenter(self, base: _Frame) -> _Frame:
        return self._geom_frame().in_world(self._placed).seen_from(base)

    def wrench(self) -> Wrench:
        """Return the wrench of the gel on the geom as it was solved last, sensor's base frame."""
        return Wrench(self._anchor.wrench[:3].copy(), self._anchor.wrench[3:].copy())

    def solve(self) -> GelFrame:
        """Return the gel where MuJoCo's bodies are now."""
        return self._solve(self._indenter(self._base()))

    def push(self) -> None:
        """Add the wrench of the gel to `xfrc_applied` of the geom's body, and its opposite to that
        of the sensor's, for one step of MuJoCo."""
        base = self._base()
        before, pushed = self._before, self._pushed
        wrench = self._pushed = self._predicted(base)
        # What both steps push, halved: by either alone an elastic swing would seem to lose or win.
        self.work_j += 0.5 * float((pushed + wrench) @ _twist(before, self._before))
        self._waited_s += self._step_s
        force, torque = base.axes @ wrench[:3], base.axes @ wrench[3:]
        for body, sign in ((self._pressed_body, 1.0), (self._sensor_body, -1.0)):
            applied = self._data.xfrc_applied[body]
            applied[:3] += sign * force
            applied[3:] += sign * (torque + _cross(base.origin_m - self._data.xipos[body], force))

    def stiffness(self) -> tuple[FloatArray, FloatArray]:
        """Return the gel's stiffness (6, 6) as it was solved last, and how the geom moves on the
        gel by the joints (6, nv), both in the sensor's base frame."""
        base, joints = self._base(), np.zeros((2, 6, self._model.nv))
        for body, jacobian in zip((self._pressed_body, self._sensor_body), joints, strict=True):
            point = (self._model, self._data, jacobian[:3], jacobian[3:], base.origin_m, body)
            mujoco.mj_jac(*point)
        relative = (joints[0] - joints[1]).reshape(2, 3, -1)
        return self._anchor.stiffness, (base.axes.T @ relative).reshape(6, -1)

    def _solve(self, indenter: _Frame) -> GelFrame:
        frame = self.sensor.press(indenter.pose(), self._waited_s or self._step_s)
        wrench = np.concatenate([frame.wrench.force_n, frame.wrench.torque_nm])
        stiffness = self.sensor.wrench_stiffness()
        self._anchor = _Anchor(indenter, wrench, stiffness, frame.skin_position_m)
        self._waited_s = 0.0
        self.solution_count += 1
        return frame

    def _predicted(self, base: _Frame) -> FloatArray:
        """Return the wrench (6,) on the geom where it is now, sensor's base frame."""
        indenter = self._indenter(base)
        before, self._before = self._before, indenter
        if self._is_due(indenter):
            self._solve(indenter)
        anchor = self._anchor
        if not anchor.wrench.any():
            return np.zeros(6)
        rate = _twist(before, indenter) / self._step_s
        moved = _twist(anchor.indenter, indenter) + DAMPING_S * rate
        wrench = anchor.wrench - anchor.stiffness @ moved
        # The gel does not pull.
        if float(wrench[:3] @ anchor.wrench[:3]) <= 0.0:
            return np.zeros(6)
        return wrench

    def _is_due(self, indenter: _Frame) -> bool:
        """Return whether the gel must be solved before the coupling time is over."""
        anchor, shape = self._anchor, self.sensor.indenter
        if anchor.wrench.any():
            moved = _twist(anchor.indenter, indenter)
            at_contact = moved[:3] + _cross(moved[3:], indenter.origin_m)
            return float(at_contact @ at_contact) > self._move_m**2
        local = (anchor.skin_m - indenter.origin_m) @ indenter.axes
        lower, upper = shape.bounds_m()
        near = np.all((local > lower) & (local < upper), axis=1)
        return bool(near.any()) and float(shape.signed_distance(local[near]).min()) < 0.0


_coupled: WeakValueDictionary[int, MujocoGripper] = WeakValueDictionary()
"""By the identity of MuJoCo's data, which lives as long as what is coupled to it."""


class MujocoGripper:
    """Sensors on bodies of one world, each pressed by one geom: all of them move in one step.

    Any number of fingers may press one body, and what they press may carry sensors itself: the
    forces add up.

    Args:
        model, data: MuJoCo's. For each of MuJoCo's steps the gels' wrenches are added to what the
            caller has put into `data.xfrc_applied`, and taken out again.
        coupling_s: longest time between two solutions of a gel.
        move_m: farthest that a geom moves on its gel between two.

    Attributes:
        fingers: the same, in the world.

    Raises:
        ValueError: no finger, no such body or geom, a geom that cannot press, one sensor for two
            fingers, another coupling of the same world, or a coupling time that is not a multiple
            of MuJoCo's time step.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        fingers: Sequence[Finger],
        *,
        coupling_s: float = 0.01,
        move_m: float = 0.2e-3,
    ) -> None:
        if id(data) in _coupled:
            raise ValueError(
                "this world has a coupling already, and a step of each moves all of it: make one "
                "MujocoGripper(model, data, [Finger(...), Finger(...)]) of all its sensors, or "
                "delete the coupling before (del) to make another"
            )
        if len(fingers) != len({id(finger.sensor) for finger in fingers}) or not fingers:
            raise ValueError(
                f"{len(fingers)} fingers have {len({id(finger.sensor) for finger in fingers})} "
                "sensors, expected one or more fingers, and a TactileSensor of its own for each: "
                "a gel knows one contact"
            )
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            raise ValueError(
                "the model's integrator is RK4, expected Euler, implicit or implicitfast: the "
                "gel's wrench is set between the two halves of a step"
            )
        step_s = float(model.opt.timestep)
        self._count = round(coupling_s / step_s)
        if self._count < 1 or abs(self._count * step_s - coupling_s) > 1e-9:
            raise ValueError(
                f"coupling_s is {coupling_s}, expected a multiple of MuJoCo's time step of "
                f"{step_s} s"
            )
        self.exclusive_use = ExclusiveUse("coupling")
        self.model, self.data, self.coupling_s = model, data, coupling_s
        self.fingers = tuple(CoupledFinger(model, data, finger, move_m) for finger in fingers)
        self._has_warned, self._checked_count = False, 0
        self.reset()
        _coupled[id(data)] = self

    @exclusive(begins=True)
    def reset(self) -> list[GelFrame]:
        """Forget what was pressed, and begin from where MuJoCo's bodies are now."""
        mujoco.mj_forward(self.model, self.data)
        return [finger.reset() for finger in self.fingers]

    @exclusive()
    def step(self) -> list[GelFrame]:
        """Move the world on by `coupling_s`, and return the gels at its end, a finger each.

        Raises:
            PressTooDeepError: a geom was pushed through a gel; its message has the depth. The
                world has moved on: reset it.
            GelFailureError: a gel could not be solved; the same.
            ValueError: MuJoCo's state is not finite.
        """
        given = self.data.xfrc_applied.copy()
        try:
            for _ in range(self._count):
                mujoco.mj_step1(self.model, self.data)
                self.data.xfrc_applied[:] = given
                for finger in self.fingers:
                    finger.push()
                self._warn_of_long_steps()
                mujoco.mj_step2(self.model, self.data)
        finally:
            self.data.xfrc_applied[:] = given
        if not np.all(np.isfinite(self.data.qpos)):
            raise ValueError(
                "MuJoCo's state is not finite: the world is unstable without the gel, or its time "
                "step is too long; reset it"
            )
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        return [finger.solve() for finger in self.fingers]

    def _warn_of_long_steps(self) -> None:
        """Warn, once, where MuJoCo's time step is too long for a swing on the gels' stiffness.

        An explicit step of h keeps a swing of angular frequency w, damped by c w^2, bounded while
        h (h + 2 c) w^2 < 4 (the eigenvalues of v -= h w^2 (x + c v), x += h v).
        """
        solutions = sum(finger.solution_count for finger in self.fingers)
        if self._has_warned or self.model.nv == 0 or solutions == self._checked_count:
            return
        self._checked_count = solutions
        stiffness, moves = zip(*(finger.stiffness() for finger in self.fingers), strict=True)
        joints = np.concatenate(moves)
        answers = np.zeros_like(joints)
        mujoco.mj_solveM(self.model, self.data, answers, joints)
        swings = np.linalg.eigvals(linalg.block_diag(*stiffness) @ joints @ answers.T)
        longest_s = float(np.sqrt(DAMPING_S**2 + 4.0 / max(swings.real.max(), 1e-9)) - DAMPING_S)
        if self.model.opt.timestep > longest_s:
            self._has_warned = True
            warnings.warn(
                f"MuJoCo's time step of {1e3 * self.model.opt.timestep:.3g} ms is too long for the "
                "stiffness of the gels in contact: bodies tremble on them, or are thrown off; "
                f"expected less than {1e3 * longest_s:.3g} ms (option timestep)",
                stacklevel=3,
            )


class MujocoCoupling:
    """One sensor on one body, pressed by one geom; several sensors of a world are a
    `MujocoGripper`.

    Args:
        model, data: as for `MujocoGripper`.
        sensor, sensor_body, pressed_geom, mount: as for `Finger`.
        coupling_s, move_m: as for `MujocoGripper`.

    Raises:
        ValueError: as `MujocoGripper`.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        sensor: TactileSensor,
        *,
        sensor_body: str,
        pressed_geom: str,
        mount: Pose | None = None,
        coupling_s: float = 0.01,
        move_m: float = 0.2e-3,
    ) -> None:
        self.model, self.data, self.sensor, self.coupling_s = model, data, sensor, coupling_s
        finger = Finger(sensor, sensor_body, pressed_geom, Pose() if mount is None else mount)
        self._gripper = MujocoGripper(model, data, [finger], coupling_s=coupling_s, move_m=move_m)

    @property
    def finger(self) -> CoupledFinger:
        """The only one."""
        return self._gripper.fingers[0]

    def reset(self) -> GelFrame:
        """As `MujocoGripper.reset`."""
        return self._gripper.reset()[0]

    def step(self) -> GelFrame:
        """As `MujocoGripper.step`."""
        return self._gripper.step()[0]

    def base_pose(self) -> Pose:
        """As `CoupledFinger.base_pose`."""
        return self.finger.base_pose()

    def indenter_pose(self) -> Pose:
        """As `CoupledFinger.indenter_pose`."""
        return self.finger.indenter_pose()

    def wrench(self) -> Wrench:
        """As `CoupledFinger.wrench`."""
        return self.finger.wrench()


def _frame_of(pose: Pose) -> _Frame:
    return _Frame(pose.rotation(), pose.position_m)


def _twist(before: _Frame, after: _Frame) -> FloatArray:
    """Return the motion (6,) of a body from one place to another: translation (m) of the point at
    the origin of the frame that both are given in, and rotation (rad) about it, for small ones."""
    turned = after.axes @ before.axes.T
    result = np.empty(6)
    result[:3] = after.origin_m - turned @ before.origin_m
    result[3] = 0.5 * (turned[2, 1] - turned[1, 2])
    result[4] = 0.5 * (turned[0, 2] - turned[2, 0])
    result[5] = 0.5 * (turned[1, 0] - turned[0, 1])
    return result


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the cross product of two vectors (3,); numpy's costs ten times as much."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def _number(model: mujoco.MjModel, kind: mujoco.mjtObj, word: str, name: str) -> int:
    number = mujoco.mj_name2id(model, kind, name)
    if number < 0:
        count = model.nbody if word == "body" else model.ngeom
        known = [mujoco.mj_id2name(model, kind, index) for index in range(count)]
        named = ", ".join(sorted(text for text in known if text)) or "none with a name"
        raise ValueError(f"the model has no {word} named {name!r}; it has {named}")
    return int(number)
