# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The time that is left, as it is printed."""

from __future__ import annotations

from dotsim_ros.gap.presses.search import progress_of_two_steps
from dotsim_ros.io import progress
from dotsim_ros.io.progress import PrintedProgress


def test_the_time_left_follows_the_rate_since_the_first_is_told(monkeypatch, capsys):
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
    # Of a short time and a small share nothing is concluded.
    told("tables", 0, 100)
    clock[0] += 10.0
    told("tables", 20, 100)
    clock[0] += 50.0
    told("tables", 24, 100)
    told("tables", 30, 100)
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "solve: 13/40, 54 s left",
        "solve: 26/40, 28 s left",
        "solve: 39/40, 2 s left",
        # How long the first five took is not known.
        "refit: 5/10",
        "refit: 8/10, 2 s left",
        "tables: 20/100",
        "tables: 30/100, 140 s left",
    ]
    told("nulls", 0, 1000)
    clock[0] += progress.TOLD_AFTER_S
    told("nulls", 100, 1000)
    assert capsys.readouterr().err.splitlines() == ["nulls: 100/1000, 540 s left"]


def test_solves_count_over_the_steps_that_are_planned():
    told: list[tuple[str, int, int]] = []
    first, last = progress_of_two_steps(lambda *one: told.append(one), later=60)
    for done in (0, 20, 40):
        first(done, 40)
    # Some of what was planned is known already.
    last(0, 50)
    last(50, 50)
    # A press of the first step counts for 1.65 of the later ones.
    assert told == [
        ("solve", 0, 126),
        ("solve", 33, 126),
        ("solve", 66, 126),
        ("solve", 66, 116),
        ("solve", 116, 116),
    ]
