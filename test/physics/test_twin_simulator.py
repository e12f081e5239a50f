# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A gel that is kept, or stretched, from one press to the next answers as one made for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dotsim_ros.gel.make import skin_of
from dotsim_ros.gel.material import PronySeries
from dotsim_ros.gel.values import GelValues, values_of
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.specification import GelSpecification, SensorSpecification, SolverSpecification
from dotsim_ros.twin.follow import SimulatedPress
from dotsim_ros.twin.simulator import GelSimulator

SENSOR = replace(
    SensorSpecification(), solver=SolverSpecification(grid_spacing_m=3.6e-3, refined=False)
)
SKIN = dome_skin(SENSOR.gel.outer_radius_m, 2.0e-3)
POSES = [Pose(np.array([0.0, 0.0, 0.01575 - depth])) for depth in (0.5e-3, 1.0e-3, 1.0e-3)]
STAMP_S = np.array([0.0, 0.2, 1.2])
RELAXATIONS = (PronySeries((0.3,), (1.0,)), PronySeries((), ()), PronySeries((0.1,), (0.2,)))


def pressed(simulator: GelSimulator, relaxation: PronySeries) -> SimulatedPress:
    return simulator.press(values_of(SENSOR), sphere(4e-3), POSES, STAMP_S, relaxation=relaxation)


def test_relaxation_leaves_no_trace_in_the_gel_that_is_kept() -> None:
    kept = GelSimulator(SENSOR, SKIN)
    forces = []
    for relaxation in RELAXATIONS:
        found = pressed(kept, relaxation)
        alone = pressed(GelSimulator(SENSOR, SKIN), relaxation)
        np.testing.assert_array_equal(found.skin_position_m, alone.skin_position_m)
        np.testing.assert_array_equal(found.force_n, alone.force_n)
        forces.append(found.force_n[:, 2])
    held = [force[2] / force[1] for force in forces]
    assert held[1] == pytest.approx(1.0, abs=5e-3)
    assert held[0] < held[2] < 0.98


def test_a_pad_of_another_thickness_keeps_its_face_and_presses_as_one_made_so() -> None:
    thickness_m, depth_m, share = 4.0e-3, 0.5e-3, 0.8
    solver = SolverSpecification(grid_spacing_m=1.0e-3, refined=False)
    gel = GelSpecification(
        shape="flat_pad", pad_size_m=(0.01, 0.01, thickness_m), skin_spacing_m=0.8e-3
    )
    own = replace(SensorSpecification(), gel=gel, solver=solver)
    stretched = replace(values_of(own), thickness_m=share * thickness_m)

    def pressed_at(sensor: SensorSpecification, face_m: float, values: GelValues) -> SimulatedPress:
        poses = [Pose(np.array([0.0, 0.0, face_m - deep])) for deep in (-0.1e-3, depth_m)]
        simulator = GelSimulator(sensor, skin_of(sensor.gel))
        return simulator.press(values, sphere(4e-3), poses, np.array([0.0, 0.1]))

    found = pressed_at(own, thickness_m, stretched)
    # At rest its face is where the sensor's own is.
    np.testing.assert_allclose(found.skin_position_m[0, :, 2].max(), thickness_m, atol=1e-9)
    assert found.skin_position_m[1, :, 2].min() == pytest.approx(thickness_m - depth_m, abs=0.1e-3)
    # One that was made so lies with its face at its own thickness.
    size_m = (0.01, 0.01, share * thickness_m)
    made = replace(own, gel=replace(gel, pad_size_m=size_m))
    expected = pressed_at(made, share * thickness_m, values_of(made))
    assert found.force_n[1, 2] == pytest.approx(expected.force_n[1, 2], rel=0.12)
    # The thinner, the stiffer; on a grid that is coarse for it, too.
    plain = pressed_at(own, thickness_m, values_of(own)).force_n[1, 2]
    assert plain < found.force_n[1, 2]
    wide = replace(own, solver=replace(solver, grid_spacing_m=2.0e-3))
    assert pressed_at(wide, thickness_m, stretched).force_n[1, 2] > plain
