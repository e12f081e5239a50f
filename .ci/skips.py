# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tests that were skipped: note them while the tests run, and refuse those without a known cause.

    PYTHONPATH=.ci pytest -p skips --skips FILE ...
    skips.py FILE

The first adds each skip to a JSON file: what was skipped, why, and the areas of docs/faults.md that
it would have shown answers of. The second fails on a skip for a reason that `KNOWN` does not list,
or whose cause is not there: a test must not stop running unseen.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
AREA = "area"


def _without_program(*names: str) -> Callable[[], bool]:
    return lambda: not any(map(shutil.which, names))


def _without_module(name: str) -> Callable[[], bool]:
    return lambda: importlib.util.find_spec(name) is None


def _without_measured_data() -> bool:
    return not (ROOT.parent / "shared").is_dir()


def _anywhere() -> bool:
    return True


KNOWN: dict[str, Callable[[], bool]] = {
    "needs (all real presses|the measured data)|is not here|are not here|beside this checkout": (
        _without_measured_data
    ),
    "CalculiX is not installed": _without_program("ccx"),
    "needs chromium": _without_program("chromium", "google-chrome"),
    "launch_testing comes with a ROS installation": _without_module("launch_testing"),
    "launch(_ros)? comes with a ROS installation": _without_module("launch_ros"),
    "not installed in a workspace": _anywhere,  # only `colcon test` has it there
    "cannot be built here": _without_program("gcc"),
    "xarm_msgs is installed": lambda: not _without_module("xarm_msgs")(),
    "needs the right to mount": lambda: os.geteuid() != 0,
    "no disk can be mounted here": _anywhere,  # in most containers
    "LLVM": _anywhere,  # a library of the system, which no package of Python brings
    "single core|one core": lambda: (os.cpu_count() or 1) < 2 or len(os.sched_getaffinity(0)) < 2,
}
"""Reasons as the tests give them, and whether each holds on this machine."""

_found: list[dict[str, object]] = []


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--skips FILE`."""
    parser.addoption("--skips", type=Path, help="JSON file that skipped tests are added to")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let the reports of tests of faults name their area."""
    for item in items:
        marker = item.get_closest_marker("fault")
        if marker is not None:
            item.user_properties.append((AREA, marker.args[0]))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Note a test that was skipped; one that is known to fail is none."""
    if report.skipped and not hasattr(report, "wasxfail"):
        _note(
            report, sorted({str(value) for name, value in report.user_properties if name == AREA})
        )


def pytest_collectreport(report: pytest.CollectReport) -> None:
    """Note a file that was skipped, and all areas that its tests would have shown."""
    if report.skipped:
        path = ROOT / report.nodeid
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        _note(report, sorted(set(re.findall(r'mark\.fault\(\s*"([^"]+)"', text))))


def _note(report: pytest.TestReport | pytest.CollectReport, areas: list[str]) -> None:
    # (file, line, "Skipped: reason")
    said = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
    reason = str(said).removeprefix("Skipped: ")
    _found.append({"test": report.nodeid, "reason": reason, "areas": areas})


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Add what was noted to the file, in the process that the workers report to."""
    path: Path | None = session.config.getoption("--skips")
    if path is None or hasattr(session.config, "workerinput"):
        return
    before = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else []
    path.write_text(json.dumps([*before, *_found], indent=2) + "\n", encoding="utf-8")


def unexpected(skips: list[dict[str, object]]) -> list[str]:
    """Return a line for each skip that no known cause of this machine explains."""
    return [
        f"{skip['test']}: skipped: {skip['reason']}"
        for skip in skips
        if not any(
            re.search(reason, str(skip["reason"])) and holds() for reason, holds in KNOWN.items()
        )
    ]


def main() -> int:
    """Check the skips of a file; return the exit status."""
    skips = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    wrong = unexpected(skips)
    print(f"{len(skips)} skipped, {len(wrong)} without a known cause", *wrong, sep="\n")
    if wrong:
        print("install what is missing, or name the cause in KNOWN of .ci/skips.py")
    return min(len(wrong), 1)


if __name__ == "__main__":
    sys.exit(main())
