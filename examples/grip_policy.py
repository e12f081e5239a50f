# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Train a policy that holds an unknown mass without slip, and squeezes little harder than it must.

You learn how touches train a policy that a world of MuJoCo judges. From slides a network learns, by
the skin's motion alone, what share of the friction is in use; the policy changes the grip until it
is 70 %. Then unseen objects hang on it within half a second: on one finger, by symmetry, with half.

python examples/grip_policy.py [OUT [TOUCHES [OBJECTS]]]
"""

import argparse
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import torch
from torch.nn import Linear, Sequential, Tanh

from dotsim_ros import TactileSensor
from dotsim_ros.control.environments.coupling import MujocoCoupling
from dotsim_ros.gel.make import skin_of
from dotsim_ros.io.progress import PrintedProgress
from dotsim_ros.learning.slip import SKIN_NOISE_M, touches_in
from dotsim_ros.learning.touches.plan import read_plan
from dotsim_ros.learning.touches.run import make_touches

BALL, ROLLER = 'type="sphere" size=".006"', 'type="capsule" size=".005 .006" euler="90 0 0"'
OBJECTS = [(0.2, BALL), (0.04, BALL), (0.1, ROLLER), (0.15, ROLLER), (0.06, BALL), (0.12, BALL)]
WORLD = """
<mujoco><option timestep=".0005" gravity="0 0 0"/>
  <worldbody><body name="finger" pos="0 0 -.004"/><body pos="0 0 .0061">
    <joint name="fall" type="slide" axis="0 -1 0"/>
    <joint name="close" type="slide" axis="0 0 -1" armature=".05" damping="20"/>
    <geom name="object" mass="{mass_kg}" {shape}/>
  </body></worldbody>
  <actuator><general joint="fall"/>
    <general joint="close" dyntype="filterexact" dynprm=".02"/></actuator></mujoco>
"""


def features(moved_mm):
    """Return (N, 4): logarithms of the skin's shear, in all and where it is deepest, and depth."""
    depth, across = np.maximum(-moved_mm[..., 2], 0.0), moved_mm[..., :2]
    deepest = np.quantile(depth, 0.995, axis=1)
    weight = np.maximum(depth - 0.5 * deepest[:, None], 0.0)[..., None]
    ways = across.mean(axis=1), (weight * across).sum(axis=1) / weight.sum(axis=1)
    sizes = [*np.linalg.norm(ways, axis=2), depth.mean(axis=1), deepest]
    return torch.tensor(np.log(np.stack(sizes, axis=1) + 1e-3)).float()


def learn(moved_mm, shares, steps):
    """Return a policy: the next grip (N) by the skin's motion (V, 3) and the last grip."""
    torch.manual_seed(0)
    given, wanted = features(moved_mm), torch.tensor(shares).float()
    network = Sequential(Linear(4, 32), Tanh(), Linear(32, 32), Tanh(), Linear(32, 1))
    descent = torch.optim.AdamW(network.parameters(), 1e-2)
    for _ in range(steps):
        descent.zero_grad()
        torch.mean((network(given)[:, 0] - wanted) ** 2).backward()
        descent.step()

    def policy(moved_mm, grip_n):
        share = network(features(moved_mm[None])).item()
        return float(np.clip(grip_n * np.clip(share / 0.7, 0.95, 1.3), 0.3, 4.0))

    return policy


def hold(sensor, mass_kg, shape, policy):
    """Return whether an object slid by less than 1 mm, and the grip at the end over its weight."""
    world = WORLD.format(shape=shape, mass_kg=0.5 * mass_kg)
    data = mujoco.MjData(mujoco.MjModel.from_xml_string(world))
    bodies = {"sensor_body": "finger", "pressed_geom": "object", "coupling_s": 0.02}
    coupling = MujocoCoupling(data.model, data, sensor, **bodies)
    random, grip_n, weight_n = np.random.default_rng(0), 0.5, 0.5 * mass_kg * 9.81
    while data.time < 1.1 and data.qpos[0] < 3e-3:
        data.ctrl[:] = weight_n * np.clip((data.time - 0.3) / 0.5, 0.0, 1.0), grip_n
        moved_m = coupling.step().skin_position_m - sensor.skin.rest_position_m
        moved_m += SKIN_NOISE_M * random.standard_normal(moved_m.shape)
        grip_n = policy(1e3 * moved_m, grip_n)
    return data.qpos[0] < 1e-3, grip_n / weight_n


def main(out: Path, count: int, objects: int) -> None:
    plan = read_plan(Path(__file__).parent / "grip_touches.yaml")
    make_touches(plan, out, count=count, kind="webdataset", progress=PrintedProgress())
    touches = list(touches_in(out, skin_of(plan.sensor.gel).rest_position_m))
    force_n = np.abs(np.concatenate([touch.force_n for touch in touches]))
    pressed = force_n[:, 2] > 0.1
    moved_mm = 1e3 * np.concatenate([touch.moved_m for touch in touches])[pressed]
    friction = plan.sensor.contact.friction_coefficient
    shares = np.hypot(*force_n[pressed, :2].T) / (friction * force_n[pressed, 2])
    least_n = [0.5 * 9.81 * mass_kg / friction for mass_kg, _ in OBJECTS]
    policies = {
        "trained": learn(moved_mm, np.minimum(shares, 1.0), steps=1000),
        "untrained": learn(moved_mm, shares, steps=0),
        "constant, for the middle": lambda *_: 1.2 * np.median(least_n),
        "constant, for the heaviest": lambda *_: 1.2 * max(least_n),
    }
    solver = replace(plan.sensor.solver, refined=False)  # as touches are made
    sensor = TactileSensor.load(replace(plan.sensor, solver=solver))
    for name, policy in policies.items():
        ends = np.array([hold(sensor, *what, policy) for what in OBJECTS[:objects]])
        held, over = ends.sum(axis=0) * [1.0, friction / len(ends)]
        print(f"{name}: {held:.0f} of {len(ends)} held, {over:.2f} of the least force")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", nargs="?", type=Path, default=Path("out/grip"))
    parser.add_argument("touches", nargs="?", type=int, default=60)
    parser.add_argument("objects", nargs="?", type=int, default=len(OBJECTS))
    given = parser.parse_args()
    try:
        main(given.out, given.touches, given.objects)
    except (OSError, ValueError) as error:
        parser.error(str(error))
