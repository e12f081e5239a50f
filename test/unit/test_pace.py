# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frames by absolute deadlines, on times that are handed in."""

import pytest

from dotsim_ros.nodes.common.pace import FramePace


def run(pace, costs_s):
    """Start each frame as soon as it is due and free; return the starts."""
    now_s, starts = 0.0, []
    for cost_s in costs_s:
        now_s = max(now_s, pace.deadline_s())
        pace.begin(now_s)
        starts.append(now_s)
        now_s += cost_s
    return starts


def test_deadlines_do_not_drift():
    pace = FramePace(rate_hz=25.0, start_s=0.0)
    starts = run(pace, [0.01, 0.039, 0.02, 0.03] * 25)
    assert starts == pytest.approx([0.04 * index for index in range(100)])
    assert (pace.late, pace.dropped) == (0, 0)


def test_one_slow_frame_makes_the_next_late_and_drops_none():
    pace = FramePace(rate_hz=25.0, start_s=0.0)
    starts = run(pace, [0.06, 0.01, 0.01])
    assert starts == pytest.approx([0.0, 0.06, 0.08])
    assert (pace.late, pace.dropped) == (1, 0)


def test_passed_deadlines_are_dropped_and_counted():
    pace = FramePace(rate_hz=25.0, start_s=0.0)
    starts = run(pace, [0.21, 0.01, 0.01])
    assert starts == pytest.approx([0.0, 0.21, 0.24])
    assert pace.dropped == 4


def test_overload_lowers_the_rate_and_nothing_queues_up():
    pace = FramePace(rate_hz=25.0, start_s=0.0)
    starts = run(pace, [0.05] * 100)
    assert starts[-1] == pytest.approx(0.05 * 99)
    assert pace.deadline_s() - starts[-1] <= 0.04
    assert pace.dropped == pytest.approx(0.05 * 99 / 0.04 - 99, abs=1)


def test_a_pace_of_another_rate_goes_on_counting():
    pace = FramePace(rate_hz=25.0, start_s=0.0)
    run(pace, [0.06, 0.21, 0.01])
    other = pace.resumed(rate_hz=10.0, start_s=5.0)
    assert (other.deadline_s(), other.late, other.dropped) == (5.0, pace.late, pace.dropped)
    assert min(other.late, other.dropped) > 0
    # The machine may be fast enough for the new rate.
    assert pace.dropped_share > other.dropped_share == 0.0
    other.begin(5.25)
    assert other.dropped_share == 2 / 3
