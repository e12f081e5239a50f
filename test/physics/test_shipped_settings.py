# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gel as users have it: a sensor, mostly `densetact2`, on its own grid, refined, to its own
tolerance.

What the other tests ask of coarse grids and fine tolerances is asked here of the sensor's own
solver, EXACT, and of that of real time, REALTIME.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from gel_cases import DOME_TOP_M, FloatArray, at, one

from dotsim_ros.gel.adjoint.recorder import Recorder
from dotsim_ros.gel.implicit.gel import GelState, ImplicitGel
from dotsim_ros.gel.make import make_gel_batch
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose, Wrench
from dotsim_ros.nodes.tactile_sim.profiles import EXACT, REALTIME, Profile, solver_of
from dotsim_ros.specification import load_sensor

SENSOR = load_sensor("densetact2")
FRICTION = SENSOR.contact.friction_coefficient
BOTH = [pytest.param(EXACT, id="exact"), pytest.param(REALTIME, id="realtime")]
FRAME_M = 0.4e-3
"""A frame of 0.04 s at 10 mm/s."""
DEPTH_M = 1.5e-3
TILTED = (0.03, -0.02, 0.0, float(np.sqrt(1.0 - 0.0013)))


@cache
def shipped(profile: Profile, sensor: str = SENSOR.name) -> ImplicitGel:
    """Return the gel of a profile; give it an indenter before use."""
    specification = load_sensor(sensor)
    return make_gel_batch(
        replace(specification, solver=solver_of(profile, specification)),
        indenter=load_indenter("sphere_4mm"),
        environment_count=1,
    )


def shipped_under(profile: Profile, indenter: str) -> ImplicitGel:
    gel = shipped(profile)
    gel.set_indenter(load_indenter(indenter))
    return gel


def tip(x_m: float, depth_m: float, **pose: Any) -> Pose:
    """Return the pose whose tip is this far below the height of the apex."""
    return replace(at(x_m, 0.0, DOME_TOP_M - depth_m), **pose)


def pressed_to(gel: ImplicitGel, depth_m: float, x_m: float = 0.0, **pose: Any) -> GelState:
    """Press straight down in about 0.2 mm a frame; return the last state."""
    for depth in np.linspace(0.0, depth_m, round(depth_m / 0.2e-3) + 1):
        state = one(gel, tip(x_m, float(depth), **pose))
    return state


@dataclass(frozen=True)
class Touch:
    """The markers under pressure: normals (C, 3) out of the indenter, the pressure's force (C,)
    along them, and friction (C, 3) on the markers."""

    normal: FloatArray
    pressing_n: FloatArray
    friction_n: FloatArray


def touch_of(gel: ImplicitGel) -> Touch:
    world = gel.worlds[0]
    assert world.response is not None
    assert world.patch is not None
    response = world.response
    on = response.pressure_pa > 0.0
    assert on.any()
    pressing = (response.pressure_pa * gel.skin.rest_area_m2[world.patch.marker])[on]
    normal = response.normal[on]
    return Touch(normal, pressing, response.force_n[on] - pressing[:, None] * normal)


@pytest.mark.parametrize(
    ("sensor", "depth_m", "force_n", "profile"),
    # The forces are those of 40 steps, each solved to 0.2 um.
    [
        ("gelsight_mini", 1.0e-3, 3.189, EXACT),
        ("densetact2", 1.5e-3, 1.924, EXACT),
        ("densetact2", 1.5e-3, 1.924, REALTIME),
    ],
    ids=["pad", "dome", "dome realtime"],
)
def test_a_press_at_once_in_ten_steps_and_held_is_one_press(
    sensor: str, depth_m: float, force_n: float, profile: Profile
) -> None:
    gel = shipped(profile, sensor)
    gel.set_indenter(load_indenter("sphere_4mm"))
    top_m = gel.skin.apex_m[2]
    states = []
    for steps in (1, 10):
        gel.reset()
        way = [one(gel, at(z_m=top_m - k / steps * depth_m)) for k in range(1, steps + 1)]
        states += [way[-1], *(one(gel, at(z_m=top_m - depth_m)) for _ in range(3))]
    assert all(state.converged for state in states)
    forces = [state.wrench.force_n[2] for state in states]
    assert forces == pytest.approx([force_n] * len(states), rel=0.01)
    skins = np.array([state.skin_position_m for state in states])
    assert np.linalg.norm(skins - skins[0], axis=2).max() < 10.0e-6


@pytest.mark.parametrize("profile", BOTH)
def test_friction_of_a_slide_ends_at_coulombs_limit(profile: Profile) -> None:
    gel = shipped_under(profile, "sphere_4mm")
    pressed_to(gel, DEPTH_M)
    along = np.array([1.0, 0.0, 0.0])
    for x in FRAME_M * np.arange(1, 9):
        force = one(gel, tip(float(x), DEPTH_M)).wrench.force_n
        touch = touch_of(gel)
        size = np.linalg.norm(touch.friction_n, axis=1)
        assert np.all(size <= FRICTION * touch.pressing_n * (1.0 + 1e-9))
        if x < 1.9e-3:
            continue
        # All markers slip.
        assert size.sum() == pytest.approx(FRICTION * touch.pressing_n.sum(), rel=1e-6)
        # What Coulomb's law makes of the pressures where the skin lags behind the indenter: up to
        # 0.3 % next to it, since the skin also stretches.
        against = along - (touch.normal @ along)[:, None] * touch.normal
        against /= np.linalg.norm(against, axis=1)[:, None]
        expected = touch.pressing_n @ (touch.normal + FRICTION * against)
        assert np.linalg.norm(force + expected) < 0.005 * np.linalg.norm(force)
        # Normals that spread over the ball take from the sum of the pressures more than from that
        # of friction: 3 to 4 % above the coefficient.
        axis = touch.pressing_n @ touch.normal
        axis /= np.linalg.norm(axis)
        normal_n = float(force @ axis)
        tangential_n = float(np.linalg.norm(force - normal_n * axis))
        assert tangential_n / abs(normal_n) == pytest.approx(FRICTION, rel=0.05)


def borne(gel: ImplicitGel, displacement_m: FloatArray) -> Wrench:
    """Return force and torque, about the base frame's origin, that core and base bear.

    At equilibrium the energy's derivatives by a rigid motion of all nodes are what holds them: the
    bond, and the nodes mirrored at the base, which move the opposite way.
    """
    gradient = gel.body.force_in(0, displacement_m)[1]
    position = gel.discretization.node_position_m + displacement_m
    return Wrench(gradient.sum(axis=0), np.cross(position, gradient).sum(axis=0))


LARGEST_IMBALANCE = {EXACT.name: (2e-3, 0.25e-3), REALTIME.name: (1e-2, 0.4e-3)}
"""Of the force, as a share of it, and of the torque, m times the force. Measured: 0.07 % and
0.18 mm; in real time 0.5 % and 0.24 mm."""


@pytest.mark.parametrize("profile", BOTH)
def test_base_and_core_bear_what_the_indenter_presses(profile: Profile) -> None:
    gel = shipped_under(profile, "box_edge")
    pressed_to(gel, DEPTH_M, 1.0e-3, quaternion_xyzw=TILTED)
    by_force, lever_m = LARGEST_IMBALANCE[profile.name]
    for x in 1.0e-3 + FRAME_M * np.arange(1, 4):
        state = one(gel, tip(float(x), DEPTH_M, quaternion_xyzw=TILTED))
        held, load = borne(gel, state.displacement_m), np.linalg.norm(state.wrench.force_n)
        assert load > 0.1
        assert np.linalg.norm(held.force_n + state.wrench.force_n) < by_force * load
        assert np.linalg.norm(held.torque_nm + state.wrench.torque_nm) < lever_m * load


def test_only_what_the_refinement_adds_leaves_a_torque() -> None:
    """Settled to rounding, forces balance; torques lack that of the forces at the displacement that
    the refinement adds, which the grid does not see. What the indenter answers is worked out in
    single precision: processors differ by some millionths of the load."""
    gel = shipped_under(EXACT, "box_edge")
    recorder = Recorder(gel)
    for x, depth in ((1.0e-3, -0.1e-3), (1.0e-3, 0.4e-3), (1.4e-3, 0.6e-3)):
        pose = tip(x, depth, quaternion_xyzw=TILTED)
        state = recorder.step([pose], 0.04)[0]
    world = gel.worlds[0]
    assert world.response is not None
    assert world.patch is not None
    force = world.response.force_n
    left = np.cross(world.patch.added_displacement(force), force).sum(axis=0)
    held, load = borne(gel, state.displacement_m), np.linalg.norm(state.wrench.force_n)
    assert held.force_n == pytest.approx(-state.wrench.force_n, abs=1e-5 * load)
    assert held.torque_nm + left == pytest.approx(-state.wrench.torque_nm, abs=2e-7 * load)
    # Measured: up to 0.11 mm times the force, in presses of 1.5 mm.
    assert 0.0 < np.linalg.norm(left) < 0.15e-3 * load


DEEPEST_M = {"sphere_4mm": 5.0e-3, "box_edge": 4.0e-3}


@cache
def deep_press(profile: Profile, indenter: str) -> list[GelState]:
    gel = shipped_under(profile, indenter)
    depths = np.arange(1, round(DEEPEST_M[indenter] / 0.2e-3) + 1) * 0.2e-3
    return [one(gel, tip(0.0, float(depth))) for depth in depths]


@pytest.mark.parametrize("indenter", DEEPEST_M)
def test_deep_press_converges(indenter: str) -> None:
    exact, quick = deep_press(EXACT, indenter), deep_press(REALTIME, indenter)
    assert all(state.converged for state in exact)
    force, shown = (
        np.array([state.wrench.force_n[2] for state in states]) for states in (exact, quick)
    )
    assert np.all(np.diff(force) > 0.0)
    assert np.abs(shown - force).max() < 0.03 * force.max()


@pytest.mark.parametrize("profile", BOTH)
@pytest.mark.parametrize(
    "indenter",
    [
        "sphere_4mm",
        pytest.param(
            "box_edge",
            marks=pytest.mark.xfail(
                strict=True,
                reason="0.16 mm under an edge, 0.14 mm in real time; 0.10 mm at twice the "
                "contact's stiffness",
            ),
        ),
    ],
)
def test_deep_press_hardly_sinks_into_the_indenter(indenter: str, profile: Profile) -> None:
    assert max(state.max_penetration_m for state in deep_press(profile, indenter)) <= 50.0e-6


@dataclass(frozen=True)
class Snapshot:
    """The indenter's place (3,) and the gel's force (3,) on it, and of all markers (V, 3) the place
    in the indenter's frame and the friction on them."""

    place_m: FloatArray
    force_n: FloatArray
    local_m: FloatArray
    friction_n: FloatArray


def snapshot(gel: ImplicitGel, state: GelState) -> Snapshot:
    world = gel.worlds[0]
    assert world.response is not None
    assert world.patch is not None
    assert world.pose is not None
    assert world.history is not None
    response, marker = world.response, world.patch.marker
    friction = np.zeros_like(world.skin_position_m)
    pressing = response.pressure_pa * gel.skin.rest_area_m2[marker]
    friction[marker] = response.force_n - pressing[:, None] * response.normal
    place = world.pose.position_m
    return Snapshot(place, state.wrench.force_n, world.history.local_position_m, friction)


@pytest.mark.parametrize("profile", BOTH)
def test_a_slide_back_and_forth_costs_what_friction_takes(profile: Profile) -> None:
    gel = shipped_under(profile, "sphere_4mm")
    pressed_to(gel, DEPTH_M)
    far, count = 1.2e-3, round(1.2e-3 / FRAME_M)
    away, back = np.linspace(far, -far, 2 * count + 1), np.linspace(-far, far, 2 * count + 1)
    # From the first turn on the way is the same each time.
    for x in [*np.linspace(0.0, far, count + 1)[1:], *away[1:]]:
        state = one(gel, tip(float(x), DEPTH_M))
    before = snapshot(gel, state)
    work_j = dissipated_j = 0.0
    for x in [*back[1:], *away[1:]]:
        now = snapshot(gel, one(gel, tip(float(x), DEPTH_M)))
        work_j -= 0.5 * float((before.force_n + now.force_n) @ (now.place_m - before.place_m))
        # What is slip and what stretches the contact's springs: those end as they began.
        moved_m = now.local_m - before.local_m
        dissipated_j -= 0.5 * float(np.vdot(before.friction_n + now.friction_n, moved_m))
        before = now
    assert dissipated_j > 1e-4
    assert work_j == pytest.approx(dissipated_j, rel=0.05)


def test_friction_does_not_depend_on_the_length_of_the_steps() -> None:
    gel = shipped_under(REALTIME, "sphere_4mm")
    found = []
    for part in (1, 2, 4):
        gel.reset()
        pressed_to(gel, DEPTH_M)
        forces = [
            one(gel, tip(k * FRAME_M / part, DEPTH_M), 0.04 / part).wrench.force_n
            for k in range(1, 4 * part + 1)
        ]
        found.append(np.array(forces[part - 1 :: part]))
    size = np.linalg.norm(found[2], axis=1)
    for forces in found[:2]:
        # Measured: 1.7 %, as the slide begins.
        assert np.all(np.linalg.norm(forces - found[2], axis=1) < 0.03 * size)
