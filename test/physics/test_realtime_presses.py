# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Deep presses with the effort of the node's profile `realtime`, at frames as a machine gives them.

At one or two iterations a frame an error that a frame leaves must not grow in the next ones.
"""

from dataclasses import replace

import numpy as np

from dotsim_ros.data.shipped_presses import read_presses
from dotsim_ros.gel.make import body_of, make_gel, skin_of
from dotsim_ros.gel.rest_depth import RestDepth
from dotsim_ros.geometry.indenter import load_indenter, way_m
from dotsim_ros.io.files import parameter_path
from dotsim_ros.nodes.indenter_player.program import SHIPPED_PRESSES
from dotsim_ros.nodes.tactile_sim.profiles import EXACT, REALTIME, solver_of
from dotsim_ros.nodes.tactile_sim.pursuit import CommandedPath
from dotsim_ros.specification import load_sensor

SPEED_M_S = 5.0e-3
FRAME_S = 0.04
PRESS = 1
DEPTH_M, IRREGULARITY = 4.5e-3, 0.5


def _gel(sensor, indenter, profile):
    solver = solver_of(profile, sensor)
    return make_gel(replace(sensor, solver=solver), skin_of(sensor.gel), indenter).gel


def test_a_press_in_real_time_keeps_the_force_of_the_exact_solver():
    sensor, indenter = load_sensor("densetact2"), load_indenter("sphere_4mm")
    press = read_presses(parameter_path(SHIPPED_PRESSES))[PRESS]
    motion = press.motion(
        outer_radius_m=sensor.gel.outer_radius_m,
        indenter_radius_m=4.0e-3,
        speed_m_s=SPEED_M_S,
        hold_s=0.4,
        depth_limit_m=DEPTH_M,
        clearance_m=0.5e-3,
    )
    quick, exact = (_gel(sensor, indenter, profile) for profile in (REALTIME, EXACT))
    random = np.random.default_rng(0)
    path = CommandedPath(
        way_m=lambda start, end: way_m(start, end, indenter),
        depth_m=RestDepth(body_of(sensor.gel), indenter),
    )
    time_s = 0.0
    forces_n, errors_m = [], []
    while time_s < motion.duration_s:
        step_s = FRAME_S * (1.0 + IRREGULARITY * random.uniform(-1.0, 1.0))
        time_s += step_s
        path.add(motion.at(time_s))
        pose = path.advance(REALTIME.move_m).pose
        shown, expected = quick.step([pose], step_s)[0], exact.step([pose], step_s)[0]
        forces_n.append(
            [np.linalg.norm(state.wrench.force_n) for state in (shown, expected)],
        )
        errors_m.append(np.abs(shown.skin_position_m - expected.skin_position_m).max())
    force_n, expected_n = np.array(forces_n).T
    assert np.abs(force_n - expected_n).max() < 0.03 * expected_n.max()
    assert max(errors_m) < 0.25e-3
