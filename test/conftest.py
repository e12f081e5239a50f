# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Answers to bad input and faults, gathered into a table while the tests run.

A test marked `@pytest.mark.fault(area, what)` shows what becomes of one fault; it hands the words
that a user sees to the fixture `answered`, once it has checked them. With `--faults FILE` the
answers of all such tests that passed are added to a JSON file, of which `.ci/faults_table.py` makes
`docs/api/faults.md`.
"""

from __future__ import annotations

import gc
import json
import os
import re
import signal
from collections.abc import Callable, Generator
from pathlib import Path

import pytest

from dotsim_ros.io.files import cache_directory

PROPERTY = "fault"
AREAS = (
    "sensor and YAML files",
    "meshes",
    "bags and data sets",
    "calibrate",
    "find-gap",
    "effects and overlays",
    "networks and cards",
    "view",
    "recording",
    "node parameters",
    "messages",
    "simulated time",
    "environments",
    "scale-out",
)
"""The chapters of the table, in their order."""

SECONDS = Path(__file__).parent / "seconds.json"
"""What files of tests took on two cores, from `--durations=0`; those under 5 s are left out."""

_found: list[dict[str, str]] = []


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--faults FILE`."""
    parser.addoption(
        "--faults", type=Path, help="JSON file that the answers to faults are added to"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Declare the markers, and let Ctrl-C reach what the tests start: a program that a shell starts
    in the background ignores it, and so would all that it starts."""
    # A test that keeps its tables elsewhere need not compile all kernels again.
    os.environ.setdefault("WARP_CACHE_PATH", str(cache_directory() / "warp"))
    # Some hundred processes import the same: a second each where no bytecode is kept.
    if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):
        os.environ.setdefault("PYTHONPYCACHEPREFIX", str(cache_directory() / "bytecode"))
    # Ray's workers would wait for every other test.
    os.environ.setdefault("RAY_worker_niceness", "0")
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    config.addinivalue_line("markers", "fault(area, what): shows the answer to a fault")
    config.addinivalue_line(
        "markers", "timed: its nodes must keep times: no other test runs next to it"
    )


@pytest.hookimpl(wrapper=True)
def pytest_pycollect_makemodule(
    module_path: Path, parent: pytest.Collector
) -> Generator[None, pytest.Module | None, pytest.Module | None]:
    """Let a file that skips itself skip no other: launch_testing, which comes with a ROS
    installation, imports it here, where pytest would take that for a skip of the whole folder."""
    try:
        return (yield)
    except pytest.skip.Exception:
        return pytest.Module.from_parent(parent, path=module_path)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let the files that take longest begin first, so that the end does not wait for one of them,
    and those of nodes, which mostly wait, run next to those that compute."""
    seconds = json.loads(SECONDS.read_text(encoding="utf-8"))
    root = SECONDS.parents[1]
    items.sort(key=lambda item: -seconds.get(item.path.relative_to(root).as_posix(), 0))


def pytest_collection_finish() -> None:
    """Leave what was imported alone from now on: it stays, and to search it for garbage took half
    a second each time."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def answered(
    request: pytest.FixtureRequest,
    record_property: Callable[[str, object], None],
    tmp_path: Path,
) -> Callable[..., None]:
    """Take the answer to the fault that the test is marked with.

    `answered(text)` keeps the text that a user sees; `answered(text, what=...)` names the fault
    again, for a test of several.
    """
    marker = request.node.get_closest_marker("fault")
    assert marker is not None, "a test that uses `answered` needs @pytest.mark.fault(area, what)"
    area, named = marker.args
    assert area in AREAS, f"unknown area {area!r}, expected one of {', '.join(AREAS)}"

    def keep(text: object, *, what: str = named) -> None:
        words = " ".join(str(text).split())
        assert words, "an answer of no words"
        for folder in (str(tmp_path.resolve()), str(tmp_path)):
            words = words.replace(folder + "/", "").replace(folder, ".")
        # What differs from run to run would make a table that differs, too.
        words = re.sub(r"\[\d{9,}\.\d+\] ", "", words)
        record_property(PROPERTY, json.dumps({"area": area, "fault": what, "answer": words}))

    return keep


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Collect the answers of tests that passed, those of parallel workers too."""
    if report.when == "call" and report.passed:
        _found.extend(
            {**json.loads(str(value)), "test": report.nodeid}
            for name, value in report.user_properties
            if name == PROPERTY
        )


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Add what was found to the file, in the process that the workers report to."""
    path: Path | None = session.config.getoption("--faults")
    if path is None or hasattr(session.config, "workerinput"):
        return
    before = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else []
    tests = {answer["test"] for answer in _found}
    kept = [answer for answer in before if answer["test"] not in tests]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps([*kept, *_found], indent=2) + "\n", encoding="utf-8")
