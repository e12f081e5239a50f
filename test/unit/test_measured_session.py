# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""When trajectories began within a session, from real bags of data sets that are written here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dotsim_ros.data.data_set_writer import write_data_set
from dotsim_ros.data.measurement import read_measurement, read_poses
from dotsim_ros.data.presses import Press
from dotsim_ros.data.recording import Recording, phases_of, session_starts
from dotsim_ros.data.trajectory import ImageChannel, PoseChannel, Trajectory, WrenchChannel
from dotsim_ros.effects.excitation import presses_late
from dotsim_ros.gap.find import channels_of
from dotsim_ros.gap.images.reading import read_images
from dotsim_ros.gap.presses.covariance import fit_discrepancy
from dotsim_ros.gap.presses.observables import SIZE
from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.specification import load_sensor

SENSOR = load_sensor("densetact2")
SKIN = skin_of(SENSOR.gel)
DEPTH_M = 1e-3 * np.array([-0.5, 0.2, 0.7, 1.2, 1.7, 2.2])
BALL = load_indenter("sphere_4mm")


def press(
    name: str, start_s: float, *, with_force: bool = True, with_images: bool = False
) -> Trajectory:
    """Return a press at the apex that takes 2 s."""
    stamp_ns = np.round(1e9 * (start_s + 0.4 * np.arange(len(DEPTH_M)))).astype(np.int64)
    position = np.zeros((len(DEPTH_M), 3))
    position[:, 2] = SENSOR.gel.outer_radius_m - DEPTH_M
    force = np.zeros_like(position)
    force[:, 2] = 2e4 * np.maximum(DEPTH_M, 0.0) ** 1.5
    pixels = np.random.default_rng(0).integers(0, 255, (len(DEPTH_M), 60, 80, 3))
    return Trajectory(
        pose=PoseChannel(stamp_ns, position, np.tile([0.0, 0.0, 0.0, 1.0], (len(DEPTH_M), 1))),
        wrench=WrenchChannel(stamp_ns, force, np.zeros_like(force)) if with_force else None,
        image=ImageChannel(stamp_ns, pixels.astype(np.uint8)) if with_images else None,
        name=name,
    )


def written(folder: Path, *trajectories: Trajectory) -> Path:
    idle = [np.random.default_rng(1).integers(60, 200, (60, 80, 3)).astype(np.uint8)] * 2
    has_images = any(one.image is not None for one in trajectories)
    write_data_set(
        folder,
        [(one, BALL) for one in trajectories],
        idle_images=idle if has_images else [],
    )
    return folder


def test_when_trajectories_began():
    for spans, starts in (
        # One clock: pauses count, and so does the order of the stamps, not that of the index.
        ([(2800.0, 2802.0), (1000.0, 1002.0)], [1800.0, 0.0]),
        ([(1000.0, 1002.0), None, (1010.0, 1012.0)], [0.0, 0.0, 10.0]),
        # A clock that begins again with each trajectory.
        ([(1.0, 3.0), None, (1.0, 2.0), (1.0, 4.0)], [0.0, 2.0, 2.0, 3.0]),
        ([], []),
    ):
        assert session_starts(spans) == starts


def test_a_pause_between_recordings_counts(tmp_path):
    times_s = {"press_0": 1000.0, "press_1": 1003.0, "press_2": 2800.0}
    data = written(tmp_path / "data", *(press(*one) for one in times_s.items()))
    recordings = read_measurement(data, own_skin=SKIN).recordings
    assert [r.session_s for r in recordings] == pytest.approx([0.0, 3.0, 1800.0])
    assert [presses_late(r) for r in recordings] == [False, False, True]
    planned, _ = read_poses(data, skin=SKIN)
    assert [r.session_s for r in planned] == pytest.approx([0.0, 3.0, 1800.0])


def test_a_trajectory_that_is_left_out_took_its_time(tmp_path):
    names = ("press_0", "press_1", "press_2")
    each = [press(name, 1.0, with_force=name != "press_1", with_images=True) for name in names]
    data = written(tmp_path / "data", *each)
    measurement = read_measurement(data, own_skin=SKIN, images=True)
    assert [r.name for r in measurement.recordings] == ["press_0", "press_2"]
    assert [r.session_s for r in measurement.recordings] == pytest.approx([0.0, 4.0])
    images = read_images(measurement, sensor=SENSOR)
    starts_s = [one.recording.session_s for one in images.trajectories]
    assert starts_s == pytest.approx([0.0, 2.0, 4.0])


def test_data_that_hold_images_alone_are_searched_by_their_images(tmp_path):
    each = [press(f"press_{k}", 1.0, with_force=False, with_images=True) for k in (0, 1)]
    alone = written(tmp_path / "alone", *each)
    assert channels_of(alone) == ("image",)
    both = written(tmp_path / "both", press("press_0", 1.0, with_images=True))
    assert channels_of(both) == ("skin", "force", "image")
    # What is wrong with a bag that cannot be read is told by reading it.
    for path in (alone / "bags" / "press_0").iterdir():
        path.write_bytes(b"")
    assert channels_of(alone) == ("skin", "force", "image")


def recording_of_depths(depth_m: FloatArray) -> Recording:
    poses = [Pose(np.array([0.0, 0.0, SENSOR.gel.outer_radius_m - d])) for d in depth_m]
    stamp_s = 0.1 * np.arange(len(depth_m))
    measured = Press("press", BALL.name, poses, stamp_s, force_n=np.ones((len(depth_m), 3)))
    return Recording(measured, BALL, 0.0, depth_m, phases_of(poses, stamp_s, depth_m))


def test_a_trajectory_that_presses_nothing_tells_nothing_of_the_discrepancy():
    random = np.random.default_rng(2)
    deep = recording_of_depths(np.array([0.2e-3, 0.8e-3, 1.4e-3]))
    idle = recording_of_depths(np.full(3, -1e-3))
    residuals = [1e-5 * random.standard_normal((3, SIZE)) for _ in range(3)]
    with_idle = fit_discrepancy([deep, idle, deep], residuals, "three presses")
    without = fit_discrepancy([deep, deep], [residuals[0], residuals[2]], "two presses")
    assert np.array_equal(with_idle.between, without.between)
    assert np.array_equal(with_idle.within, without.within)
    with pytest.raises(ValueError, match=r"no frame of one press is deeper than 0\.5 mm"):
        fit_discrepancy([idle], residuals[:1], "one press")
