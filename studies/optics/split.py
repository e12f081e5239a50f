# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which frames a model of images is fitted on, and which it is judged on.

Three levels as the paper draws them: easy (the first and the third indenter, 80 % to fit on and
20 % to judge on), medium (all indenters, likewise) and hard (the first and the third indenter are
judged, all others fitted on). Each is drawn twice:

- by frame: single frames are drawn. The frames before and after a judged one are then mostly among
  those fitted on and show nearly the same image, so the judged ones leak.
- by trajectory: whole trajectories are drawn, and no frame of a judged one is fitted on.

Hard separates indenters, and with them trajectories: its two draws are the same set.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

Level = Literal["easy", "medium", "hard"]
LEVELS: tuple[Level, ...] = get_args(Level)
WAYS = ("by_frame", "by_trajectory")
UNSEEN_RANKS = (0, 2)
"""Places, among the sorted names of the indenters, of the two that easy takes and hard leaves."""
TEST_SHARE = 0.2

FrameKey = tuple[str, int]
"""Name of a trajectory, and the number of a frame in it."""


@dataclass(frozen=True)
class Recorded:
    """A trajectory, as far as drawing needs it."""

    name: str
    indenter: str
    frame_count: int


@dataclass(frozen=True)
class OpticalSplit:
    """Frames to fit on and to judge on, each sorted.

    Attributes:
        level: one of `LEVELS`.
        way: one of `WAYS`.
        train, test: (name of the trajectory, number of the frame).
    """

    level: str
    way: str
    train: tuple[FrameKey, ...]
    test: tuple[FrameKey, ...]


def optical_splits(
    trajectories: Iterable[Recorded], *, seed: int = 0
) -> dict[str, dict[str, OpticalSplit]]:
    """Return the splits by level and way; the order of the trajectories does not matter.

    Args:
        trajectories: those that hold images.
        seed: of the draws.

    Raises:
        ValueError: a name twice, or fewer than three indenters.
    """
    ordered, unseen = sorted_with_unseen(trajectories)
    apart = [trajectory for trajectory in ordered if trajectory.indenter in unseen]
    others = [trajectory for trajectory in ordered if trajectory.indenter not in unseen]
    drawn = {"easy": apart, "medium": ordered}
    splits = {
        level: {way: _draw(level, way, members, seed) for way in WAYS}
        for level, members in drawn.items()
    }
    splits["hard"] = {
        way: OpticalSplit("hard", way, frames_of(others), frames_of(apart)) for way in WAYS
    }
    return splits


def sorted_with_unseen(trajectories: Iterable[Recorded]) -> tuple[list[Recorded], tuple[str, ...]]:
    """Return trajectories by name, and the two indenters that easy takes and hard leaves.

    Raises:
        ValueError: a name twice, or fewer than three indenters.
    """
    ordered = sorted(trajectories, key=lambda trajectory: trajectory.name)
    names = [trajectory.name for trajectory in ordered]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"names of trajectories must differ, got {', '.join(twice)} twice")
    indenters = sorted({trajectory.indenter for trajectory in ordered})
    if len(indenters) <= max(UNSEEN_RANKS):
        raise ValueError(
            "two indenters are left out, so three are needed at least; got "
            f"{', '.join(indenters) or 'none'}"
        )
    return ordered, tuple(indenters[rank] for rank in UNSEEN_RANKS)


def frames_of(trajectories: Iterable[Recorded]) -> tuple[FrameKey, ...]:
    """Return all frames of trajectories."""
    return tuple((t.name, frame) for t in trajectories for frame in range(t.frame_count))


def _draw(level: str, way: str, members: Sequence[Recorded], seed: int) -> OpticalSplit:
    frames = frames_of(members)
    # Each draw has a stream of its own, so that one level's data does not shift another's.
    random = np.random.default_rng([seed, LEVELS.index(level), WAYS.index(way)])
    if way == "by_frame":
        test = {frames[index] for index in _drawn(random, len(frames))}
    else:
        chosen = {members[index].name for index in _drawn(random, len(members))}
        test = {frame for frame in frames if frame[0] in chosen}
    train = tuple(frame for frame in frames if frame not in test)
    return OpticalSplit(level, way, train, tuple(sorted(test)))


def _drawn(random: np.random.Generator, count: int) -> list[int]:
    size = int(np.ceil(TEST_SHARE * count - 1e-9))
    return [int(index) for index in random.choice(count, size=size, replace=False)]
