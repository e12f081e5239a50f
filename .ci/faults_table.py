# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Write docs/faults.md, the answers to bad input and faults, from what the tests saw; or check it.

    pytest --faults FILE ...
    faults_table.py FILE [--check]

The check demands the same faults with the same answers, in any order of the tests; a fault whose
test was not run or was skipped here is taken from the page as it stands.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "faults.md"
sys.path.insert(0, str(ROOT / "test"))

from conftest import AREAS  # noqa: E402

HEAD = """# Faults and their answers

What happens on bad input, and when something breaks. Each row is a test: it commits the fault on
the real reader, command or node, and the answer is what that test saw and checked. File names stand
for the paths that were given.

<!-- .ci/faults_table.py writes this page. -->
"""

Row = tuple[str, str]


def cell(text: str) -> str:
    """Return a text as the cell of a table."""
    return text.replace("|", "\\|").replace("<", "&lt;")


def rows_of(answers: list[dict[str, str]]) -> dict[str, set[Row]]:
    """Return fault and answer by area, as they stand on the page."""
    rows: dict[str, set[Row]] = {area: set() for area in AREAS}
    for answer in answers:
        rows[answer["area"]].add((cell(answer["fault"]), cell(answer["answer"])))
    return rows


def page(rows: dict[str, set[Row]]) -> str:
    """Return the page."""
    parts = [HEAD]
    for area in AREAS:
        if not rows[area]:
            continue
        lines = [f"| {fault} | {answer} |" for fault, answer in sorted(rows[area])]
        title = area[0].upper() + area[1:]
        parts.append(
            "\n".join([f"\n## {title}\n", "| fault | answer |", "| --- | --- |", *lines]) + "\n"
        )
    return "".join(parts)


def read_page(text: str) -> dict[str, set[Row]]:
    """Return the rows of a page that `page` made."""
    rows: dict[str, set[Row]] = {area: set() for area in AREAS}
    area = ""
    for line in text.splitlines():
        if line.startswith("## "):
            area = line[3].lower() + line[4:]
        elif line.startswith("| ") and not line.startswith(("| fault | answer", "| --- ")):
            fault, _, answer = line[2:-2].partition(" | ")
            rows[area].add((fault, answer))
    return rows


def main() -> int:
    """Write or check the page; return the exit status."""
    path = Path(sys.argv[1])
    now = rows_of(json.loads(path.read_text(encoding="utf-8")))
    if "--check" not in sys.argv[2:]:
        PAGE.write_text(page(now), encoding="utf-8")
        print(f"{sum(map(len, now.values()))} answers in {PAGE.relative_to(ROOT)}")
        return 0
    there = read_page(PAGE.read_text(encoding="utf-8"))
    wrong = 0
    for area in AREAS:
        faults = {fault for fault, _ in there[area]}
        for fault, answer in sorted(now[area] - there[area]):
            wrong += 1
            known = "another answer stands there" if fault in faults else "it is not there"
            print(f"{area}: {fault}: {answer} ({known})")
    if wrong:
        print(f"{PAGE.relative_to(ROOT)} is not what the tests saw: run make faults")
    return min(wrong, 1)


if __name__ == "__main__":
    sys.exit(main())
