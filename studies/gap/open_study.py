# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the gap finder answers on data sets whose effect an independent solver has solved.

    python benchmarks/gap_open.py --data DIR --sensor sensor_a --json docs/results/gap_open.json

Each folder `open_*` of DIR is searched as `find-gap` searches it; only then is its truth read. The
seconds are those of the whole search; nothing is kept from one set for the next, but kernels and
the gel's tables are those of the user's cache.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

from dotsim_ros.documents import read_json
from dotsim_ros.files import write_json
from dotsim_ros.gap.find import find_gap
from dotsim_ros.progress import PrintedProgress
from dotsim_ros.provenance import provenance
from studies.gap.solved_score import outcome_of

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


def main() -> None:
    """Search the sets and print a line for each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True, help="folder of the data sets")
    parser.add_argument("--sensor", default="sensor_a", help="the twin")
    parser.add_argument("--sets", nargs="+", choices=list(HIDDEN), default=list(HIDDEN))
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    arguments = parser.parse_args()
    rows = [_searched(name, arguments) for name in arguments.sets]
    right = sum(row["outcome"] in ("right", "in the set") for row in rows)
    print(f"right, or in the set: {right} of {len(rows)}")
    if arguments.json is not None:
        figures = {"right_or_in_the_set": right, "of": len(rows), "sets": rows}
        write_json(arguments.json, {**figures, "provenance": provenance()})


def _searched(name: str, arguments: argparse.Namespace) -> dict[str, Any]:
    folder = arguments.data / name
    with tempfile.TemporaryDirectory() as out:
        findings = find_gap(
            folder,
            sensor=arguments.sensor,
            indenters=arguments.data / "sensor_a" / "indenters",
            out=Path(out),
            workers=arguments.workers,
            progress=PrintedProgress(),
        )
    verdict = findings.verdict.value
    row = {
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
    print(
        f"{name}: {verdict} {' '.join(findings.named)}, {row['outcome']} "
        f"({row['statistic']} of {row['threshold']}, {row['seconds']} s)",
        flush=True,
    )
    return row


if __name__ == "__main__":
    main()
