# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the gap finder answers on data sets whose effect an independent solver has solved.

Each folder `open_*` of DIR is searched as `find-gap` searches it; only then is its truth read. The
seconds are those of the whole search; nothing is kept from one set for the next, but kernels and
the gel's tables are those of the user's cache.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from dotsim_ros.gap.find import find_gap
from dotsim_ros.io.documents import read_json
from dotsim_ros.io.progress import PrintedProgress
from studies.data import MEASURED
from studies.gap.solved_score import outcome_of
from studies.run import expect_known, expect_positive

HIDDEN: dict[str, set[str]] = {
    "open_none": set(),
    "open_none_2": set(),
    "open_friction": {"coulomb_slip"},
    "open_slippery": {"coulomb_slip"},
    "open_stiffening": {"hyperelastic_stiffening"},
    "open_relaxation": {"viscoelastic_relaxation"},
    "open_core": {"thickness_error"},
    "open_debonded": {"lost_bond"},
}
"""The library's names for what the sets' README says of them."""


def gap_open(
    *,
    data: Path = MEASURED,
    sensor: str = "sensor_a",
    sets: tuple[str, ...] = tuple(HIDDEN),
    workers: int = 2,
) -> dict[str, Any]:
    """What the gap finder answers on data sets whose effect an independent solver has solved.

    Args:
        data: folder of the data sets.
        sensor: name or file of the twin.
        sets: names of their folders.
        workers: processes.
    """
    expect_positive(workers=workers)
    expect_known("set", sets, HIDDEN)
    rows = [_searched(data, name, sensor, workers) for name in sets]
    return {
        "right_or_in_the_set": sum(row["outcome"] in ("right", "in the set") for row in rows),
        "of": len(rows),
        "sets": rows,
    }


def _searched(data: Path, name: str, sensor: str, workers: int) -> dict[str, Any]:
    folder = data / name
    with tempfile.TemporaryDirectory() as out:
        findings = find_gap(
            folder,
            sensor=sensor,
            indenters=data / "sensor_a" / "indenters",
            out=Path(out),
            workers=workers,
            progress=PrintedProgress(),
        )
    verdict = findings.verdict.value
    return {
        "set": name,
        "verdict": verdict,
        "named": list(findings.named),
        "alternatives": list(findings.alternatives),
        "nearest": [candidate.name for candidate in findings.candidates[:3]],
        "statistic": round(findings.statistic, 1),
        "threshold": round(findings.threshold, 1),
        "estimates": {
            candidate.name: {
                estimate.name: [estimate.value, estimate.low, estimate.high]
                for estimate in candidate.estimates
            }
            for candidate in findings.candidates
            if candidate.name in (*findings.named, *findings.alternatives)
        },
        "share_closed": findings.share_closed,
        "stability": findings.stability,
        "seconds": round(findings.seconds, 1),
        "truth": read_json(folder / "truth.json"),
        "outcome": outcome_of(verdict, findings.named, findings.alternatives, HIDDEN[name]),
    }
