# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One round of the faults that the soak study commits for hours, on coarse gels."""

from __future__ import annotations

from studies.run import FAILED
from studies.speed.soak import FAULTS, Numbered, soak


def test_a_gap_between_numbers_is_what_was_missed() -> None:
    found = Numbered()
    for number in (7, 8, 11):
        found.note(0, number)
    assert (found.received, found.missed, found.last) == (3, 2, 11)


def test_a_round_of_all_faults_loses_nothing_that_is_not_reported() -> None:
    found = soak(hours=0.0, grid_spacing_m=0.0048)
    assert found[FAILED] == []
    assert set(found["recovery_s"]) == set(FAULTS)
    assert (found["rounds"], found["lockstep_lost"]) == (1, 0)
