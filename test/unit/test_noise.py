# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The noise of the camera: what it is, where it comes from, and when it repeats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.optics.noise import with_noise
from dotsim_ros.sensor import Frame, TactileSensor
from dotsim_ros.specification import NoiseSpecification, SensorSpecification, load_sensor

LEVELS = 2.0


def specification(noise: NoiseSpecification) -> SensorSpecification:
    # Few pixels, and a coarse gel, which has no tables to compute.
    own = load_sensor("densetact2")
    camera = replace(own.camera, width=160, height=120, principal_point_px=(79.5, 59.5))
    solver = replace(own.solver, refined=False, grid_spacing_m=4.8e-3)
    return replace(own, camera=camera, solver=solver, noise=noise)


def sensor_with(noise: NoiseSpecification) -> TactileSensor:
    return TactileSensor(specification(noise), indenter=load_indenter("sphere_4mm"))


@pytest.fixture(scope="module")
def noisy() -> TactileSensor:
    return sensor_with(NoiseSpecification(LEVELS, seed=3))


def frames(sensor: TactileSensor) -> list[Frame]:
    poses = [Pose(np.array([0.0, 0.0, 0.0155 - 1e-4 * k])) for k in range(3)]
    return [sensor.step(None, 0.04), *(sensor.step(pose, 0.04) for pose in poses)]


def grey(level: int) -> ImageArray:
    return np.full((240, 320, 3), level, dtype=np.uint8)


def test_noise_has_its_deviation_and_no_offset() -> None:
    change = with_noise(grey(120), 4.0, 1).astype(float) - 120.0
    assert abs(change.mean()) < 0.1
    # Rounding to whole levels adds a twelfth to the variance.
    assert change.std() == pytest.approx(np.sqrt(16.0 + 1.0 / 12.0), rel=0.02)


def test_noise_stays_within_the_levels_and_on_what_is_lit() -> None:
    image = grey(0)
    image[:100] = 255
    noise = with_noise(image, 20.0, (0, 7))
    assert not noise[100:].any()
    assert noise[:100].min() < 220
    assert noise.dtype == np.uint8


def test_a_sensors_noise_is_drawn_by_its_seed_and_the_time(noisy: TactileSensor) -> None:
    noisy.reset()
    first = frames(noisy)
    clean = sensor_with(NoiseSpecification())
    plain = frames(clean)
    lit = plain[0].image.min(axis=2) > 50
    for with_it, without in zip(first, plain, strict=True):
        change = with_it.image.astype(float)[lit] - without.image[lit]
        assert change.std() == pytest.approx(LEVELS, rel=0.1)
        assert np.array_equal(with_it.depth_m, without.depth_m, equal_nan=True)
        assert np.array_equal(with_it.wrench.force_n, without.wrench.force_n)
    assert np.array_equal(noisy.idle_image, clean.idle_image)
    # The skin is at rest in both: only the noise differs.
    assert not np.array_equal(first[0].image, noisy.step(None, 0.04).image)


def test_the_noise_repeats_after_a_reset_unless_another_seed_is_given(
    noisy: TactileSensor,
) -> None:
    noisy.reset(noise_seed=3)
    first = [frame.image for frame in frames(noisy)]
    noisy.reset()
    again = [frame.image for frame in frames(noisy)]
    noisy.reset(noise_seed=4)
    other = [frame.image for frame in frames(noisy)]
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not any(np.array_equal(a, b) for a, b in zip(first, other, strict=True))
    with pytest.raises(ValueError, match=r"noise\.seed is -1, expected a whole number"):
        noisy.reset(noise_seed=-1)


def test_a_frame_shown_twice_has_the_same_noise(noisy: TactileSensor) -> None:
    noisy.reset()
    gel = noisy.press(None, 0.04)
    assert np.array_equal(noisy.see(gel, None).image, noisy.see(gel, None).image)
