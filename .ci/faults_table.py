# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Write or check docs/api/faults.md, the answers to bad input and faults that the tests saw.

    pytest --faults FILE ...
    faults_table.py FILE [--check [--skips FILE]]

The check is for a run of all tests. It demands the same faults with the same answers, in any order
of the tests. A fault that no test showed must go, except in areas of which a test was skipped here,
as a file that .ci/skips.py made says.
"""

from __future__ import annotations

import argparse
import json
import runpy
import sys
from collections.abc import Set
from pathlib import Path

from skips import read

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "api" / "faults.md"
# By its path: the tests have several files of this name.
AREAS: tuple[str, ...] = runpy.run_path(str(ROOT / "test" / "conftest.py"))["AREAS"]

HEAD = """# Faults and their answers

What happens on bad input, and when something breaks. Each row is a test: it commits the fault on
the real reader, command or node, and the answer is what that test saw and checked. File names stand
for the paths that were given.

<!-- .ci/faults_table.py writes this page. -->
"""

Row = tuple[str, str]


def cell(text: str) -> str:
    """Return a text as the cell of a table."""
    return text.replace("|", "\\|").replace("<", "&lt;").replace("[", "\\[")


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


def differences(
    there: dict[str, set[Row]], now: dict[str, set[Row]], skipped: Set[str]
) -> list[str]:
    """Return a line for each row of the page that the tests saw otherwise.

    Args:
        there: rows of the page.
        now: what the tests saw.
        skipped: areas of which tests were skipped.
    """
    found = []
    for area in AREAS:
        faults = {fault for fault, _ in there[area]}
        for fault, answer in sorted(now[area] - there[area]):
            known = "another answer stands there" if fault in faults else "it is not there"
            found.append(f"{area}: {fault}: {answer} ({known})")
        shown = {fault for fault, _ in now[area]}
        for fault, answer in sorted(there[area] - now[area]):
            if fault in shown or area not in skipped:
                found.append(f"{area}: {fault}: {answer} (no test saw this)")
    return found


def main() -> int:
    """Write or check the page; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("file", type=Path, help="what the tests saw")
    parser.add_argument("--check", action="store_true", help="compare only, and write nothing")
    parser.add_argument("--skips", type=Path, help="which tests were skipped")
    given = parser.parse_args()
    now = rows_of(json.loads(given.file.read_text(encoding="utf-8")))
    if not any(now.values()):
        print(f"{given.file} holds no answer: no test of a fault was run")
        return 1
    if not given.check:
        PAGE.write_text(page(now), encoding="utf-8")
        print(f"{sum(map(len, now.values()))} answers in {PAGE.relative_to(ROOT)}")
        return 0
    skips = read(given.skips)["skips"] if given.skips else []
    skipped = {area for skip in skips for area in skip["areas"]}
    wrong = differences(read_page(PAGE.read_text(encoding="utf-8")), now, skipped)
    if wrong:
        print(
            *wrong, f"{PAGE.relative_to(ROOT)} is not what the tests saw: run make faults", sep="\n"
        )
    return min(len(wrong), 1)


if __name__ == "__main__":
    sys.exit(main())
