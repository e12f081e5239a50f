# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where the indenter comes from: jumps, first poses in the gel, releases, repeats, deep presses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gel_cases import (
    DOME_TOP_M,
    FRICTIONLESS,
    PAD_TOP_M,
    at,
    dome_gel,
    one,
    pad_gel,
    pressed,
    towards_centre,
)

from dotsim_ros.gel.implicit.gel import FORGOTTEN_N, GelState, ImplicitGel, PressTooDeepError
from dotsim_ros.gel.material import PronySeries
from dotsim_ros.geometry.indenter import box_edge, cone, flat_punch, sphere, torus
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.specification import ContactSpecification

BALL = sphere(4.0e-3)
FRICTION = ContactSpecification(friction_coefficient=0.5)
APEX = (0.0, 0.0, 1.0)
COARSE_PENETRATION_M = 550e-6
"""On a grid of 3.6 mm with markers 1 mm apart a few markers carry all; a sensor's grid is finer.
This is still far less than any of these shapes is thick: none has passed through."""


def assert_at_rest(gel: ImplicitGel, state: GelState) -> None:
    assert np.all(state.displacement_m == 0.0)
    assert np.array_equal(state.skin_position_m, gel.skin.rest_position_m)
    assert np.all(state.wrench.force_n == 0.0)
    assert np.all(state.wrench.torque_nm == 0.0)
    assert state.contact_count == 0
    assert state.max_penetration_m == 0.0


def assert_same(one_state: GelState, other: GelState) -> None:
    assert np.array_equal(one_state.displacement_m, other.displacement_m)
    assert np.array_equal(one_state.skin_position_m, other.skin_position_m)
    assert np.array_equal(one_state.wrench.force_n, other.wrench.force_n)
    assert np.array_equal(one_state.wrench.torque_nm, other.wrench.torque_nm)
    assert one_state.iterations == other.iterations


def journey() -> list[Pose | None]:
    """Return a press, a slide, a turn, a release and a second press."""
    turned = np.array([0.0, 0.0, np.sin(0.1), np.cos(0.1)])
    down = [towards_centre(APEX, depth) for depth in (-0.5e-3, 0.3e-3, 0.9e-3)]
    along = [at(x, 0.2e-3, DOME_TOP_M - 0.9e-3) for x in (0.2e-3, 0.7e-3)]
    return [*down, *along, Pose(along[-1].position_m, turned), None, down[1], along[0]]


@pytest.fixture(scope="module")
def dome() -> ImplicitGel:
    """A dome under a ball with friction; reset it before use."""
    return dome_gel(BALL, contact=FRICTION)


def test_markers_that_a_slide_leaves_behind_are_forgotten(dome: ImplicitGel) -> None:
    dome.reset()
    for x_m in np.linspace(-2.0e-3, 3.0e-3, 40):
        pose = at(x_m, 0.2e-3, DOME_TOP_M - 0.9e-3)
        state = one(dome, pose)
    largest_n = np.abs(dome.worlds[0].marker_force_n).max(axis=1)
    loaded = largest_n > 0.0
    assert state.contact_count <= np.count_nonzero(loaded) < 2 * state.contact_count
    assert largest_n[loaded].min() >= FORGOTTEN_N


def test_release_returns_to_rest_and_forgets(dome: ImplicitGel) -> None:
    press = [towards_centre((0.2, 0.1, 1.0), depth) for depth in (0.5e-3, 1.2e-3)]
    dome.reset()
    fresh = [one(dome, pose) for pose in press]
    one(dome, at(1.0e-3, 0.5e-3, DOME_TOP_M - 1.0e-3))
    assert_at_rest(dome, one(dome, None))
    for pose, expected in zip(press, fresh, strict=True):
        assert_same(one(dome, pose), expected)
    # Lifted, or moved aside, instead of taken away.
    for pose in (towards_centre(APEX, -0.1e-3), at(30e-3, 0.0, 5e-3), at(0.0, 0.0, 30e-3)):
        assert_at_rest(dome, one(dome, pose))


def test_reset_in_a_press_is_as_fresh(dome: ImplicitGel) -> None:
    dome.reset()
    first = one(dome, towards_centre(APEX, 0.8e-3))
    one(dome, towards_centre((0.3, 0.0, 1.0), 1.0e-3))
    dome.reset()
    assert_same(one(dome, towards_centre(APEX, 0.8e-3)), first)
    dome.set_indenter(sphere(3.0e-3))
    assert_at_rest(dome, one(dome, None))
    dome.set_indenter(BALL)
    assert_same(one(dome, towards_centre(APEX, 0.8e-3)), first)


def test_two_runs_are_equal_bit_for_bit(dome: ImplicitGel) -> None:
    other = dome_gel(BALL, contact=FRICTION)
    dome.reset()
    for pose in journey():
        assert_same(one(dome, pose), one(other, pose))


RELAXING = {"prony": PronySeries((0.3,), (0.1,))}
DYNAMIC = {"solver": {"dynamic": True}}


@pytest.mark.parametrize(
    "setting",
    [{}, RELAXING | DYNAMIC, RELAXING | {"exact": True}],
    ids=["elastic", "relaxing dynamic", "relaxing exact"],
)
def test_environments_equal_single_runs(setting: dict[str, Any]) -> None:
    paths = [
        [pressed(0.3e-3), pressed(0.6e-3, 0.2e-3), None, pressed(0.2e-3)],
        [None, pressed(0.8e-3, -1e-3), pressed(0.9e-3, -0.8e-3), None],
        # Steps that are not divided, next to steps of several substeps.
        [pressed(0.2e-3), *(pressed(0.4e-3, x) for x in (0.4e-3, 0.8e-3, 1.2e-3))],
    ]
    batch = pad_gel(contact=FRICTION, environment_count=len(paths), **setting)
    together = []
    for k in range(4):
        # A refused step moves no environment.
        with pytest.raises(PressTooDeepError):
            batch.step([None, None, pressed(PAD_TOP_M - 1.0e-3)], 0.04)
        together.append(batch.step([path[k] for path in paths], 0.04))
    for e, path in enumerate(paths):
        single = pad_gel(contact=FRICTION, **setting)
        for k, pose in enumerate(path):
            alone = one(single, pose)
            assert_same(together[k][e], alone)


def test_reset_forgets_steps_of_another_length() -> None:
    gel = pad_gel(contact=FRICTION, **RELAXING, **DYNAMIC)
    fresh = [one(gel, pressed(depth), 0.04) for depth in (0.3e-3, 0.8e-3)]
    for dt_s in (0.01, 0.04):
        one(gel, pressed(1.0e-3), dt_s)
    gel.reset()
    for depth, expected in zip((0.3e-3, 0.8e-3), fresh, strict=True):
        assert_same(one(gel, pressed(depth), 0.04), expected)


def test_first_pose_in_the_gel_is_that_of_a_press() -> None:
    pose = towards_centre((0.4, -0.2, 1.0), 1.5e-3)
    gel = dome_gel(BALL, contact=FRICTIONLESS, solver={"tolerance_m": 1e-8, "iterations": 40})
    jumped = one(gel, pose)
    gel.reset()
    for depth in np.arange(-0.2e-3, 1.5e-3, 0.2e-3):
        one(gel, towards_centre((0.4, -0.2, 1.0), float(depth)))
    walked = one(gel, pose)
    assert jumped.converged
    assert walked.converged
    assert jumped.skin_position_m == pytest.approx(walked.skin_position_m, abs=2e-8)
    assert jumped.wrench.force_n == pytest.approx(walked.wrench.force_n, rel=1e-4, abs=1e-5)


def test_friction_converges_with_the_length_of_the_steps() -> None:
    found = []
    for count in (2, 6, 12):
        gel = dome_gel(BALL, contact=FRICTION, solver={"tolerance_m": 1e-6, "iterations": 40})
        for k in range(1, count + 1):
            state = one(gel, at(0.3e-3 * k / count, 0.0, DOME_TOP_M - 1.2e-3 * k / count))
        found.append(state.wrench.force_n)
    size = np.linalg.norm(found[2])
    change = [np.linalg.norm(force - found[2]) / size for force in found[:2]]
    assert change[1] < 0.6 * change[0]
    assert change[1] < 0.02


def test_jump_across_the_dome_ends_at_rest_on_the_other_side(dome: ImplicitGel) -> None:
    dome.reset()
    height = DOME_TOP_M - 2.0e-3
    one(dome, at(-25e-3, 0.0, height))
    one(dome, at(-1.0e-3, 0.0, height))
    assert one(dome, at(0.0, 0.0, height)).max_penetration_m < COARSE_PENETRATION_M
    assert_at_rest(dome, one(dome, at(25e-3, 0.0, height)))


@pytest.mark.parametrize("depth_m", [8.5e-3, 30.0e-3])
def test_too_deep_a_press_is_refused_and_changes_nothing(dome: ImplicitGel, depth_m: float) -> None:
    dome.reset()
    one(dome, towards_centre(APEX, 0.5e-3))
    with pytest.raises(PressTooDeepError, match="press less deep"):
        one(dome, towards_centre(APEX, depth_m))
    after = one(dome, towards_centre(APEX, 0.8e-3))
    dome.reset()
    one(dome, towards_centre(APEX, 0.5e-3))
    assert_same(after, one(dome, towards_centre(APEX, 0.8e-3)))


def test_a_pose_next_to_a_clear_one_is_refused_where_it_would_be_alone(dome: ImplicitGel) -> None:
    def is_refused(depth_m: float) -> bool:
        try:
            dome.check_depth(towards_centre(APEX, depth_m))
        except PressTooDeepError:
            return True
        return False

    depths_m = np.arange(0.5e-3, 9.0e-3, 0.05e-3)
    walked = [is_refused(depth_m) for depth_m in depths_m]
    # From far away nothing is known of it.
    alone = [is_refused(-0.05) or is_refused(depth_m) for depth_m in depths_m]
    assert walked == alone
    assert 0 < sum(walked) < len(walked)


def test_way_through_the_core_is_refused(dome: ImplicitGel) -> None:
    dome.reset()
    one(dome, at(-25.0e-3, 0.0, 3.0e-3))
    with pytest.raises(PressTooDeepError):
        one(dome, at(25.0e-3, 0.0, 3.0e-3))
    assert_at_rest(dome, one(dome, at(-24.0e-3, 0.0, 3.0e-3)))


def test_pad_refuses_to_be_pierced() -> None:
    gel = pad_gel(indenter=BALL)
    for depth in (PAD_TOP_M - 1.0e-3, PAD_TOP_M + 8.0e-3):
        with pytest.raises(PressTooDeepError):
            one(gel, pressed(depth))
    assert_at_rest(gel, one(gel, None))


@pytest.mark.parametrize(
    ("poses", "dt_s", "message"),
    [
        ([], 0.04, "0 poses for 1"),
        ([None, None], 0.04, "2 poses for 1"),
        ([None], 0.0, "dt_s"),
        ([None], float("nan"), "dt_s"),
    ],
)
def test_bad_steps_are_refused(
    dome: ImplicitGel, poses: list[Pose | None], dt_s: float, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        dome.step(poses, dt_s)


FLANK = (1.0, 0.3, 0.8)
DEEP_PRESSES = {
    "sphere": (BALL, 5.0e-3, FLANK),
    "box_edge": (box_edge([12e-3, 8e-3, 8e-3], 0.3e-3), 4.0e-3, FLANK),
    "flat_punch": (flat_punch(4.0e-3, 10.0e-3, 0.3e-3), 3.0e-3, APEX),
    # Deeper than it is thick.
    "torus": (torus(4.0e-3, 1.5e-3), 4.0e-3, APEX),
    "cone": (cone(np.radians(45.0), 8.0e-3, 0.5e-3), 4.0e-3, FLANK),
}


@pytest.mark.parametrize("shape", DEEP_PRESSES)
def test_deep_press(shape: str) -> None:
    indenter, deepest, direction = DEEP_PRESSES[shape]
    gel = dome_gel(indenter, contact=FRICTION)
    axis = np.array(direction) / np.linalg.norm(direction)
    last = 0.0
    for depth in np.arange(0.2e-3, deepest + 1e-6, 0.2e-3):
        state = one(gel, towards_centre(direction, float(depth)))
        assert state.converged, f"at {depth * 1e3:.1f} mm"
        assert state.max_penetration_m < COARSE_PENETRATION_M
        force = float(state.wrench.force_n @ axis)
        # A ring or a box reaches the dome later than a tip would, and an edge that caught the skin
        # may let go.
        assert force >= 0.96 * last
        last = force
    gel.reset()
    jumped = one(gel, towards_centre(direction, deepest))
    assert jumped.converged
    assert last > 0.5
    assert float(jumped.wrench.force_n @ axis) == pytest.approx(last, rel=0.05)
    assert_at_rest(gel, one(gel, None))
