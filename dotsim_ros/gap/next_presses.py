# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the trajectories to record next as a data set of poses, which `indenter_player` and an arm
can run."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dotsim_ros.data.data_set import DataSet, find_indenter
from dotsim_ros.data.data_set_writer import DataSetWriter
from dotsim_ros.data.trajectory import PoseChannel, Trajectory
from dotsim_ros.gap.findings import Question
from dotsim_ros.io.replacement import note_made

FOLDER = "next"
"""Below that of the report."""


def write_questions(
    out: Path,
    questions: Sequence[Question],
    data_set: DataSet,
    indenters: Path | None = None,
) -> None:
    """Write trajectories into `OUT/next`, whole or not at all: their index has the path of each in
    words, its seconds, and its information.

    Args:
        out: folder of the report, which has none of this name.
        questions: at least one.
        data_set: that was searched; its indenters press.
        indenters: folder of their meshes; None as `DataSet.indenter_file`.
    """
    with tempfile.TemporaryDirectory(prefix=f".{FOLDER}.", dir=out) as folder:
        part = Path(folder) / FOLDER
        writer = DataSetWriter(part)
        for question in questions:
            stamp_ns = np.round(1e9 * np.array(question.stamp_s)).astype(np.int64)
            position_m, quaternion_xyzw = np.split(np.array(question.poses), [3], axis=1)
            pose = PoseChannel(stamp_ns, position_m, quaternion_xyzw)
            notes = {
                "path": question.path,
                "seconds": round(question.seconds, 1),
                "information_nats": round(question.information_nats, 4),
                "nats_a_minute": round(60.0 * question.information_nats / question.seconds, 3),
                "apart_nats": {name: round(v, 3) for name, v in question.apart_nats.items()},
            }
            trajectory = Trajectory(pose=pose, name=question.name)
            writer.add(trajectory, find_indenter(data_set, question.indenter, indenters), notes)
        os.replace(part, out / FOLDER)
    note_made(out, FOLDER)
