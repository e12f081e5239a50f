# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`find-gap --demo`: searches one of a few small data sets that finite elements have solved, then
opens its truth.

The sets come with the package. What is wrong is part of what CalculiX solved, and nothing of our
own gel takes part. `docs/gap_study.md` says how the finder does on all of them.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from dotsim_ros.gap.find import find_gap
from dotsim_ros.io.documents import read_json
from dotsim_ros.io.files import parameter_path
from dotsim_ros.io.printable import one_line
from dotsim_ros.io.progress import PrintedProgress
from dotsim_ros.io.worker_pool.pool import Crew

SETS = "gap/demo"
TWIN = "sensor_a.yaml"
"""Next to the sets: calibrated with the series' commissioning."""


def sealed_text(path: Path, sha256: str, advice: str) -> str:
    """Return the text of a truth; to be called after the search of its set.

    Raises:
        ValueError: it was.
    """
    text = path.read_text(encoding="utf-8")
    if hashlib.sha256(text.encode()).hexdigest() != sha256:
        raise ValueError(f"{path} is not the truth whose SHA-256 the index states; {advice}")
    return text


def run_demo(directory: Path, *, seed: int, workers: Crew) -> int:
    """Run the demonstration, with its report in a folder.

    Args:
        directory: of the report.
        seed: which of the sets, in turn.
        workers: of the search.

    Returns:
        0 where the finder was right, else 1.

    Raises:
        ValueError: a set of the package was changed.
    """
    sets = parameter_path(SETS)
    entries = read_json(sets / "index.json")["sets"]
    entry = entries[seed % len(entries)]
    sealed = entry["truth_sha256"]
    print(f"one of {len(entries)} sets, its truth sealed, sha256 {sealed}", flush=True)
    findings = find_gap(
        sets / entry["name"],
        sensor=sets / TWIN,
        out=directory,
        workers=workers,
        progress=PrintedProgress(),
    )
    file = sets / entry["name"] / "truth.json"
    effects = json.loads(sealed_text(file, sealed, "install the package again"))["effects"]
    hidden = {effect["library"] for effect in effects}
    named = set(findings.named)
    is_right = named <= hidden <= named | set(findings.alternatives)
    sizes = ", ".join(f"{e['name']} {e['size']:.3g} {e['unit']}" for e in effects) or "nothing"
    print(f"\n{one_line(findings.sentence)}")
    print(f"hidden was {sizes} (sha256 {sealed[:12]}...)")
    print(f"the finder was {'right' if is_right else 'wrong'}")
    return 0 if is_right else 1
