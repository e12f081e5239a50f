# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The demonstration: the real node, real presses, a bag, a video and a contact sheet."""

import subprocess
import sys

import cv2
import imageio.v2 as imageio
import numpy as np

from dotsim_ros.measured.trajectory import RECORDED_TOPICS, read_trajectory


def test_demonstration_leaves_a_bag_a_video_and_a_sheet(tmp_path):
    command = [sys.executable, "-m", "dotsim_ros.cli.main", "demo", "--out", str(tmp_path)]
    done = subprocess.run(
        [*command, "--presses", "1", "--depth-mm", "1.5"],
        check=False,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        ".made.json",
        "presses",
        "presses.mp4",
        "presses.png",
    ]
    trajectory = read_trajectory(tmp_path / "presses", topics=RECORDED_TOPICS)
    force = np.linalg.norm(trajectory.wrench.force_n, axis=1)
    assert force.max() > 0.3
    assert force[-1] < 0.1 * force.max()
    images = trajectory.image.pixels.astype(float)
    strongest = int(np.argmin(np.abs(trajectory.image.stamp_ns - _peak_ns(trajectory))))
    assert np.abs(images[strongest] - images[0]).max() > 20.0
    assert len(list(imageio.get_reader(tmp_path / "presses.mp4").iter_data())) > 30
    assert cv2.imread(str(tmp_path / "presses.png")) is not None


def _peak_ns(trajectory):
    force = np.linalg.norm(trajectory.wrench.force_n, axis=1)
    return trajectory.wrench.stamp_ns[int(np.argmax(force))]
