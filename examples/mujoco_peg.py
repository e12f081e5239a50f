# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""An arm in MuJoCo presses the sensor on a peg: python examples/mujoco_peg.py [OUT]."""

import sys
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from dotsim_ros import Pose, TactileSensor

LINK = '<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass="1"/>'
ARM = f"""<mujoco><default><joint axis="0 1 0" damping="5"/><position kp="1000"/></default>
<worldbody><body pos="0 0 .3" euler="0 -35 0"><joint name="base"/>{LINK}
<body pos=".2 0 0" euler="0 70 0"><joint name="elbow"/>{LINK}
<body pos=".2 0 0" euler="0 -35 0"><joint name="wrist"/><geom size=".02" mass=".3"/>
<site name="gel" pos="0 0 -.03" euler="180 0 0"/></body></body></body></worldbody><actuator>
<position joint="base"/><position joint="elbow"/><position joint="wrist"/></actuator></mujoco>"""
TIP_M, TIP_AXES = np.array([0.327, 0.0, 0.246]), np.diag([1.0, -1.0, -1.0])  # z away from the gel
STEP_S, LOWER_M_S, LOWER_S, END_S = 0.01, 0.02, 0.4, 0.9
sensor = TactileSensor.load("densetact2", indenter="sphere_4mm")
model, forces = mujoco.MjModel.from_xml_string(ARM), []
data = mujoco.MjData(model)
for time_s in np.arange(0.0, END_S, STEP_S):
    mujoco.mj_step(model, data, round(STEP_S / model.opt.timestep))
    mujoco.mj_forward(model, data)
    (move, turn), gel_m = np.zeros((2, 3, 3)), data.site("gel").xpos
    mujoco.mj_jacSite(model, data, move, turn, 0)
    hand = np.stack([move[0], move[2], turn[1]])  # x, z and the turn about y, by joint
    held = np.linalg.solve(hand.T, data.qfrc_bias - data.qfrc_actuator)
    data.ctrl += np.linalg.solve(hand, [0.0, -LOWER_M_S * STEP_S * (time_s < LOWER_S), 0.0])
    axes = data.site("gel").xmat.reshape(3, 3)
    turned = Rotation.from_matrix(axes.T @ TIP_AXES).as_quat()
    frame = sensor.step(Pose((TIP_M - gel_m) @ axes, turned), STEP_S)
    back, data.qfrc_applied[:] = (-axes @ frame.wrench.force_n, -axes @ frame.wrench.torque_nm), 0.0
    mujoco.mj_applyFT(model, data, *back, gel_m, model.nbody - 1, data.qfrc_applied)
    forces.append([time_s, *back[0], *back[1], *held])
out = Path(*sys.argv[1:2] or ["out/mujoco_peg"])
frame.save(out / "peg.png")
np.savetxt(out / "forces.csv", forces, "%.6f", ",")
print(f"the gel pushes back with {back[0][2]:.3f} N, the motors hold {held[1]:.3f} N")
