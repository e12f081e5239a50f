# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tests that did not run: note them while the others run, and refuse those without a known cause.

    PYTHONPATH=.ci pytest -p skips --skips FILE ...
    skips.py FILE

The first adds to a JSON file what was skipped, why, and the areas of docs/api/faults.md that it
would have shown answers of, and which files and tests ran. The second fails on a skip for a reason
that `KNOWN` does not list, or whose cause is not there, on a file below test/ of which nothing ran,
as where pytest leaves out a folder, and where there are fewer tests than .ci/test_count.json says:
a test must not stop running unseen.
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
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
COUNT = ROOT / ".ci" / "test_count.json"
"""How many tests the last release had, run or skipped one by one, and how many fewer may be: those
of files that skip themselves as a whole on some machines, and those taken out on purpose since."""
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
    "needs (all real presses|the measured data)|is not here|are not here|next to this checkout": (
        _without_measured_data
    ),
    "CalculiX is not installed": _without_program("ccx"),
    "needs chromium": _without_program("chromium", "google-chrome"),
    "launch_testing comes with a ROS installation": _without_module("launch_testing"),
    "launch(_ros)? comes with a ROS installation": _without_module("launch_ros"),
    "not installed in a workspace": _anywhere,  # only `colcon test` has it there
    "cannot be built here": _without_program("gcc"),
    "needs the extra dataset": lambda: any(_without_module(name)() for name in ("av", "pyarrow")),
    "lerobot is not installed": _without_module("lerobot"),
    "mani_skill is not installed": _without_module("mani_skill"),
    "mjlab is not installed": _without_module("mjlab"),
    "xarm_msgs is installed": lambda: not _without_module("xarm_msgs")(),
    "needs the right to mount": lambda: os.geteuid() != 0,
    "no disk can be mounted here": _anywhere,  # in most containers
    "LLVM": _anywhere,  # a library of the system, which no package of Python brings
    "Warp has no compiler for a GPU": _anywhere,  # a build of Warp without CUDA
    "single core|one core": lambda: (os.cpu_count() or 1) < 2 or len(os.sched_getaffinity(0)) < 2,
}
"""Reasons as the tests give them, and whether each holds on this machine."""

_found: list[dict[str, object]] = []
_files: set[str] = set()
_tests: set[str] = set()


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
    """Note the file, and a test that was skipped; one that is known to fail is none."""
    _files.add(_file_of(report.nodeid))
    _tests.add(report.nodeid)
    if report.skipped and not hasattr(report, "wasxfail"):
        _note(
            report, sorted({str(value) for name, value in report.user_properties if name == AREA})
        )


def pytest_collectreport(report: pytest.CollectReport) -> None:
    """Note a file that was skipped, and all areas that its tests would have shown."""
    if report.skipped:
        _files.add(_file_of(report.nodeid))
        path = ROOT / report.nodeid
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        _note(report, sorted(set(re.findall(r'mark\.fault\(\s*"([^"]+)"', text))))


def _file_of(nodeid: str) -> str:
    return nodeid.partition("::")[0]


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
    before = read(path) if path.is_file() else {"skips": [], "files": [], "tests": []}
    seen = {
        "skips": [*before["skips"], *_found],
        "files": sorted({*before["files"], *_files}),
        "tests": sorted({*before["tests"], *_tests}),
    }
    path.write_text(json.dumps(seen, indent=2) + "\n", encoding="utf-8")


def read(path: Path) -> dict[str, list[Any]]:
    """Return what was noted in a file: `skips`, and the `files` and `tests` that ran or were
    skipped."""
    noted: dict[str, list[Any]] = json.loads(path.read_text(encoding="utf-8"))
    return noted


def unexpected(skips: list[dict[str, object]]) -> list[str]:
    """Return a line for each skip that no known cause of this machine explains."""
    return [
        f"{skip['test']}: skipped: {skip['reason']}"
        for skip in skips
        if not any(
            re.search(reason, str(skip["reason"])) and holds() for reason, holds in KNOWN.items()
        )
    ]


def left_out(files: list[str], root: Path = ROOT) -> list[str]:
    """Return the files of tests in a checkout of which nothing ran."""
    there = {path.relative_to(root).as_posix() for path in (root / "test").rglob("test_*.py")}
    return sorted(there - set(files))


def lost(tests: list[str], count: dict[str, int]) -> str:
    """Return that there are too few tests, in one line; empty where there are enough."""
    expected = count["tests"] - count["allowance"]
    if len(tests) >= expected:
        return ""
    return (
        f"{len(tests)} tests, expected at least {expected}: the last release had {count['tests']}, "
        f"of which {count['allowance']} may be missing; find those that are not collected, or, if "
        f"they were taken out on purpose, raise the allowance in {COUNT.name}"
    )


def main() -> int:
    """Check what a file notes; return the exit status."""
    noted = read(Path(sys.argv[1]))
    wrong = unexpected(noted["skips"])
    print(f"{len(noted['skips'])} skipped, {len(wrong)} without a known cause", *wrong, sep="\n")
    if wrong:
        print("install what is missing, or name the cause in KNOWN of .ci/skips.py")
    missing = left_out(noted["files"])
    print(
        f"tests of {len(noted['files'])} files, {len(missing)} files left out", *missing, sep="\n"
    )
    if missing:
        print("pytest did not come to them: see how `make test` names the folders")
    fewer = lost(noted["tests"], json.loads(COUNT.read_text(encoding="utf-8")))
    print(fewer or f"{len(noted['tests'])} tests")
    return 1 if wrong or missing or fewer else 0


if __name__ == "__main__":
    sys.exit(main())
