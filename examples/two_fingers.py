# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Grip a ball or a box with two sensors in MuJoCo, lift it, turn it by 90 degrees and hold it.

You learn how several sensors share one world: each step of a `MujocoGripper` moves the world once,
with the forces of all gels on the object and on the fingers. MuJoCo itself sees no contact between
fingers and object, so the friction of the gels is all that holds it. Writes grip.png, the change
of both sensors' images by the grip, six times as strong.

python examples/two_fingers.py [OUT [ball|box [SECONDS]]]
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np

from dotsim_ros import TactileSensor
from dotsim_ros.control.environments.coupling import Finger, MujocoGripper

OBJECTS = {"ball": 'type="sphere" size=".005"', "box": 'type="box" size=".005 .005 .005"'}
WEIGHT_N = 0.05 * 9.81
WORLD = """
<mujoco>
  <option timestep="0.00025" integrator="implicitfast"/>
  <worldbody>
    <geom type="plane" size="1 1 .1"/>
    <body name="object" pos="0 0 .005">
      <freejoint/>
      <geom name="object" {shape} mass=".05"/>
    </body>
    <body pos="0 0 .005" gravcomp="1">
      <joint name="lift" type="slide" axis="0 0 1"/>
      <joint name="turn" axis="1 0 0"/>
      <inertial pos="0 0 0" mass=".5" diaginertia="1e-3 1e-3 1e-3"/>
      <body name="left" pos="-.01 0 0" zaxis="1 0 0" gravcomp="1">
        <joint name="left" type="slide" axis="0 0 1"/>
        <inertial pos="0 0 0" mass=".1" diaginertia="1e-5 1e-5 1e-5"/>
      </body>
      <body name="right" pos=".01 0 0" zaxis="-1 0 0" gravcomp="1">
        <joint name="right" type="slide" axis="0 0 1"/>
        <inertial pos="0 0 0" mass=".1" diaginertia="1e-5 1e-5 1e-5"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="lift" kp="5000" dampratio="1"/>
    <position joint="turn" kp="20" dampratio="1"/>
    <position joint="left" kp="1000" dampratio="1"/>
    <position joint="right" kp="1000" dampratio="1"/>
  </actuator>
</mujoco>
"""
# When each move begins and ends, as a share of the run: lift (m), turn (rad), left and right (m).
MOVES = [(0.15, 0.35, 0.03), (0.45, 0.75, np.pi / 2), (0.0, 0.1, 0.0025), (0.0, 0.1, 0.0025)]
REPORTS = {0.45: "lifted", 0.85: "turned", 1.0: "held"}


def main(folder: Path, name: str, seconds: float) -> None:
    model = mujoco.MjModel.from_xml_string(WORLD.format(shape=OBJECTS[name]))
    data = mujoco.MjData(model)
    fingers = [
        Finger(TactileSensor.load("gelsight_mini"), side, "object") for side in ("left", "right")
    ]
    gripper = MujocoGripper(model, data, fingers)
    count = round(seconds / gripper.coupling_s)
    for step in range(1, count + 1):
        for motor, (start, end, way) in enumerate(MOVES):
            share = np.clip((step / count - start) / (end - start), 0.0, 1.0)
            data.ctrl[motor] = way * share**2 * (3.0 - 2.0 * share)
        gels = gripper.step()
        for share, word in REPORTS.items():
            if step == round(share * count):
                report(word, gripper)
    changes = []
    for finger, gel in zip(gripper.fingers, gels, strict=True):
        image = finger.sensor.see(gel, finger.indenter_pose()).image
        change = image.astype(float) - finger.sensor.idle_image
        changes.append(np.clip(128.0 + 6.0 * change, 0.0, 255.0).astype(np.uint8))
    folder.mkdir(parents=True, exist_ok=True)
    plt.imsave(folder / "grip.png", np.hstack(changes))


def report(word: str, gripper: MujocoGripper) -> None:
    """Print what holds the object, and where it is."""
    data, fingers = gripper.data, gripper.fingers
    force_n = sum(finger.base_pose().rotation() @ finger.wrench().force_n for finger in fingers)
    squeeze_n = np.array([finger.wrench().force_n[2] for finger in fingers])
    place_mm = 1e3 * fingers[0].indenter_pose().position_m[:2]
    axes = data.geom("object").xmat.reshape(3, 3)
    print(
        f"{word} after {data.time:.2f} s, {data.ncon} contacts in MuJoCo\n"
        f"  gels on the object, in the world: {force_n.round(4)} N; it weighs {WEIGHT_N:.4f} N\n"
        f"  squeezed with {squeeze_n.round(3)} N, at {place_mm.round(4)} mm on the left gel, "
        f"turned by {np.degrees(np.arctan2(axes[2, 1], axes[2, 2])):.2f} degrees"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", nargs="?", type=Path, default=Path("out/two_fingers"))
    parser.add_argument("object", nargs="?", choices=OBJECTS, default="ball")
    parser.add_argument("seconds", nargs="?", type=float, default=10.0)
    given = parser.parse_args()
    main(given.out, given.object, given.seconds)
