# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The implicit gel under frictionless indenters: Hertz, refinement, balance of forces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from closed_forms import bonded_layer_factor, hertz_force_n
from gel_cases import (
    FRICTIONLESS,
    LAWS,
    PAD_TOP_M,
    YOUNGS_PA,
    FloatArray,
    at,
    dome_gel,
    one,
    pad_gel,
    pad_skin,
    pressed,
    towards_centre,
)

from dotsim_ros.gel.body import Pad
from dotsim_ros.gel.implicit.gel import GelState, ImplicitGel
from dotsim_ros.gel.material import Material, NeoHookean
from dotsim_ros.geometry.indenter import Indenter, box_edge, sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import flat_pad_skin
from dotsim_ros.specification import ContactSpecification, SolverSpecification

HERTZ_RADIUS_M = 20.0e-3
HERTZ_PAD_M = (21.6e-3, 21.6e-3, 9.6e-3)
"""Smaller than the pad of the other tests, and wide enough that its sides are not felt."""


def hertz_gel(poisson_ratio: float, *, exact: bool = False, **solver: Any) -> ImplicitGel:
    return pad_gel(
        size_m=HERTZ_PAD_M,
        skin=pad_skin(0.6e-3, HERTZ_PAD_M),
        law=NeoHookean(YOUNGS_PA, poisson_ratio),
        indenter=sphere(HERTZ_RADIUS_M),
        solver=solver,
        exact=exact,
    )


@pytest.fixture(scope="module")
def refined_pads(tmp_path_factory: pytest.TempPathFactory) -> dict[float, ImplicitGel]:
    """Refined pads under a sphere, by Poisson's ratio; reset them before use."""
    # In a cache of their own, so that they are computed.
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DOTSIM_ROS_CACHE", str(tmp_path_factory.mktemp("cache")))
        return {
            ratio: hertz_gel(ratio, grid_spacing_m=2.4e-3, refined=True) for ratio in (0.3, 0.49)
        }


def sunk_m(gel: ImplicitGel, state: GelState) -> float:
    """Return how far the middle of the pad's skin has sunk: the depth without the contact's gap."""
    rest = gel.skin.rest_position_m
    middle = np.argmin(np.linalg.norm(rest[:, :2], axis=1))
    # Markers lie up to half their distance next to the tip.
    beside = np.linalg.norm(state.skin_position_m[middle, :2])
    return float(
        rest[middle, 2] - state.skin_position_m[middle, 2] + beside**2 / 2 / HERTZ_RADIUS_M
    )


def sunk_by(depth_m: float) -> Pose:
    """Return the pose whose tip is `depth_m` below the face of Hertz's pad."""
    return at(0.0, 0.0, HERTZ_PAD_M[2] - depth_m)


def hertz_presses(gel: ImplicitGel) -> tuple[FloatArray, FloatArray]:
    """Return depths and forces of presses by a sphere."""
    gel.reset()
    states = [one(gel, sunk_by(depth)) for depth in (0.1e-3, 0.2e-3, 0.4e-3)]
    assert all(state.converged for state in states)
    depth = np.array([sunk_m(gel, state) for state in states])
    return depth, np.array([state.wrench.force_n[2] for state in states])


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.49])
def test_force_of_a_sphere_is_hertz(
    refined_pads: dict[float, ImplicitGel], poisson_ratio: float
) -> None:
    depth, force = hertz_presses(refined_pads[poisson_ratio])
    layer = np.array(
        [
            bonded_layer_factor(poisson_ratio, np.sqrt(HERTZ_RADIUS_M * d) / HERTZ_PAD_M[2])
            for d in depth
        ]
    )
    exponent = np.polyfit(np.log(depth), np.log(force / layer), 1)[0]
    assert exponent == pytest.approx(1.5, abs=0.06)
    hertz = np.array([hertz_force_n(HERTZ_RADIUS_M, YOUNGS_PA, poisson_ratio, d) for d in depth])
    # The shallowest contact is narrower than three cells of the refinement.
    assert force / (hertz * layer) == pytest.approx(1.0, abs=0.06)
    # 3.4 % above and 2.8 % below: the contact hardly gives way.
    assert force[1:] / (hertz * layer)[1:] == pytest.approx(1.0, abs=0.045)


def test_nearly_incompressible_gel_does_not_lock(refined_pads: dict[float, ImplicitGel]) -> None:
    depth, soft = hertz_presses(refined_pads[0.3])
    stiff_depth, stiff = hertz_presses(refined_pads[0.49])
    ratio = stiff / soft * (depth / stiff_depth) ** 1.5
    half_space = (1.0 - 0.3**2) / (1.0 - 0.49**2)
    # A layer that is wide next to its thickness is confined, this one less so, a half space not.
    confinement = np.sqrt(HERTZ_RADIUS_M * depth[-1]) / HERTZ_PAD_M[2]
    layer = bonded_layer_factor(0.49, confinement) / bonded_layer_factor(0.3, confinement)
    assert np.all(ratio > 0.97 * half_space)
    assert np.all(ratio < 1.03 * half_space * layer)
    assert ratio == pytest.approx(half_space, rel=0.04)


def test_press_force_converges_with_the_grid() -> None:
    size = (28.8e-3, 28.8e-3, 14.4e-3)
    skin = flat_pad_skin(size[:2], size[2], 0.9e-3)
    force = []
    for spacing in (4.8e-3, 3.6e-3, 2.4e-3):
        gel = ImplicitGel(
            Pad(size),
            skin,
            Material(LAWS["neo_hookean"]),
            contact=FRICTIONLESS,
            solver=SolverSpecification(grid_spacing_m=spacing, refined=False),
            indenter=sphere(10.0e-3),
            exact=True,
        )
        state = one(gel, at(0.0, 0.0, size[2] - 1.0e-3))
        assert state.converged
        force.append(state.wrench.force_n[2])
    # A finer grid gives way more, and the steps get smaller.
    assert force[0] > force[1] > force[2]
    assert force[1] - force[2] < 0.75 * (force[0] - force[1])
    assert force[1] == pytest.approx(force[2], rel=0.06)


def test_refinement_gives_the_force_of_the_finer_grid() -> None:
    size = (21.6e-3, 21.6e-3, 10.8e-3)
    force = {}
    for name, spacing, refined in (
        ("refined", 3.6e-3, True),
        ("coarse", 3.6e-3, False),
        ("fine", 1.8e-3, False),
    ):
        gel = pad_gel(
            size_m=size,
            skin=pad_skin(0.6e-3, size),
            law=NeoHookean(YOUNGS_PA, 0.3),
            indenter=sphere(14.0e-3),
            solver={"grid_spacing_m": spacing, "refined": refined, "tolerance_m": 4.0e-6},
            exact=not refined,
        )
        force[name] = one(gel, at(0.0, 0.0, size[2] - 0.4e-3)).wrench.force_n[2]
    assert force["refined"] == pytest.approx(force["fine"], rel=0.015)
    # A third too stiff: the contact is not wider than two cells.
    assert abs(force["refined"] - force["fine"]) < 0.1 * abs(force["coarse"] - force["fine"])


@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (-1.0, 0.4, 0.7)])
def test_frictionless_sphere_feels_no_torque_about_its_centre(
    direction: tuple[float, float, float],
) -> None:
    radius = 4.0e-3
    gel = dome_gel(sphere(radius), contact=FRICTIONLESS, solver={"tolerance_m": 1e-8})
    pose = towards_centre(direction, 1.0e-3)
    wrench = one(gel, pose).wrench
    centre = pose.apply(np.array([0.0, 0.0, radius]))
    size = np.linalg.norm(wrench.force_n)
    assert size > 0.1
    assert wrench.torque_nm == pytest.approx(np.cross(centre, wrench.force_n), abs=1e-9 * size)
    # The gel pushes the sphere out along the press.
    axis = np.array(direction) / np.linalg.norm(direction)
    assert wrench.force_n @ axis > 0.98 * size


@pytest.mark.parametrize(
    ("indenter", "friction"),
    [(sphere(10.0e-3), 0.0), (box_edge([10e-3, 6e-3, 6e-3], 0.5e-3), 0.6)],
    ids=["sphere", "box_edge"],
)
def test_base_carries_what_the_indenter_presses(indenter: Indenter, friction: float) -> None:
    gel = pad_gel(
        indenter=indenter,
        contact=ContactSpecification(friction_coefficient=friction),
        solver={"tolerance_m": 1e-7, "iterations": 40},
        exact=True,
    )
    one(gel, pressed(0.6e-3, 2.0e-3, -1.5e-3))
    state = one(gel, pressed(0.6e-3, 2.3e-3, -1.4e-3))
    assert state.converged
    force = gel.body.force(state.displacement_m[None])[1][0]
    position = gel.discretization.node_position_m
    # A virtual displacement that grows from nothing at the base to a rigid one: the work of the
    # stress in between is the load that passes through to the base.
    ramp = np.clip(position[:, 2] / (0.5 * PAD_TOP_M), 0.0, 1.0)[:, None]
    # The tolerance times the contact's stiffness, 1e5 N/m, is what may be out of balance.
    load = np.linalg.norm(state.wrench.force_n)
    assert load > 0.1
    assert (ramp * force).sum(axis=0) == pytest.approx(-state.wrench.force_n, abs=2e-3 * load)
    turned = np.cross(position + state.displacement_m, ramp * force).sum(axis=0)
    assert turned == pytest.approx(-state.wrench.torque_nm, abs=2e-3 * load * PAD_TOP_M)


def test_force_scales_with_the_modulus_and_the_shape_does_not() -> None:
    states = []
    for factor in (1.0, 2.0):
        law = type(LAWS["mooney_rivlin"])(12.0e3 * factor, 6.0e3 * factor, 4.0e5 * factor)
        states.append(one(pad_gel(law=law), pressed(1.0e-3)))
    assert states[1].wrench.force_n[2] == pytest.approx(2.0 * states[0].wrench.force_n[2], rel=1e-5)
    assert states[1].skin_position_m == pytest.approx(states[0].skin_position_m, abs=1e-8)


def test_fast_solve_finds_the_exact_equilibrium() -> None:
    found = [
        one(
            dome_gel(
                sphere(4.0e-3),
                contact=FRICTIONLESS,
                exact=exact,
                solver={"tolerance_m": 1e-8, "iterations": 40},
            ),
            towards_centre((0.3, 0.2, 1.0), 1.5e-3),
        )
        for exact in (False, True)
    ]
    assert all(state.converged for state in found)
    assert found[0].skin_position_m == pytest.approx(found[1].skin_position_m, abs=2e-8)
    assert found[0].wrench.force_n == pytest.approx(found[1].wrench.force_n, rel=1e-4, abs=1e-6)
