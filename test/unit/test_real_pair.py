# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A press told from one image: on an image that was made of a known press, it is found again."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from dotsim_ros.optics.idle import LitDisc
from dotsim_ros.optics.lighting import Lighting, Vignetting
from dotsim_ros.specification import SolverSpecification, load_sensor
from studies.optics import real_pair
from studies.optics.real_pair import (
    BallPose,
    PressSearch,
    RealPair,
    evaluate_real_pair,
    pattern_likeness,
)

PX = 96
DISC = LitDisc((47.5, 47.5), 45.0, 90.0)
SENSOR = load_sensor("densetact2")
COARSE = replace(
    SENSOR,
    gel=replace(SENSOR.gel, skin_spacing_m=1.5e-3),
    solver=SolverSpecification(grid_spacing_m=4.0e-3, refined=False, friction_passes=1),
)
TRUTH = BallPose(0.25, 0.15, 2.0e-3)


def pattern() -> NDArray[np.uint8]:
    """Return a lit disc with a random pattern."""
    random = np.random.default_rng(0)
    noise = cv2.GaussianBlur(random.standard_normal((PX, PX, 3)), (0, 0), 1.5)
    levels = np.clip(120.0 + 160.0 * noise, 20.0, 235.0)
    return (levels * disc_mask()[..., None]).astype(np.uint8)


def disc_mask() -> NDArray[np.bool_]:
    """Return the lit disc."""
    y, x = np.mgrid[:PX, :PX]
    return np.asarray(np.hypot(x - 47.5, y - 47.5) < 45.0)


def pair_of(pressed: NDArray[np.uint8]) -> RealPair:
    """Return the pattern with a pressed image."""
    return RealPair(pattern(), pressed, disc_mask())


def search_of(pressed: NDArray[np.uint8]) -> PressSearch:
    return PressSearch(pair_of(pressed), COARSE, DISC, Lighting(), Vignetting())


def test_a_known_press_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    search = search_of(pattern())
    pressed = search.warping.warp(search.view(TRUTH))
    start = BallPose(0.2, 0.2, 1.5e-3)
    monkeypatch.setattr(real_pair, "EVALUATIONS", 30)
    found, view = search.best(
        {start: search.view(start)},
        lambda v: -pattern_likeness(search.warping.warp(v), pressed, disc_mask()),
    )
    assert (found.x, found.y) == pytest.approx((TRUTH.x, TRUTH.y), abs=0.03)
    assert found.depth_m == pytest.approx(TRUTH.depth_m, abs=0.3e-3)
    warped = search.warping.warp(view)
    left = 1.0 - pattern_likeness(warped, pressed, disc_mask())
    assert left < 0.3 * (1.0 - pattern_likeness(pattern(), pressed, disc_mask()))


def test_the_rows_of_a_pair(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(real_pair, "GRID_OFFSETS", (0.0,))
    monkeypatch.setattr(real_pair, "GRID_DEPTHS_M", (1.0e-3,))
    monkeypatch.setattr(real_pair, "EVALUATIONS", 4)
    pressed = (0.9 * pattern()).astype(np.uint8)
    figures = evaluate_real_pair(search_of(pressed))
    rows = figures["rows"]
    assert set(rows) == {"idle", "carried", "carried_by_pattern", "shaded", "shaded_by_pattern"}
    assert rows["idle"]["press"] is None
    # The unlit border never changes.
    assert rows["idle"]["psnr_db"] > rows["idle"]["mask"]["psnr_db"]


def test_likeness_is_of_the_pattern_not_of_the_light() -> None:
    image = pattern()
    shade = np.linspace(0.5, 1.0, PX)[None, :, None]
    shaded = (image * shade).astype(np.uint8)
    everywhere = disc_mask()
    assert pattern_likeness(image, image, everywhere) == pytest.approx(1.0)
    assert pattern_likeness(shaded, image, everywhere) > 0.95
    assert pattern_likeness(np.roll(image, 4, axis=1), image, everywhere) < 0.5


def test_the_place_of_change_is_where_the_image_changes() -> None:
    search = search_of(pattern())
    x, y = 0.3, -0.2
    place = np.array([x, y, np.sqrt(1.0 - x * x - y * y)]) * SENSOR.gel.outer_radius_m
    column, row = search.camera.project(place)
    pressed = pattern()
    cv2.circle(pressed, (round(float(column)), round(float(row))), 5, (250, 250, 250), -1)
    found = real_pair.place_of_change(pair_of(pressed), search.camera, SENSOR.gel.outer_radius_m)
    assert found == pytest.approx((x, y), abs=0.05)
