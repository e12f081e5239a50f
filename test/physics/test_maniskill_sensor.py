# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The sensor in ManiSkill's own environment on the CPU, against an array with the same poses."""

import numpy as np
import pytest

pytest.importorskip("mani_skill", reason="mani_skill is not installed")

import sapien
import torch
from mani_skill.envs.sapien_env import BaseEnv

from dotsim_ros.control.environments.collision_shapes import indenter_of
from dotsim_ros.control.environments.maniskill_sensor import TactileSensor, TactileSensorConfig
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.tactile_array import TactileArray

MOUNT_M = 0.01
RADIUS_M = 0.004
FINGER = sapien.Pose([0.1, 0.2, 0.3], np.sqrt([0.5, 0.0, 0.5, 0.0]))
"""It lies on its side: its gel looks along the world's x."""
UPRIGHT = sapien.Pose([0.1, 0.2, 0.3])
SHAPES = {
    "ball": lambda b: b.add_sphere_collision(radius=RADIUS_M, density=1e6),
    "box": lambda b: b.add_box_collision(half_size=[0.005, 0.003, 0.002]),
    "rod": lambda b: b.add_cylinder_collision(
        sapien.Pose([0.0, 0.0, 0.001]), radius=0.003, half_length=0.005
    ),
    "pill": lambda b: b.add_capsule_collision(radius=0.003, half_length=0.002),
}


class Touching(BaseEnv):
    """A finger without a collision shape, and bodies of which one presses it."""

    def __init__(self, finger=FINGER):
        self._finger_pose = finger
        super().__init__(
            robot_uids=None,
            obs_mode="state_dict",
            reward_mode="none",
            sim_backend="physx_cpu",
            render_backend="none",
            sim_config={"sim_freq": 250, "control_freq": 50},
        )

    def _load_agent(self, options):
        self.agent = None

    def _load_scene(self, options):
        builder = self.scene.create_actor_builder()
        builder.initial_pose = self._finger_pose
        self.finger = builder.build_kinematic("finger")
        self.bodies = {}
        for number, (name, add) in enumerate(SHAPES.items()):
            builder = self.scene.create_actor_builder()
            add(builder)
            builder.initial_pose = sapien.Pose([1.0, number, 0.0])
            make = builder.build if name == "ball" else builder.build_kinematic
            self.bodies[name] = make(name)
        self.touch = TactileSensor(
            TactileSensorConfig(
                "touch",
                body=self.finger,
                pressed=self.bodies["ball"],
                mount=Pose(np.array([0.0, 0.0, MOUNT_M])),
            )
        )

    def place(self, height_m):
        """Put the ball's middle on the sensor's axis, above its base."""
        pose = self._finger_pose * sapien.Pose([0.0, 0.0, MOUNT_M + height_m])
        self.bodies["ball"].set_pose(pose)

    def _initialize_episode(self, env_idx, options):
        self.place(0.05)
        self.touch.reset(env_idx)

    def _get_obs_agent(self):
        return {}

    def _get_obs_extra(self, info):
        self.touch.capture()
        return {"touch": self.touch.get_obs()}

    def _before_simulation_step(self):
        self.touch.capture()
        self.touch.push()

    def evaluate(self):
        return {}

    def get_state_dict(self):
        return {}


@pytest.fixture(scope="module")
def environment():
    return Touching()


def test_an_observation_is_what_its_pose_gives(environment):
    array = TactileArray("densetact2", 1, {"kind": "sphere", "radius_m": RADIUS_M})
    apex_m = float(array.rest_position_m[:, 2].max())
    for depth_m in (5e-4, 1e-3):
        environment.place(apex_m + RADIUS_M - depth_m)
        seen = environment.get_obs()["extra"]["touch"]
        right = array.step([[0.0, 0.0, apex_m - depth_m]], [[0.0, 0.0, 0.0, 1.0]])
        newtons = right.force_n.norm()
        assert newtons > 0.1
        torch.testing.assert_close(seen["force_n"], right.force_n, atol=0.02 * newtons, rtol=0.0)
        torch.testing.assert_close(
            seen["depth_m"], right.depth_m, atol=2e-5, rtol=0, equal_nan=True
        )
    pressed = environment.touch.get_images()
    seen = environment.reset()[0]["extra"]["touch"]
    assert not seen["force_n"].any()
    assert not torch.equal(environment.touch.get_images(), pressed)


def test_a_ball_lies_on_the_gel():
    environment = Touching(UPRIGHT)
    ball = environment.bodies["ball"]
    ball.set_linear_damping(80.0)
    weight_n = 9.81 * float(ball.mass[0])
    apex_m = float(environment.touch.array.rest_position_m[:, 2].max())
    environment.place(apex_m + RADIUS_M - 1.8e-3)
    for _ in range(5):
        environment.step(None)
    force = environment.touch.get_obs()["force_n"][0]
    np.testing.assert_allclose(force.numpy(), [0.0, 0.0, weight_n], atol=0.05 * weight_n)


@pytest.mark.parametrize(
    ("name", "beside_m"),
    [
        ("ball", [[0.005, 0.0, 0.0], [0.0, 0.0, -0.005]]),
        ("box", [[0.006, 0.0, 0.0], [0.0, 0.004, 0.0], [0.0, 0.0, -0.003]]),
        ("rod", [[0.006, 0.0, 0.001], [0.0, 0.004, 0.001], [0.0, 0.0, 0.005]]),
        ("pill", [[0.006, 0.0, 0.0], [0.0, 0.0, 0.004]]),
    ],
)
def test_a_shape_is_where_the_body_has_it(environment, name, beside_m):
    indenter, placed = indenter_of(environment.bodies[name], np.array([0.6, 0.0, -0.8]))
    distance_m = indenter.distance_from(np.array(beside_m), placed)
    np.testing.assert_allclose(distance_m, 1e-3, atol=1e-5)


def test_a_body_without_a_shape_is_named(environment):
    with pytest.raises(ValueError, match="finger has no collision shape, expected a sphere"):
        indenter_of(environment.finger, np.array([0.0, 0.0, 1.0]))
