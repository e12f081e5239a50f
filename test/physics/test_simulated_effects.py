# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects around a real solve, as the gap finder asks for them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from dotsim_ros.data.presses import Press
from dotsim_ros.data.recording import Recording, phases_of
from dotsim_ros.effects.effect import FORCE, Active, Effect, EffectParameter, GelTerm
from dotsim_ros.effects.simulate import EffectRequest, open_solver
from dotsim_ros.gel.make import skin_of
from dotsim_ros.gel.values import values_of
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.specification import load_sensor

COARSE = load_sensor("densetact2")
COARSE = replace(COARSE, solver=replace(COARSE.solver, refined=False, grid_spacing_m=4.8e-3))


def _cured(term: GelTerm, values: dict[str, float], recording: Recording | None) -> GelTerm:
    modulus_pa = values["ratio"] * term.values.youngs_modulus_pa
    return replace(term, values=replace(term.values, youngs_modulus_pa=modulus_pa))


CURE = Effect(
    "cure",
    "A gel that has cured",
    (EffectParameter("ratio", "", 1.0, 0.5, 3.0, (1.5,)),),
    (FORCE,),
    "any press",
    lambda recording: True,
    gel=_cured,
)


def test_an_effect_that_stiffens_the_gel_raises_its_force_alike_and_needs_no_solve(
    tmp_path: Path,
) -> None:
    skin = skin_of(COARSE.gel)
    depth_m = np.array([0.0, 0.8e-3])
    poses = [Pose(skin.apex_m - np.array([0.0, 0.0, depth])) for depth in depth_m]
    stamp_s = np.array([0.0, 0.1])
    press = Press("press", "sphere_4mm", poses, stamp_s, force_n=np.zeros((2, 3)))
    ball = load_indenter("sphere_4mm")
    recording = Recording(press, ball, 0.0, depth_m, phases_of(poses, stamp_s, depth_m))
    with open_solver(COARSE, skin, tmp_path, workers=1) as solver:
        requests = [
            EffectRequest(recording, values_of(COARSE), effects=effects)
            for effects in ([], [Active(CURE, {"ratio": 1.5})])
        ]
        without, cured = solver.run(requests)
        assert solver.solve_count == 1
        # A budget counts what is asked for, on disk or not.
        assert solver.asked_count == 2
        solver.run(requests)
        assert solver.asked_count == 2
    assert np.linalg.norm(without.force_n[1]) > 0.1
    np.testing.assert_allclose(cured.force_n, 1.5 * without.force_n, rtol=1e-12)
    np.testing.assert_array_equal(cured.skin_position_m, without.skin_position_m)
