# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The sensor in mjlab's own scene and simulation, against an array that is given the same poses."""

import numpy as np
import pytest

pytest.importorskip("mjlab", reason="mjlab is not installed")

import mujoco
import torch
from mjlab.entity import EntityCfg
from mjlab.scene import Scene, SceneCfg
from mjlab.sim import MujocoCfg, Simulation, SimulationCfg

from dotsim_ros.control.environments.mjlab_sensor import TactileSensorCfg
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.tactile_array import TactileArray

# The finger lies on its side: its gel looks along the world's x.
SIDEWAYS = np.sqrt([0.5, 0.0, 0.5, 0.0])
MOUNT_M = 0.01
WORLD = f"""
<mujoco>
  <worldbody>
    <body name="finger" pos="0.1 0.2 0.3" quat="{" ".join(map(str, SIDEWAYS))}">
      <inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>
    </body>
    <body name="peg" pos="0.16 0.2 0.3">
      <joint name="slide" type="slide" axis="-1 0 0" damping="60"/>
      <geom name="tip" type="sphere" size="0.004" mass="0.2" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><position joint="slide" kp="3000"/></actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def world():
    """Return scene, simulation and sensor of two worlds."""
    touch = TactileSensorCfg(
        "touch",
        body="hand/finger",
        pressed_geom="hand/tip",
        mount=Pose(np.array([0.0, 0.0, MOUNT_M])),
    )
    entity = EntityCfg(spec_fn=lambda: mujoco.MjSpec.from_string(WORLD))
    scene = Scene(SceneCfg(num_envs=2, entities={"hand": entity}, sensors=(touch,)), "cpu")
    settings = SimulationCfg(mujoco=MujocoCfg(timestep=0.004, gravity=(0.0, 0.0, 0.0)))
    simulation = Simulation(num_envs=2, cfg=settings, spec=scene.spec, device="cpu")
    scene.initialize(simulation.mj_model, simulation.model, simulation.data)
    return scene, simulation, scene["touch"]


def slide_to(depth_m, sensor):
    """Return the joint's values at which the ball would lie as deep in the gel at rest."""
    apex_m = float(sensor.array.rest_position_m[:, 2].max())
    return 0.06 - MOUNT_M - apex_m - 0.004 + torch.tensor(depth_m)[:, None]


def test_each_world_gives_what_its_pose_gives(world):
    scene, simulation, sensor = world
    array = TactileArray("densetact2", 2, {"kind": "sphere", "radius_m": 0.004})
    apex_m = float(array.rest_position_m[:, 2].max())
    for depth_m in ([5e-4, -1e-3], [1e-3, 8e-4]):
        simulation.data.qpos[:] = slide_to(depth_m, sensor)
        simulation.forward()
        scene.update(0.004)
        frame = sensor.data
        place_m = [[0.0, 0.0, apex_m - depth] for depth in depth_m]
        right = array.step(place_m, [[0.0, 0.0, 0.0, 1.0]] * 2)
        newtons = right.force_n.norm(dim=1).max()
        assert newtons > 0.1
        # A sphere may come turned, and the solver then ends a little elsewhere.
        torch.testing.assert_close(frame.force_n, right.force_n, atol=0.02 * newtons, rtol=0.0)
        torch.testing.assert_close(frame.depth_m, right.depth_m, atol=2e-5, rtol=0, equal_nan=True)
    pressed = sensor.image()
    scene.reset(torch.tensor([0]))
    simulation.data.qpos[:] = slide_to([-2e-3, 8e-4], sensor)
    simulation.forward()
    scene.update(0.004)
    assert not sensor.data.force_n[0].any()
    assert not torch.equal(sensor.image()[0], pressed[0])
    torch.testing.assert_close(sensor.data.force_n[1], frame.force_n[1], rtol=0.02, atol=2e-3)


def test_a_push_is_what_the_actuator_holds(world):
    scene, simulation, sensor = world
    scene.reset()
    simulation.reset()
    simulation.data.qpos[:] = slide_to([-2e-4, -2e-4], sensor)
    simulation.data.ctrl[:] = slide_to([1.5e-3, 1e-3], sensor)
    for _ in range(30):
        simulation.step()
        scene.update(0.004)
        sensor.push()
    assert simulation.data.qvel[:].abs().max() < 2e-3
    peg, finger = (
        simulation.data.xfrc_applied[:, simulation.mj_model.body(name).id, 0]
        for name in ("hand/peg", "hand/finger")
    )
    assert peg.min() > 0.5
    torch.testing.assert_close(simulation.data.qfrc_actuator[:, 0], peg, rtol=0.02, atol=0.0)
    torch.testing.assert_close(finger, -peg)


def test_what_is_not_in_the_scene_is_named():
    entity = EntityCfg(spec_fn=lambda: mujoco.MjSpec.from_string(WORLD))
    touch = TactileSensorCfg("touch", body="hand/thumb", pressed_geom="hand/tip")
    with pytest.raises(ValueError, match=r"no body named 'hand/thumb'; it has .*hand/finger"):
        Scene(SceneCfg(num_envs=1, entities={"hand": entity}, sensors=(touch,)), "cpu")
