"""The sensor on a body of a MuJoCo world, coupled in both directions.

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

from dataclasses import dataclass

import mujoco
import numpy as np

from dotsim_ros.arrays import FloatArray
from dotsim_ros.gel.make import GelFrame
from dotsim_ros.geometry.pose import Pose, Wrench, compose, inverse
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.tasks.environments.geoms import indenter_of, pose_of

DAMPING_S = 2.0e-3
"""c: the gel's loss, as the time that its stiffness is multiplied by. Silicone loses some tenth of
the energy of a swing; without any a body on the gel would swing for ever."""
ALIGNED = 0.9
"""A geom that lies as it did, by the cosine of the angle between, comes to the gel from the same
side."""


@dataclass(frozen=True)
class _Anchor:
    """The last solution: the indenter's pose in the sensor's base frame, the wrench on it (6,)
    about that frame's origin, its stiffness (6, 6), and the skin (V, 3)."""

    pose: Pose
    wrench: FloatArray
    stiffness: FloatArray
    skin_m: FloatArray


class MujocoCoupling:
    """One sensor on one body, pressed by one geom.

    Args:
        model, data: MuJoCo's; the coupling writes `data.xfrc_applied` of the two bodies and leaves
            all else to the caller, who may set controls between steps.
        sensor: a tactile sensor; its indenter is replaced by the geom.
        sensor_body: name of the body that carries it.
        pressed_geom: name of the geom that presses it. MuJoCo must not make contacts of its own
            between the gel and this geom: give the sensor's body no geom where the gel is.
        mount: pose of the sensor's base frame in the frame of its body.
        coupling_s: longest time between two solutions of the gel.
        move_m: farthest that the geom moves on the gel between two.

    Raises:
        ValueError: no such body or geom, a geom that cannot press, or a coupling time that is not
            a multiple of MuJoCo's time step.
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
        self.model, self.data, self.sensor = model, data, sensor
        self._mount = Pose() if mount is None else mount
        self._sensor_body = _number(model, mujoco.mjtObj.mjOBJ_BODY, "body", sensor_body)
        self._geom = _number(model, mujoco.mjtObj.mjOBJ_GEOM, "geom", pressed_geom)
        self._pressed_body = int(model.geom_bodyid[self._geom])
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            raise ValueError(
                "the model's integrator is RK4, expected Euler, implicit or implicitfast: the "
                "gel's wrench is set between the two halves of a step"
            )
        self._step_s = float(model.opt.timestep)
        self._count = round(coupling_s / self._step_s)
        if self._count < 1 or abs(self._count * self._step_s - coupling_s) > 1e-9:
            raise ValueError(
                f"coupling_s is {coupling_s}, expected a multiple of MuJoCo's time step of "
                f"{self._step_s} s"
            )
        self.coupling_s, self._move_m = coupling_s, move_m
        self._away: FloatArray | None = None
        self.reset()

    def reset(self) -> GelFrame:
        """Forget what was pressed, and begin from where MuJoCo's bodies are now."""
        mujoco.mj_forward(self.model, self.data)
        base, geom = self.base_pose(), self._geom_pose()
        away = geom.rotation().T @ base.rotation()[:, 2]
        # To set an indenter takes as long as several solutions.
        if self._away is None or float(self._away @ away) < ALIGNED:
            indenter, self._placed = indenter_of(self.model, self._geom, away)
            self.sensor.set_indenter(indenter)
            self._away = away
        else:
            self.sensor.reset()
        self._before, self._waited_s = self.indenter_pose(), 0.0
        return self._solve(self._before)

    def base_pose(self) -> Pose:
        """Return the pose of the sensor's base frame in the world."""
        body = self._sensor_body
        return compose(pose_of(self.data.xpos[body], self.data.xmat[body]), self._mount)

    def indenter_pose(self) -> Pose:
        """Return the pose of the indenter in the sensor's base frame."""
        return compose(inverse(self.base_pose()), compose(self._geom_pose(), self._placed))

    def _geom_pose(self) -> Pose:
        return pose_of(self.data.geom_xpos[self._geom], self.data.geom_xmat[self._geom])

    def wrench(self) -> Wrench:
        """Return the wrench of the gel on the geom as it was solved last, sensor's base frame."""
        return Wrench(self._anchor.wrench[:3].copy(), self._anchor.wrench[3:].copy())

    def step(self) -> GelFrame:
        """Move the world on by `coupling_s`, and return the gel at its end.

        Raises:
            PressTooDeepError: the geom was pushed through the gel; its message has the depth. The
                world has moved on: reset it.
            GelFailureError: the gel could not be solved; the same.
            ValueError: MuJoCo's state is not finite.
        """
        for _ in range(self._count):
            mujoco.mj_step1(self.model, self.data)
            self._apply(self._predicted())
            mujoco.mj_step2(self.model, self.data)
            self._waited_s += self._step_s
        if not np.all(np.isfinite(self.data.qpos)):
            raise ValueError(
                "MuJoCo's state is not finite: the world is unstable without the gel, or its time "
                "step is too long; reset it"
            )
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        return self._solve(self.indenter_pose())

    def _solve(self, pose: Pose) -> GelFrame:
        frame = self.sensor.press(pose, self._waited_s or self._step_s)
        wrench = np.concatenate([frame.wrench.force_n, frame.wrench.torque_nm])
        stiffness = self.sensor.wrench_stiffness()
        self._anchor = _Anchor(pose, wrench, stiffness, frame.skin_position_m)
        self._waited_s = 0.0
        return frame

    def _predicted(self) -> FloatArray:
        """Return the wrench (6,) on the geom where it is now, sensor's base frame."""
        pose = self.indenter_pose()
        before, self._before = self._before, pose
        if self._is_due(pose):
            self._solve(pose)
        anchor = self._anchor
        if not anchor.wrench.any():
            return np.zeros(6)
        rate = twist(before, pose) / self._step_s
        moved = twist(anchor.pose, pose) + DAMPING_S * rate
        wrench = anchor.wrench - anchor.stiffness @ moved
        # The gel does not pull.
        if float(wrench[:3] @ anchor.wrench[:3]) <= 0.0:
            return np.zeros(6)
        return wrench

    def _is_due(self, pose: Pose) -> bool:
        """Return whether the gel must be solved before the coupling time is over."""
        anchor, indenter = self._anchor, self.sensor.indenter
        if anchor.wrench.any():
            moved = twist(anchor.pose, pose)
            at_contact = moved[:3] + np.cross(moved[3:], pose.position_m)
            return float(np.linalg.norm(at_contact)) > self._move_m
        local = (anchor.skin_m - pose.position_m) @ pose.rotation()
        lower, upper = indenter.bounds_m()
        near = np.all((local > lower) & (local < upper), axis=1)
        return bool(near.any()) and float(indenter.signed_distance(local[near]).min()) < 0.0

    def _apply(self, wrench: FloatArray) -> None:
        """Put a wrench (6,) on the geom's body, and its opposite on the sensor's."""
        base = self.base_pose()
        force = base.rotation() @ wrench[:3]
        torque = base.rotation() @ wrench[3:]
        for body, sign in ((self._pressed_body, 1.0), (self._sensor_body, -1.0)):
            lever = base.position_m - self.data.xipos[body]
            about = torque + np.cross(lever, force)
            self.data.xfrc_applied[body] = sign * np.concatenate([force, about])


def twist(before: Pose, after: Pose) -> FloatArray:
    """Return the motion (6,) of a body from one pose to another: translation (m) of the point at
    the origin of the frame, and rotation (rad) about it, for small rotations."""
    turned = after.rotation() @ before.rotation().T
    angle = 0.5 * np.array(
        [
            turned[2, 1] - turned[1, 2],
            turned[0, 2] - turned[2, 0],
            turned[1, 0] - turned[0, 1],
        ]
    )
    moved = after.position_m - turned @ before.position_m
    return np.concatenate([moved, angle])


def _number(model: mujoco.MjModel, kind: mujoco.mjtObj, word: str, name: str) -> int:
    number = mujoco.mj_name2id(model, kind, name)
    if number < 0:
        count = model.nbody if word == "body" else model.ngeom
        known = [mujoco.mj_id2name(model, kind, index) for index in range(count)]
        named = ", ".join(sorted(text for text in known if text)) or "none with a name"
        raise ValueError(f"the model has no {word} named {name!r}; it has {named}")
    return int(number)
