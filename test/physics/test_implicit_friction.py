# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Friction of the implicit gel: sticking, Coulomb's limit, and slip."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gel_cases import YOUNGS_PA, FloatArray, at, dome_gel, one, pad_gel, pressed

from dotsim_ros.gel.implicit.gel import GelState, ImplicitGel
from dotsim_ros.geometry.indenter import Indenter, flat_punch, sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.specification import ContactSpecification

DEPTH_M = 0.5e-3
SHEAR_MODULUS_PA = YOUNGS_PA / 2.0 / 1.45
LARGE_BALL = sphere(20.0e-3)
PUNCH = flat_punch(4.0e-3, 8.0e-3, 0.5e-3)


def gel_with_friction(coefficient: float, indenter: Indenter, **solver: Any) -> ImplicitGel:
    contact = ContactSpecification(friction_coefficient=coefficient)
    effort = {"tolerance_m": 1e-7, "iterations": 40} | solver
    return pad_gel(contact=contact, indenter=indenter, solver=effort)


def slide(gel: ImplicitGel, shifts_m: FloatArray) -> list[GelState]:
    one(gel, pressed(0.5 * DEPTH_M))
    one(gel, pressed(DEPTH_M))
    states = [one(gel, pressed(DEPTH_M, x)) for x in shifts_m]
    assert all(state.converged for state in states)
    return states


def ratio(state: GelState) -> float:
    """Return tangential over normal force on the indenter, positive if the gel holds it back."""
    return float(-state.wrench.force_n[0] / state.wrench.force_n[2])


def contact_forces(gel: ImplicitGel) -> tuple[FloatArray, FloatArray]:
    """Return normal (C,) and tangential (C,) forces on the markers in contact."""
    world = gel.worlds[0]
    assert world.response is not None
    assert world.pose is not None
    local = world.response.local_position_m
    force = world.response.force_n @ world.pose.rotation()
    step = 1e-7 * np.eye(3)
    distance = gel.contact.indenter.signed_distance
    normal = np.stack([distance(local + e) - distance(local - e) for e in step], axis=-1) / 2e-7
    pressing = np.sum(force * normal, axis=1)
    holding = np.linalg.norm(force - pressing[:, None] * normal, axis=1)
    touching = pressing > 0.0
    assert touching.any()
    return pressing[touching], holding[touching]


def test_slide_ends_at_coulombs_limit() -> None:
    coefficient = 0.3
    there = np.linspace(0.1e-3, 1.0e-3, 10)
    states = slide(gel_with_friction(coefficient, LARGE_BALL), np.concatenate([there, there[::-1]]))
    ratios = np.array([ratio(state) for state in states])
    # It sticks first, then slips at a level that no longer changes.
    assert ratios[0] < 0.8 * coefficient
    assert np.ptp(ratios[3:8]) < 0.01 * coefficient
    assert ratios[3:8] == pytest.approx(coefficient, rel=0.03)
    # The shape pushes a little to one side, there and back alike: half the difference is friction.
    assert 0.5 * (ratios[2:4] - ratios[17:15:-1]) == pytest.approx(coefficient, rel=0.005)
    assert abs(states[7].wrench.force_n[1]) < 1e-3 * states[7].wrench.force_n[2]


@pytest.mark.parametrize("coefficient", [0.2, 0.6])
@pytest.mark.parametrize(
    "indenter",
    [
        pytest.param(LARGE_BALL, id="sphere"),
        pytest.param(PUNCH, id="flat_punch"),
    ],
)
def test_every_marker_obeys_coulomb(coefficient: float, indenter: Indenter) -> None:
    gel = gel_with_friction(coefficient, indenter, tolerance_m=1e-6)
    mobilised = []
    for shift in np.concatenate([[0.0], np.linspace(0.1e-3, 1.0e-3, 10)]):
        one(gel, pressed(DEPTH_M, shift))
        pressing, holding = contact_forces(gel)
        assert np.all(holding <= coefficient * pressing + 0.01 * coefficient * pressing.max())
        mobilised.append(holding.sum() / pressing.sum() / coefficient)
    # Straight in, or as it begins to move, some of them stick.
    assert min(mobilised[:2]) < 0.98
    assert np.array(mobilised[-3:]) == pytest.approx(1.0, abs=0.01)


def test_punch_slides_to_a_fine_tolerance() -> None:
    slide(gel_with_friction(0.2, PUNCH, tolerance_m=1e-7), np.linspace(0.1e-3, 1.0e-3, 10))


def test_below_the_limit_it_sticks() -> None:
    gel = gel_with_friction(5.0, LARGE_BALL, tolerance_m=1e-8)
    shifts = np.array([0.0, 10e-6, 20e-6, 40e-6, 0.0])
    states = slide(gel, shifts)
    force = -np.array([state.wrench.force_n[0] for state in states])
    force -= force[0]
    stiffness = force[1:4] / shifts[1:4]
    assert stiffness == pytest.approx(stiffness[-1], rel=0.01)
    # Mindlin 1949, a half space: 8 G a / (2 - nu). A bonded layer is stiffer.
    mindlin = 8.0 * SHEAR_MODULUS_PA * np.sqrt(20.0e-3 * DEPTH_M) / (2.0 - 0.45)
    assert 1.0 < stiffness[-1] / mindlin < 1.35
    # Nothing but the unloaded rim slipped, so the way back leaves next to nothing behind.
    assert abs(force[-1]) < 0.02 * force[3]


def test_sticking_skin_goes_with_the_indenter() -> None:
    gel = gel_with_friction(5.0, LARGE_BALL)
    before, after = slide(gel, np.array([0.0, 0.2e-3]))
    touched = np.linalg.norm(gel.skin.rest_position_m[:, :2], axis=1) < 2.0e-3
    move = (after.skin_position_m - before.skin_position_m)[touched]
    # What is left is elastic slip of the contact's spring, and that splines of 3 mm are not flat.
    assert move[:, 0] == pytest.approx(0.2e-3, rel=0.05)
    assert np.abs(move[:, 1]).max() < 5e-6


def test_slide_back_and_forth_dissipates() -> None:
    gel = gel_with_friction(0.3, LARGE_BALL)
    there = np.linspace(0.0, 0.6e-3, 7)
    path = np.concatenate([there, there[-2::-1], there[1:], there[-2::-1]])
    states = slide(gel, path)
    force = np.array([-state.wrench.force_n[0] for state in states])
    second = slice(len(there) + len(there) - 2, None)
    work = np.trapezoid(force[second], path[second])
    loop = 2.0 * 0.6e-3 * np.abs(force[second]).max()
    assert 0.2 * loop < work < loop
    # The loop is closed: the same place, on the same way, gives the same force.
    assert force[-1] == pytest.approx(force[2 * len(there) - 2], rel=0.02)


def test_twist_is_resisted_and_limited() -> None:
    coefficient, radius = 0.3, 4.0e-3
    gel = gel_with_friction(coefficient, PUNCH, tolerance_m=4e-6)
    one(gel, pressed(DEPTH_M))
    torque = []
    for angle in np.radians([1.0, 2.0, 10.0, 14.0, 18.0]):
        pose = Pose(
            pressed(DEPTH_M).position_m,
            np.array([0.0, 0.0, np.sin(angle / 2.0), np.cos(angle / 2.0)]),
        )
        state = one(gel, pose)
        assert state.converged
        torque.append(-state.wrench.torque_nm[2])
    normal = state.wrench.force_n[2]
    assert 0.0 < torque[0] < torque[1] < torque[2]
    assert torque[-1] == pytest.approx(torque[-2], rel=0.01)
    # Between that of an even pressure, 2/3 mu F a, and of all pressure at the rim, mu F a.
    assert 2.0 / 3.0 * coefficient * normal * radius * 0.9 < torque[-1]
    assert torque[-1] < coefficient * normal * radius


def test_dome_sticks_and_slips() -> None:
    coefficient = 0.4
    gel = dome_gel(sphere(4.0e-3), contact=ContactSpecification(friction_coefficient=coefficient))
    top = 15.75e-3 - 1.0e-3
    one(gel, at(0.0, 0.0, top))
    first = one(gel, at(0.05e-3, 0.0, top))
    last = first
    for x in np.linspace(0.2e-3, 1.6e-3, 8):
        last = one(gel, at(x, 0.0, top))
    assert ratio(first) < 0.5 * coefficient
    # The dome's slope takes from the level of a plane.
    assert 0.6 * coefficient < ratio(last) < 1.2 * coefficient
