# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Taxim: Gaussians that keep the integral, a contact that keeps the object's shape, widths told."""

from __future__ import annotations

import numpy as np
import pytest

from dotsim_ros.data.presses import Press
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin, flat_pad_skin
from studies.rivals import taxim
from studies.rivals.clipping import clip_depths

RADIUS_M = 0.01575


@pytest.fixture(scope="module")
def skin() -> SkinMesh:
    return dome_skin(RADIUS_M, 8.0e-4)


def press_to(*depths_m: float) -> Press:
    poses = [Pose(np.array([0.0, 0.0, RADIUS_M - depth])) for depth in depths_m]
    return Press("press", "ball", poses, np.arange(len(poses), dtype=float))


def test_smoothing_keeps_the_integral_and_the_range(skin: SkinMesh) -> None:
    values = np.random.default_rng(0).uniform(0.0, 1.0, size=(skin.vertex_count, 2))
    smooth = taxim.skin_smoother(skin).smooth(values, 0.003)
    assert skin.rest_area_m2 @ smooth == pytest.approx(skin.rest_area_m2 @ values, rel=1e-12)
    assert smooth.min() >= values.min()
    assert smooth.max() <= values.max()
    assert smooth.std() < 0.2 * values.std()


def test_a_peak_spreads_as_the_gaussian_of_the_width_does() -> None:
    pad = flat_pad_skin((0.024, 0.024), 0.004, 4.0e-4)
    width = 0.0015
    peak = np.zeros((pad.vertex_count, 1))
    middle = np.argmin(np.linalg.norm(pad.rest_position_m[:, :2], axis=1))
    peak[middle] = 1.0 / pad.rest_area_m2[middle]
    smooth = taxim.skin_smoother(pad).smooth(peak, width)[:, 0]
    away = np.linalg.norm(pad.rest_position_m[:, :2] - pad.rest_position_m[middle, :2], axis=1)
    gaussian = np.exp(-0.5 * (away / width) ** 2) / (2.0 * np.pi * width**2)
    assert np.abs(smooth - gaussian).max() < 0.03 * gaussian.max()


def test_the_contact_keeps_the_shape_of_the_object(skin: SkinMesh) -> None:
    depth = clip_depths(skin, press_to(0.002).poses, sphere(0.004))
    smoother = taxim.skin_smoother(skin)
    sharp = taxim.Pyramid(0.002, 0.5, 0.5, 0.0)
    smooth = taxim.smoothed_depths(smoother, depth, sharp)
    core = depth > 0.5 * depth.max()
    assert np.array_equal(smooth[core], depth[core])
    # Next to the contact the gel is drawn in.
    beside = (depth == 0.0) & (smooth > 1.0e-4)
    assert beside.sum() > 20
    assert smooth.min() >= 0.0


def test_known_widths_are_told(skin: SkinMesh) -> None:
    truth = taxim.Taxim(taxim.Pyramid(0.0025, 0.4, 0.6, 2.0e-4), 900.0)
    press = press_to(0.001, 0.002, 0.003)
    seen = truth.predict(press, sphere(0.004), skin)
    measured = Press(
        "press", "ball", press.poses, press.stamp_s, seen.skin_position_m, seen.force_n
    )
    fitted = taxim.fit([measured], {"ball": sphere(0.004)}, skin, seed=1)
    assert fitted.stiffness_n_m == pytest.approx(900.0, rel=1e-9)
    again = fitted.predict(press, sphere(0.004), skin)
    error = np.abs(again.skin_position_m - seen.skin_position_m)
    motion = np.abs(seen.skin_position_m - skin.rest_position_m)
    assert np.sqrt(np.mean(error**2)) < 0.03 * np.sqrt(np.mean(motion**2))
    assert fitted.pyramid.widest_m == pytest.approx(0.0025, rel=0.25)
