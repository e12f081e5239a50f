# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A measured trajectory as the gap finder sees it: its motion split into phases, its place in the
session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np

from dotsim_ros.data.presses import Press
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, tip_depth_m
from dotsim_ros.io.arrays import FloatArray

STILL_M_S = 0.3e-3
"""An indenter that moves slower, and no farther than the noise of its pose, holds."""
STILL_M = 0.06e-3
TOUCH_M = 0.1e-3
"""A tip that is not deeper than this below the skin at rest presses nothing."""

Span = tuple[float, float]
"""First and last stamp of a trajectory, s."""


class Phase(Enum):
    """What the indenter does up to a frame."""

    IDLE = "idle"
    LOAD = "load"
    HOLD = "hold"
    SLIDE = "slide"
    RELEASE = "release"


@dataclass(frozen=True)
class Recording:
    """One measured trajectory.

    Attributes:
        press: poses, stamps, skin and force as measured.
        indenter: what pressed.
        session_s: time from the start of the data set's first trajectory to that of this one, by
            `session_starts`.
        depth_m: (F,) how deep the tip is below the skin at rest, along the skin's normal.
        phase: (F,) what the indenter does.
    """

    press: Press
    indenter: Indenter
    session_s: float
    depth_m: FloatArray
    phase: tuple[Phase, ...]

    @property
    def name(self) -> str:
        """Name of the trajectory."""
        return self.press.name

    def has(self, *phases: Phase) -> bool:
        """Return whether any frame is in one of the phases."""
        return any(phase in phases for phase in self.phase)


def phases_of(poses: Sequence[Pose], stamp_s: FloatArray, depth_m: FloatArray) -> tuple[Phase, ...]:
    """Return what the indenter does up to each of F frames, by the depths (F,) of its tip."""
    position = np.stack([pose.position_m for pose in poses])
    found = []
    for frame in range(len(poses)):
        before = max(0, frame - 1)
        duration = float(stamp_s[frame] - stamp_s[before]) or 1.0
        move = position[frame] - position[before]
        axis = poses[frame].rotation()[:, 2]
        inward = -float(move @ axis)
        across = float(np.linalg.norm(move + inward * axis))
        length = float(np.linalg.norm(move))
        is_still = length < max(STILL_M, STILL_M_S * duration)
        if max(depth_m[frame], depth_m[before]) < TOUCH_M:
            phase = Phase.IDLE
        elif is_still and frame:
            phase = Phase.HOLD
        elif across > abs(inward):
            phase = Phase.SLIDE
        else:
            phase = Phase.LOAD if inward >= 0.0 else Phase.RELEASE
        found.append(phase)
    return tuple(found)


def recording_of(
    press: Press, indenter: Indenter, skin: SkinMesh, session_s: float = 0.0
) -> Recording:
    """Return a press with its depths and phases; `skin` is at rest."""
    depth_m = np.asarray(tip_depth_m(skin, press.poses))
    phase = phases_of(press.poses, press.stamp_s, depth_m)
    return Recording(press, indenter, session_s, depth_m, phase)


def session_starts(spans_s: Sequence[Span | None]) -> list[float]:
    """Return when each trajectory began, s; 0 for the first.

    Drifts and lamps that warm up depend on it, pauses between the recordings included. If one clock
    ran on through all recordings, which shows in stamps that never overlap, that clock is used. If
    it began again with each, as that of a simulator does, they are taken to follow each other in
    the order given, without pauses.

    Args:
        spans_s: of the trajectories in the order of the index; None for one whose stamps cannot be
            read, which then takes no time.
    """
    known = sorted(span for span in spans_s if span is not None)
    if all(before[1] <= after[0] for before, after in pairwise(known)):
        begun_s = known[0][0] if known else 0.0
        return [0.0 if span is None else span[0] - begun_s for span in spans_s]
    starts = []
    passed_s = 0.0
    for span in spans_s:
        starts.append(passed_s)
        passed_s += 0.0 if span is None else span[1] - span[0]
    return starts
