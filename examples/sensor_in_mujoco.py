# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Put the sensor on a body of a MuJoCo world: python examples/sensor_in_mujoco.py [OUT]."""

import sys
from pathlib import Path

import mujoco

import dotsim_ros
from dotsim_ros.control.environments.coupling import MujocoCoupling

WORLD = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="finger" pos="0 0 0.1"/>
    <body name="ball" pos="0 0 0.122">
      <joint type="slide" axis="0 0 1"/>
      <geom name="ball" type="sphere" size="0.006" mass="0.03"/>
    </body>
  </worldbody>
</mujoco>
"""


def main(out: Path) -> None:
    model = mujoco.MjModel.from_xml_string(WORLD)
    data = mujoco.MjData(model)
    sensor = dotsim_ros.TactileSensor.load("densetact2")
    coupling = MujocoCoupling(model, data, sensor, sensor_body="finger", pressed_geom="ball")
    for _ in range(40):
        gel = coupling.step()
    print(f"the gel carries {gel.wrench.force_n[2]:.3f} N, the ball weighs {0.03 * 9.81:.3f} N")
    sensor.see(gel, coupling.indenter_pose()).save(out / "touch.png")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/sensor_in_mujoco"))
