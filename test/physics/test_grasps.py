# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Friction alone holds what is gripped, and there is none without it."""

from dataclasses import replace

import numpy as np
import pytest

from dotsim_ros.geometry.indenter import box
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import SolverSpecification, load_sensor
from studies.grasps import GRIPPED_S, LIFT_M, MOVES, OBJECTS, Grasp, coarse_sensor


def test_a_light_ball_is_lifted_and_no_energy_grows() -> None:
    sensors = [TactileSensor.load(coarse_sensor()) for _ in range(2)]
    grasp = Grasp(OBJECTS["ball"], sensors, MOVES)
    heights_m, work_j = [], []
    while grasp.data.time < 0.3 - 1e-9:
        grasp.step()
        work_j.append(sum(finger.work_j for finger in grasp.gripper.fingers))
        if grasp.data.time > GRIPPED_S - 1e-9:
            heights_m.append(float(grasp.place()[0][2]))
    assert grasp.data.ncon == 0
    assert grasp.data.body("object").xpos[2] > 0.02
    assert np.ptp(heights_m) < 0.02e-3
    # The gels are still pressed: their losses and what they keep are both what they were given.
    assert max(work_j) <= 0.0
    assert work_j[-1] < -0.02e-3
    lost_j, lifting_j = np.array(grasp.lost_j), grasp.mass_kg * 9.81 * LIFT_M
    assert (np.maximum.accumulate(lost_j) - lost_j).max() < 0.01 * lifting_j


@pytest.mark.parametrize(("friction", "least", "most"), [(0.0, 0.0, 1e-3), (0.4, 0.3, 0.41)])
def test_a_tilted_plate_drags_the_gel_by_friction_alone(
    friction: float, least: float, most: float
) -> None:
    dome = load_sensor("densetact2")
    dome = replace(
        dome,
        contact=replace(dome.contact, friction_coefficient=friction),
        solver=SolverSpecification(grid_spacing_m=3.6e-3, refined=False),
    )
    sensor = TactileSensor.load(dome, indenter=box(np.array([0.08, 0.08, 0.01]), 0.3e-3))
    tilted = Pose(np.zeros(3), np.array([np.sin(0.1), 0.0, 0.0, np.cos(0.1)]))
    along, across, normal = tilted.rotation().T
    for slid_mm in (0.0, 0.5, 1.0):
        place_m = (sensor.skin.apex_m[2] - 0.4e-3) * normal + 1e-3 * slid_mm * along
        force_n = sensor.press(replace(tilted, position_m=place_m)).wrench.force_n
    assert normal @ force_n > 0.3
    share = np.hypot(along @ force_n, across @ force_n) / (normal @ force_n)
    assert least <= share <= most
