# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Phases of a motion and observables of a press, against what was drawn."""

from __future__ import annotations

import numpy as np
import pytest

from dotsim_ros.data.presses import Press
from dotsim_ros.data.recording import Phase, Recording, phases_of
from dotsim_ros.gap.presses import shear
from dotsim_ros.gap.presses.observables import (
    PATCH_COUNT,
    SIZE,
    observe,
    places_of,
)
from dotsim_ros.gap.presses.patterns import LEANING, patterns
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin

APEX_M = 0.01575


@pytest.fixture(scope="module")
def skin() -> SkinMesh:
    return dome_skin(outer_radius_m=APEX_M, spacing_m=1.0e-3)


def recording_of(position_mm: list[list[float]], stamp_s: list[float]) -> Recording:
    poses = [Pose(1e-3 * np.array(p)) for p in position_mm]
    stamp = np.array(stamp_s)
    depth = np.array([APEX_M - pose.position_m[2] for pose in poses])
    press = Press("press", "sphere_4mm", poses, stamp)
    return Recording(press, load_indenter("sphere_4mm"), 0.0, depth, phases_of(poses, stamp, depth))


def test_the_phases_of_a_press_that_holds_slides_and_leaves() -> None:
    recording = recording_of(
        [
            [0, 0, 16],
            [0, 0, 15],
            [0, 0, 14],
            [0, 0.01, 14],
            [0.5, 0, 14],
            [1.0, 0, 13.9],
            [1.0, 0, 15.0],
            [1.0, 0, 16.0],
            [1.0, 0, 17.0],
        ],
        [0.0, 0.1, 0.2, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3],
    )
    assert [p.value for p in recording.phase] == [
        "idle",
        "load",
        "load",
        "hold",
        "slide",
        "slide",
        "release",
        "release",
        "idle",
    ]
    assert recording.has(Phase.HOLD)


def test_a_shift_of_the_whole_skin_is_seen_in_every_patch(skin: SkinMesh) -> None:
    recording = recording_of([[0, 0, 16], [0, 0, 14]], [0.0, 0.4])
    places = places_of(recording, skin)
    shift = np.array([1e-4, -2e-4, 3e-4])
    moved = np.stack([skin.rest_position_m, skin.rest_position_m + shift])
    seen = observe(places, skin.rest_position_m, moved, None, 2)
    assert seen.shape == (2, SIZE)
    patches = seen[:, : 3 * PATCH_COUNT].reshape(2, -1, 3)
    there = places.count > 0
    assert np.allclose(patches[0, there], 0.0)
    assert np.allclose(patches[1, there], places.axes @ shift)
    assert np.all(np.isnan(seen[:, -3:]))
    assert np.allclose(places.axes @ places.axes.T, np.eye(3))
    assert places.count.sum() == np.count_nonzero(~skin.on_base)


def test_forces_are_in_the_axes_of_the_slide(skin: SkinMesh) -> None:
    recording = recording_of([[0, 0, 16], [0, 0, 14], [0, 1, 14], [0, 2, 14]], [0.0, 0.4, 0.5, 0.6])
    places = places_of(recording, skin)
    assert np.allclose(places.axes[0], [0.0, 0.0, 1.0])
    assert np.allclose(places.axes[1], [0.0, 1.0, 0.0])
    force = np.array([[0.1, -0.7, 2.0]] * 4)
    seen = observe(places, skin.rest_position_m, None, force, 4)
    assert np.allclose(seen[:, -3:], [[2.0, -0.7, -0.1]] * 4)
    assert np.all(np.isnan(seen[:, :-3]))


@pytest.mark.parametrize("way", [[1.0, 0.0, 0.0], [0.6, -0.8, 0.0]])
def test_a_slide_there_and_back_has_the_axes_of_its_way_out(
    skin: SkinMesh, way: list[float]
) -> None:
    out = [[0.0, 0.0, 16.0], [0.0, 0.0, 14.0]]
    out += [[share * way[0], share * way[1], 14.0] for share in (0.5, 1.0, 0.5, 0.0)]
    axes = places_of(recording_of(out, [0.0, 0.4, 0.5, 0.6, 0.7, 0.8]), skin).axes
    assert np.allclose(axes[1], way)
    assert np.allclose(axes @ axes.T, np.eye(3))


def test_patterns_lean_with_the_force_parallel_to_the_base_whatever_the_axes(
    skin: SkinMesh,
) -> None:
    recording = recording_of([[0, 0, 16], [0, 0, 15], [0, 0, 14]], [0.0, 0.1, 0.2])
    axes = places_of(recording, skin).axes
    turned = np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])
    base = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [3.0, 0.0, 4.0]])
    for rows in (axes, turned):
        predicted = np.zeros((3, SIZE))
        predicted[:, 3 * PATCH_COUNT :] = base @ rows.T
        leaning = patterns(recording, predicted, rows)[-len(LEANING) :]
        assert np.allclose(leaning[:, :2], 0.0)
        # Of the last patch, which is of the base: along x alone, by the force's share there.
        moved = leaning[-1, 2, 3 * PATCH_COUNT - 3 : 3 * PATCH_COUNT] @ rows
        assert moved[0] == pytest.approx(0.6 * 0.01 * recording.depth_m[2])
        assert np.allclose(moved[1:], 0.0)


def slid_and_let_go(way_mm: list[float]) -> Recording:
    """Return a press that slides to each way along y, 2 mm deep, and leaves."""
    path = [[0.0, 0.0, 16.0], [0.0, 0.0, 13.75]]
    path += [[0.0, way, 13.75] for way in way_mm] + [[0.0, way_mm[-1], 16.0]]
    return recording_of(path, [0.0, 0.4, *(0.5 + 0.1 * np.arange(len(way_mm))), 2.0])


def test_a_slide_shows_its_stiffness_and_where_it_slips_and_the_skin_what_is_left(
    skin: SkinMesh,
) -> None:
    way_mm = [0.2, 0.4, 0.6, 1.0, 1.5]
    recording = slid_and_let_go(way_mm)
    places = places_of(recording, skin)
    # 1000 N/m up to 0.6 N, about a force that the press has given.
    force = np.zeros((8, 3))
    force[1:7, 1] = 0.05 - np.minimum(1e-3 * np.array([0.0, *way_mm]) * 1000.0, 0.6)
    moved = np.stack([skin.rest_position_m] * 8)
    moved[7] += [0.0, 3e-5, -2e-5]
    seen = observe(places, skin.rest_position_m, moved, force, 8)
    assert shear.tangential_stiffness(recording, places, seen) == pytest.approx(1000.0)
    assert shear.slip_onset_m(recording, places, seen) == pytest.approx(0.6e-3)
    assert shear.left_inward_m(recording, places, seen) == pytest.approx(2e-5)
    assert shear.left_along_m(recording, places, seen) == pytest.approx(3e-5)
    # What sticks to the end does not show where it slips; what slips at once, not how stiff it is.
    force[1:7, 1] = -np.array([0.0, *way_mm])
    sticking = observe(places, skin.rest_position_m, None, force, 8)
    assert np.isnan(shear.slip_onset_m(recording, places, sticking))
    force[2:7, 1] = -0.6
    slipping = observe(places, skin.rest_position_m, None, force, 8)
    assert np.isnan(shear.tangential_stiffness(recording, places, slipping))
    assert np.isnan(shear.left_inward_m(recording, places, slipping))
    pressed = recording_of([[0, 0, 16], [0, 0, 14]], [0.0, 0.4])
    alone = observe(places_of(pressed, skin), skin.rest_position_m, moved[:2], force[:2], 2)
    for quantity in shear.QUANTITIES.values():
        assert np.isnan(quantity.of(pressed, places_of(pressed, skin), alone))
