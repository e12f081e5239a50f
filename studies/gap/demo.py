# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`find-gap --demo`: searches one of a few small data sets that finite elements have solved, then
opens its truth.

The sets come with the package. `dotsim_ros hide` made them: what is wrong is part of what CalculiX
solves, and nothing of our own gel takes part. `docs/gap_study.md` says how the finder does on all
of them.
"""

from __future__ import annotations

from pathlib import Path

from dotsim_ros.files import parameter_path
from dotsim_ros.gap.find import find_gap
from dotsim_ros.printable import one_line
from dotsim_ros.progress import PrintedProgress
from dotsim_ros.worker_pool.pool import Crew
from studies.gap.solved_page import hidden_text
from studies.gap.solved_score import judged, opened_truth
from studies.hidden.solved_sets import read_series

SETS = "gap/demo"
TWIN = "sensor_a.yaml"
"""Beside the sets: calibrated with the series' commissioning."""
RIGHT = ("right", "in the set")


def run_demo(directory: Path, *, seed: int, workers: Crew) -> int:
    """Run the demonstration, with its report in a folder.

    Args:
        directory: of the report.
        seed: which of the sets, in turn; it says nothing about what is hidden there.
        workers: of the search.

    Returns:
        0 where the finder was right, else 1.

    Raises:
        ValueError: a set of the package was changed.
    """
    sets = parameter_path(SETS)
    _, records = read_series(sets)
    record = records[seed % len(records)]
    print(f"one of {len(records)} sets, its truth sealed, sha256 {record.truth_sha256}", flush=True)
    findings = find_gap(
        sets / record.name,
        sensor=sets / TWIN,
        out=directory,
        workers=workers,
        progress=PrintedProgress(),
    )
    truth = opened_truth(sets, record)
    outcome = judged(findings, truth)["outcome"]
    print(f"\n{one_line(findings.sentence)}")
    hidden = hidden_text(truth["effects"], truth["decoys"])
    print(f"hidden was {hidden} (sha256 {record.truth_sha256[:12]}...)")
    print(f"the finder was {'right' if outcome in RIGHT else 'wrong'}: {outcome}")
    return 0 if outcome in RIGHT else 1
