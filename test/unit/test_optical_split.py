# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Splits of measured images: what is judged is never fitted on."""

from __future__ import annotations

import pytest

from studies.optics.split import LEVELS, WAYS, Recorded, optical_splits

RECORDINGS = [
    Recorded(f"{number}_shape_{k}", f"{number}_shape", 6 + k)
    for number in range(1, 7)
    for k in range(4)
]
FRAMES = {(r.name, frame) for r in RECORDINGS for frame in range(r.frame_count)}


def indenters(frames: tuple[tuple[str, int], ...]) -> set[str]:
    """Return the numbers of the indenters of frames."""
    return {name[0] for name, _ in frames}


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("way", WAYS)
def test_nothing_judged_is_fitted_on(level: str, way: str) -> None:
    split = optical_splits(RECORDINGS)[level][way]
    assert (split.level, split.way) == (level, way)
    assert not set(split.train) & set(split.test)
    assert set(split.train) | set(split.test) <= FRAMES
    assert list(split.train) == sorted(split.train)
    assert list(split.test) == sorted(split.test)


def test_levels_take_the_indenters_of_the_paper() -> None:
    splits = optical_splits(RECORDINGS)
    for way in WAYS:
        easy, medium, hard = (splits[level][way] for level in LEVELS)
        assert indenters(easy.train + easy.test) == {"1", "3"}
        assert indenters(medium.train + medium.test) == {"1", "2", "3", "4", "5", "6"}
        assert indenters(hard.train) == {"2", "4", "5", "6"}
        assert indenters(hard.test) == {"1", "3"}


@pytest.mark.parametrize("level", LEVELS)
def test_trajectories_stay_whole(level: str) -> None:
    split = optical_splits(RECORDINGS)[level]["by_trajectory"]
    assert not {name for name, _ in split.train} & {name for name, _ in split.test}


def test_neighbours_of_judged_frames_are_fitted_on_by_frame() -> None:
    split = optical_splits(RECORDINGS)["medium"]["by_frame"]
    train = set(split.train)
    beside = [(n, f - 1) in train or (n, f + 1) in train for n, f in split.test]
    assert sum(beside) > 0.8 * len(beside)


def test_a_longer_trajectory_of_another_level_changes_no_draw() -> None:
    more = [*RECORDINGS, Recorded("2_shape_9", "2_shape", 5)]
    assert optical_splits(more)["easy"] == optical_splits(RECORDINGS)["easy"]
