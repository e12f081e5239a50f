# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The time that is left, as it is printed."""

from __future__ import annotations

import pytest

from dotsim_ros import progress
from dotsim_ros.gap.presses.search_state import SolveProgress
from dotsim_ros.progress import PrintedProgress


def test_the_time_left_follows_the_rate_since_the_first_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    told = PrintedProgress()
    told("solve", 0, 40)
    # Parts of several: none of them falls on a tenth.
    for done in (13, 26, 39):
        clock[0] += 26.0
        told("solve", done, 40)
    told("refit", 5, 10)
    clock[0] += 3.0
    told("refit", 8, 10)
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "solve: 13/40, 54 s left",
        "solve: 26/40, 28 s left",
        "solve: 39/40, 2 s left",
        # How long the first five took is not known.
        "refit: 5/10",
        "refit: 8/10, 2 s left",
    ]


def test_solves_count_over_the_steps_that_are_planned() -> None:
    told: list[tuple[str, int, int]] = []
    solving = SolveProgress(lambda *one: told.append(one), later=60)
    solving(0, 40)
    solving(40, 40)
    solving.begin_last()
    # Some of what was planned is known already.
    solving(0, 50)
    solving(50, 50)
    assert told == [
        ("solve", 0, 100),
        ("solve", 40, 100),
        ("solve", 40, 90),
        ("solve", 90, 90),
    ]
