# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""When each trajectory of a data set began, counted from the session's start.

Drifts and lamps that warm up depend on it, pauses between the recordings included.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from dotsim_ros.data.data_set import DataSetEntry
from dotsim_ros.data.trajectory import Topics, read_trajectory

Span = tuple[float, float]
"""First and last stamp of a trajectory, s."""


def session_starts(spans: Sequence[Span | None]) -> list[float]:
    """Return when each trajectory began, s; 0 for the first.

    If one clock ran on through all recordings, which shows in stamps that never overlap, that clock
    tells. If it began again with each, as that of a simulator does, they are taken to follow each
    other in the order given, without pauses.

    Args:
        spans: of the trajectories in the order of the index; None for one whose stamps cannot be
            read, which then takes no time.
    """
    known = sorted(span for span in spans if span is not None)
    if all(before[1] <= after[0] for before, after in pairwise(known)):
        begun_s = known[0][0] if known else 0.0
        return [0.0 if span is None else span[0] - begun_s for span in spans]
    starts = []
    passed_s = 0.0
    for span in spans:
        starts.append(passed_s)
        passed_s += 0.0 if span is None else span[1] - span[0]
    return starts


def span_of(entry: DataSetEntry, topics: Topics) -> Span | None:
    """Return the first and the last stamp of a trajectory's poses, None where it has none that can
    be read."""
    try:
        pose = read_trajectory(entry.bag, topics=topics, channels=("pose",)).pose
    except (FileNotFoundError, ValueError):
        return None
    if pose is None or not len(pose.stamp_ns):
        return None
    return 1e-9 * float(pose.stamp_ns[0]), 1e-9 * float(pose.stamp_ns[-1])
