# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The motions of `indenter_player` meet the sensor that it is told of, without ROS."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.nodes.indenter_player.parameters import PlayerParameters
from dotsim_ros.nodes.indenter_player.program import program_of
from dotsim_ros.specification import load_sensor

DOMES, PADS = ("densetact2", "sensor_a"), ("digit", "flat_pad", "gelslim", "nine_dtact")
DEPTH_M = 0.001


def tips_m(sensor: str, **parameters: object) -> FloatArray:
    """Return where the indenter's tip is, one row a pose."""
    given = replace(PlayerParameters(), sensor=sensor, depth_m=DEPTH_M, **parameters)
    motion = program_of(given).motion
    return np.array([pose.position_m for _, pose in motion.sampled(100.0)])


@pytest.mark.parametrize("sensor", [*DOMES, *PADS])
@pytest.mark.parametrize("source", ["press", "twist"])
def test_a_press_is_as_deep_as_it_is_told(sensor: str, source: str) -> None:
    top_m = load_sensor(sensor).gel.bounds_m[1][2]
    heights_m = tips_m(sensor, source=source)[:, 2]
    assert heights_m.min() == pytest.approx(top_m - DEPTH_M)
    assert heights_m[[0, -1]] == pytest.approx(top_m + 0.002)


@pytest.mark.parametrize("sensor", PADS)
def test_a_slide_on_a_pad_is_straight_and_as_fast_as_it_is_told(sensor: str) -> None:
    face_m = load_sensor(sensor).gel.thickness_m
    tips = tips_m(sensor, source="slide", slide_heading_deg=90.0)
    deep = tips[np.isclose(tips[:, 2], face_m - DEPTH_M)]
    ends_m = deep[[0, -1]]
    # Of 6 mm at 10 mm/s, 0.1 mm a pose.
    assert ends_m[1] - ends_m[0] == pytest.approx([0.0, 0.006, 0.0], abs=2e-4)
    assert np.median(np.diff(deep[:, 1])) == pytest.approx(1e-4)
    assert tips[-1, 2] == pytest.approx(face_m + 0.002)
    # Over the face and back to the start, where it is looped.
    looped = tips_m(sensor, source="slide", loop=True)
    assert looped[-1] == pytest.approx(looped[0])
    assert looped[len(tips) :, 2].min() > face_m


@pytest.mark.parametrize("sensor", DOMES)
def test_recorded_presses_meet_the_dome(sensor: str) -> None:
    own_m = load_sensor(sensor).gel.outer_radius_m
    distances_m = np.linalg.norm(tips_m(sensor, source="presses"), axis=1)
    assert distances_m.min() < own_m
    wider = tips_m(sensor, source="presses", outer_radius_m=own_m + 0.01)
    assert np.linalg.norm(wider, axis=1).min() == pytest.approx(distances_m.min() + 0.01, abs=1e-3)


@pytest.mark.parametrize(
    ("reason", "given"),
    [
        ("recorded on a dome, but the sensor 'digit' has a pad", {"source": "presses"}),
        ("tilt_deg is 20, but the sensor has a pad", {"tilt_deg": 20.0}),
        ("expected less than the thickness of the sensor's pad, 0.004 m", {"depth_m": 0.004}),
        ("leaves the pad", {"source": "slide", "slide_distance_m": 0.02}),
        ("no sensor is named 'no_such_sensor'", {"sensor": "no_such_sensor"}),
    ],
)
def test_what_a_pad_cannot_be_given_is_refused_with_the_reason(
    reason: str, given: dict[str, object]
) -> None:
    with pytest.raises((ValueError, OSError), match=reason):
        program_of(replace(PlayerParameters(), **{"sensor": "digit", **given}))
