# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A gel that is kept from one press to the next answers as one that is made for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dotsim_ros.gel.material import PronySeries
from dotsim_ros.gel.values import values_of
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.specification import SensorSpecification, SolverSpecification
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
