# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The demonstration: the real node, real presses, a bag, a video and a contact sheet."""

import signal
import subprocess
import sys

import cv2
import imageio.v2 as imageio
import numpy as np

from dotsim_ros.cli.main import main
from dotsim_ros.data.trajectory import RECORDED_TOPICS, Topics, read_trajectory
from dotsim_ros.io.replacement import remove_made


def test_demonstration_leaves_a_bag_a_video_and_a_sheet(tmp_path):
    command = [sys.executable, "-m", "dotsim_ros.cli.main", "demo", "--out", str(tmp_path)]
    done = subprocess.run(
        [*command, "--presses", "1", "--depth-mm", "1.5"],
        check=False,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        ".made.json",
        "presses",
        "presses.mp4",
        "presses.png",
    ]
    trajectory = read_trajectory(tmp_path / "presses", topics=RECORDED_TOPICS)
    # In steps of simulated time no frame is dropped and none lags, whatever the machine does.
    assert np.all(np.diff(trajectory.image.stamp_ns) == 40_000_000)
    shown = read_trajectory(
        tmp_path / "presses", topics=Topics(pose="/indenter/state"), channels=["pose"]
    ).pose
    # A pose is read in the step after the one that it was sent in.
    read = np.searchsorted(trajectory.pose.stamp_ns, shown.stamp_ns - 10_000_000, side="right") - 1
    assert np.array_equal(shown.position_m[1:], trajectory.pose.position_m[read][1:])
    force = np.linalg.norm(trajectory.wrench.force_n, axis=1)
    assert force.max() > 0.3
    assert force[-1] < 0.1 * force.max()
    images = trajectory.image.pixels.astype(float)
    strongest = int(np.argmin(np.abs(trajectory.image.stamp_ns - _peak_ns(trajectory))))
    assert np.abs(images[strongest] - images[0]).max() > 20.0
    assert len(list(imageio.get_reader(tmp_path / "presses.mp4").iter_data())) > 30
    assert cv2.imread(str(tmp_path / "presses.png")) is not None


def test_what_an_interrupted_demonstration_leaves_is_its_own(tmp_path):
    command, bag = "demo --presses 1", "presses"
    started = subprocess.Popen(
        [sys.executable, "-m", "dotsim_ros.cli.main", *command.split(), "--out", str(tmp_path)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert started.stderr is not None
    said = []
    for line in started.stderr:
        said.append(line)
        if "tactile_record" in line and "receiving /" in line:
            break
    started.send_signal(signal.SIGINT)
    said.append(started.communicate(timeout=60)[1])
    assert started.returncode == 130, "".join(said)
    assert (tmp_path / bag / "metadata.yaml").is_file()
    # What the same command begins with.
    remove_made(tmp_path, bag)
    assert not (tmp_path / bag).exists()


def test_a_loop_on_a_pad_is_refused_before_a_file_is_written(tmp_path, capsys):
    out = tmp_path / "loop"
    assert main(["demo-loop", "--sensor", "gelsight_mini", "--out", str(out)]) == 1
    assert "'gelsight_mini' has the shape flat_pad; paths are for a dome" in capsys.readouterr().err
    assert not out.exists()


def _peak_ns(trajectory):
    force = np.linalg.norm(trajectory.wrench.force_n, axis=1)
    return trajectory.wrench.stamp_ns[int(np.argmax(force))]
