# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Kinematics of the UFACTORY xArm 7: where its tool is, and which joint rates move it as is wanted.

The modified Denavit-Hartenberg parameters are those that UFACTORY publishes ("Kinematic and Dynamic
Parameters of xArm 7", docs.ufactory.cc); the joints' limits are those of its description for ROS
(xArm-Developer/xarm_ros2, xarm_description, macro `xarm7_urdf`). Pinocchio computes the chain
(Carpentier et al., "The Pinocchio C++ library", SII 2019). The tool's frame is that of the flange,
`link_eef` there: at zero joints 206 mm before and 120.5 mm above the base's origin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dotsim_ros.control.arm.command import Twist
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray

try:
    import pinocchio
except ModuleNotFoundError:
    pinocchio = None


@dataclass(frozen=True)
class Joint:
    """A revolute joint by the modified Denavit-Hartenberg convention (Craig).

    Attributes:
        twist_rad: angle from the axis before to this one, about the common normal.
        length_m: between the two axes, along the common normal.
        offset_m: along this joint's axis.
    """

    name: str
    twist_rad: float
    length_m: float
    offset_m: float
    lower_rad: float
    upper_rad: float


RIGHT = np.pi / 2.0
TURN = 2.0 * np.pi
XARM7 = (
    Joint("joint1", 0.0, 0.0, 0.267, -TURN, TURN),
    Joint("joint2", -RIGHT, 0.0, 0.0, -2.059, 2.0944),
    Joint("joint3", RIGHT, 0.0, 0.293, -TURN, TURN),
    Joint("joint4", RIGHT, 0.0525, 0.0, -0.19198, 3.927),
    Joint("joint5", RIGHT, 0.0775, 0.3425, -TURN, TURN),
    Joint("joint6", RIGHT, 0.0, 0.0, -1.69297, np.pi),
    Joint("joint7", -RIGHT, 0.076, 0.097, -TURN, TURN),
)
JOINT_NAMES = tuple(joint.name for joint in XARM7)
COMFORTABLE_JOINTS_RAD = np.array([0.0, -0.3, 0.0, 0.8, 0.0, 1.1, 0.0])
"""Elbow up, tool down, each joint far from its limits and the arm far from singular."""

REACH_M = 0.3
"""Makes angles and lengths comparable: the arm's typical distance from a joint to the tool."""
SINGULAR_M = 0.04
"""Below this singular value of the scaled Jacobian a direction is being lost; the comfortable
posture has 0.17."""
DAMPING_M = 0.04
STOPPING_S = 0.1
"""A joint may be as fast as would take it to its limit in this time, so it comes to rest there."""
POSTURE_RATE_PER_S = 0.5
POSTURE_SHARE = 0.5
"""The elbow's own motion is at most this share of the joints' motion for the tool: where the tool
stands, everything stands."""

POSITION_TOLERANCE_M = 1e-6
ANGLE_TOLERANCE_RAD = 1e-6
ITERATION_COUNT = 200
LARGEST_STEP_RAD = 0.3
START_COUNT = 40


def check_pinocchio() -> None:
    """Raise ValueError where Pinocchio, which comes with the extra `arm`, is not installed."""
    if pinocchio is None:
        raise ValueError(
            "the simulated arm needs the package pin, which is not installed: "
            "pip install 'dotsim_ros[arm]'"
        )


@dataclass(frozen=True)
class JointMotion:
    """Joint rates (7,) that move the tool.

    Attributes:
        slowed: by how much all of them were reduced for the fastest joint, 1 where not.
        at_limit: joints that their limit holds back, by index.
        smallest_m: smallest singular value of the scaled Jacobian; near 0 the arm is singular.
    """

    rates_rad_s: FloatArray
    slowed: float
    at_limit: tuple[int, ...]
    smallest_m: float


class ArmKinematics:
    """The chain of the arm. Not for several threads at once.

    Attributes:
        posture_rad: (7,) what the elbow goes back to while the tool moves.

    Raises:
        ValueError: Pinocchio is not installed.
    """

    def __init__(self, *, joint_speed_rad_s: float = 4.0) -> None:
        check_pinocchio()
        self._model = _model_of(XARM7)
        self._data = self._model.createData()
        self._tool = len(XARM7)
        self.lower_rad = np.array([joint.lower_rad for joint in XARM7])
        self.upper_rad = np.array([joint.upper_rad for joint in XARM7])
        self.joint_speed_rad_s = joint_speed_rad_s
        self.posture_rad = COMFORTABLE_JOINTS_RAD

    def pose(self, joints_rad: FloatArray) -> Pose:
        """Return the tool's pose in the base."""
        pinocchio.forwardKinematics(self._model, self._data, joints_rad)
        placement = self._data.oMi[self._tool]
        quaternion = np.array(pinocchio.Quaternion(placement.rotation).coeffs())
        return Pose(np.array(placement.translation), quaternion)

    def jacobian(self, joints_rad: FloatArray) -> FloatArray:
        """Return the (6, 7) derivative of the tool's motion, linear (m), then angular (rad).

        Both along the base's axes; the linear part is that of the tool's origin.
        """
        return self.jacobian_and_rotation(joints_rad)[0]

    def jacobian_and_rotation(self, joints_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the Jacobian and the (3, 3) rotation from the tool to the base."""
        pinocchio.computeJointJacobians(self._model, self._data, joints_rad)
        jacobian = pinocchio.getJointJacobian(
            self._model, self._data, self._tool, pinocchio.LOCAL_WORLD_ALIGNED
        )
        return np.array(jacobian), np.array(self._data.oMi[self._tool].rotation)

    def motion(self, joints_rad: FloatArray, jacobian: FloatArray, twist: Twist) -> JointMotion:
        """Return the joint rates whose tool motion comes closest to a velocity.

        Directions that the arm is about to lose are damped, each by itself (Chiaverini,
        "Singularity-robust task-priority redundancy resolution for real-time kinematic control of
        robot manipulators", 1997); a joint that its limit holds back is left out and the others
        make up for it; where one would be too fast, all are slowed alike.
        """
        slowest = np.minimum((self.lower_rad - joints_rad) / STOPPING_S, 0.0)
        fastest = np.maximum((self.upper_rad - joints_rad) / STOPPING_S, 0.0)
        rates, smallest_m, elbow = _damped(jacobian, twist)
        rates += self._posture_rates(joints_rad, rates, elbow)
        free = np.ones(len(rates), dtype=bool)
        while (beyond := np.maximum(slowest - rates, rates - fastest) * free).max() > 1e-12:
            worst = int(np.argmax(beyond))
            free[worst] = False
            rates[worst] = np.clip(rates[worst], slowest[worst], fastest[worst])
            if not free.any():
                break
            rest = twist - jacobian[:, ~free] @ rates[~free]
            rates[free], smallest_m, _ = _damped(jacobian[:, free], rest)
        slowed = min(1.0, self.joint_speed_rad_s / max(float(np.abs(rates).max()), 1e-12))
        return JointMotion(rates * slowed, slowed, tuple(np.flatnonzero(~free)), smallest_m)

    def joints_at(self, pose: Pose) -> FloatArray:
        """Return (7,) joints that put the tool at a pose in the base, looked for from the posture
        first.

        Raises:
            ValueError: no start led there; says how close the best one came.
        """
        random = np.random.default_rng(0)
        low, high = np.maximum(self.lower_rad, -np.pi), np.minimum(self.upper_rad, np.pi)
        start = self.posture_rad
        closest = (np.inf, np.inf)
        for _ in range(START_COUNT):
            joints, error = self._searched(pose, start)
            away = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
            if away[0] < POSITION_TOLERANCE_M and away[1] < ANGLE_TOLERANCE_RAD:
                return joints
            closest = min(closest, away, key=lambda each: each[0] + REACH_M * each[1])
            start = random.uniform(low, high)
        raise ValueError(
            f"the arm does not reach the pose {np.round(pose.position_m, 4).tolist()} m, "
            f"{np.round(pose.quaternion_xyzw, 4).tolist()}: the closest that was found is "
            f"{1e3 * closest[0]:.1f} mm and {np.rad2deg(closest[1]):.2f} degrees away; choose one "
            "within some 0.6 m of the shoulder, which is 0.267 m above the base"
        )

    def _posture_rates(
        self, joints_rad: FloatArray, rates: FloatArray, elbow: FloatArray
    ) -> FloatArray:
        """Return the motion of the elbow back to its posture, which leaves the tool where it is."""
        wanted = POSTURE_RATE_PER_S * float(elbow @ (self.posture_rad - joints_rad))
        largest = POSTURE_SHARE * float(np.linalg.norm(rates))
        return elbow * np.clip(wanted, -largest, largest)

    def _searched(self, pose: Pose, start: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the joints that Newton's method ends at, and their (6,) error."""
        joints = np.clip(start, self.lower_rad, self.upper_rad)
        wanted = Rotation.from_quat(pose.quaternion_xyzw)
        for _ in range(ITERATION_COUNT):
            present = self.pose(joints)
            turn = wanted * Rotation.from_quat(present.quaternion_xyzw).inv()
            error = np.concatenate([pose.position_m - present.position_m, turn.as_rotvec()])
            if np.abs(error).max() < 0.1 * min(POSITION_TOLERANCE_M, ANGLE_TOLERANCE_RAD):
                break
            step, _, _ = _damped(self.jacobian(joints), error)
            step *= min(1.0, LARGEST_STEP_RAD / max(float(np.abs(step).max()), 1e-12))
            joints = np.clip(joints + step, self.lower_rad, self.upper_rad)
        return joints, error


def _model_of(joints: tuple[Joint, ...]) -> pinocchio.Model:
    model = pinocchio.Model()
    index = 0
    for joint in joints:
        rotation = pinocchio.utils.rotate("x", joint.twist_rad)
        offset = rotation @ np.array([joint.length_m, 0.0, joint.offset_m])
        placement = pinocchio.SE3(rotation, offset)
        index = model.addJoint(index, pinocchio.JointModelRZ(), placement, joint.name)
    return model


def _damped(jacobian: FloatArray, twist: Twist) -> tuple[FloatArray, float, FloatArray]:
    """Return damped rates for a motion, the smallest singular value, and the last right vector.

    The last right vector is, of a (6, 7) Jacobian, the motion of the joints that the tool does not
    take part in.
    """
    scale = np.array([1.0, 1.0, 1.0, REACH_M, REACH_M, REACH_M])
    left, values, right = np.linalg.svd(jacobian * scale[:, None])
    shortage = np.clip(1.0 - (values / SINGULAR_M) ** 2, 0.0, 1.0)
    gains = values / (values**2 + DAMPING_M**2 * shortage)
    count = len(values)
    rates = right[:count].T @ (gains * (left.T @ (scale * twist))[:count])
    return np.asarray(rates), float(values[-1]), np.asarray(right[-1])
