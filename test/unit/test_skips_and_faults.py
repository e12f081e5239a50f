# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The checks of what the tests saw: no test is skipped unseen, no answer to a fault goes unseen."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
TESTS = """
import pytest

@pytest.mark.skip(reason="for no good reason")
@pytest.mark.fault("view", "a fault")
def test_skipped():
    pass

def test_skips_itself():
    pytest.skip("no disk can be mounted here")

@pytest.mark.xfail
def test_known_to_fail():
    assert False

def test_runs():
    pass
"""


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return what imports a program of .ci."""
    monkeypatch.syspath_prepend(str(ROOT / ".ci"))
    return importlib.import_module


def run_tests(folder: Path, *given: str) -> subprocess.CompletedProcess[str]:
    """Run the tests of a folder, noting in its skips.json what did not run."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "skips", "--skips=skips.json"]
    command += ["-p", "no:cacheprovider", *given]
    paths = {"PYTHONPATH": str(ROOT / ".ci")}
    return subprocess.run(
        command, cwd=folder, env=os.environ | paths, capture_output=True, text=True, check=False
    )


def test_a_skip_is_noted_and_one_without_a_known_cause_is_refused(
    tool: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "test_some.py").write_text(TESTS)
    (tmp_path / "test_module.py").write_text('import pytest\npytest.importorskip("nowhere")\n')
    done = run_tests(tmp_path, "-W", "ignore")
    assert "1 passed, 3 skipped, 1 xfailed" in done.stdout
    skips = tool("skips")
    seen = skips.read(tmp_path / "skips.json")
    assert seen["files"] == ["test_module.py", "test_some.py"]
    noted = seen["skips"]
    assert {skip["test"].partition("::")[2]: skip["areas"] for skip in noted} == {
        "": [],
        "test_skipped": ["view"],
        "test_skips_itself": [],
    }
    assert [line.partition(": skipped: ")[2] for line in skips.unexpected(noted)] == [
        "could not import 'nowhere': No module named 'nowhere'",
        "for no good reason",
    ]
    # A cause that does not hold on this machine excuses nothing.
    missing = [{"test": "a", "reason": "CalculiX is not installed", "areas": []}]
    monkeypatch.setenv("PATH", str(tmp_path))
    assert not skips.unexpected(missing)
    (tmp_path / "ccx").touch(mode=0o755)
    assert skips.unexpected(missing)


def test_a_file_that_pytest_did_not_come_to_is_found(tool: Any, tmp_path: Path) -> None:
    for name in ("unit/test_first.py", "unit/test_second.py"):
        (tmp_path / "test" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "test" / name).write_text("def test_runs():\n    pass\n")
    skips = tool("skips")

    def missed_by(file: str) -> list[str]:
        assert run_tests(tmp_path, f"--rootdir={tmp_path}", file).returncode == 0
        files = skips.read(tmp_path / "skips.json")["files"]
        found: list[str] = skips.left_out(files, tmp_path)
        return found

    assert missed_by("test/unit/test_second.py") == ["test/unit/test_first.py"]
    # What another part of the run comes to is added.
    assert missed_by("test/unit/test_first.py") == []


def test_tests_that_are_not_there_any_more_are_counted(tool: Any, tmp_path: Path) -> None:
    (tmp_path / "test_some.py").write_text(TESTS)
    (tmp_path / "test_module.py").write_text('import pytest\npytest.importorskip("nowhere")\n')
    # What ran twice counts once, whoever ran it.
    run_tests(tmp_path, "-W", "ignore")
    run_tests(tmp_path, "-W", "ignore", "-n", "1")
    skips = tool("skips")
    tests = skips.read(tmp_path / "skips.json")["tests"]
    assert tests == [
        f"test_some.py::{name}"
        for name in ("test_known_to_fail", "test_runs", "test_skipped", "test_skips_itself")
    ]
    assert not skips.lost(tests, {"tests": 6, "allowance": 2})
    assert "4 tests, expected at least 5" in skips.lost(tests, {"tests": 6, "allowance": 1})


CONFTEST = ROOT / "test" / "conftest.py"
# As launch_testing does, which comes with a ROS installation.
IMPORTS_FILES = """
import pytest
from _pytest.pathlib import import_path

def pytest_pycollect_makemodule(module_path, parent):
    import_path(module_path, root=None, consider_namespace_packages=False)
    return pytest.Module.from_parent(parent, path=module_path)
"""


def test_a_file_that_skips_itself_skips_no_other_beside_launch_testing(tmp_path: Path) -> None:
    folder = tmp_path / "test"
    folder.mkdir()
    (tmp_path / "imports_files.py").write_text(IMPORTS_FILES)
    (folder / "seconds.json").write_text("{}")
    (folder / "conftest.py").write_text(CONFTEST.read_text(encoding="utf-8"))
    (folder / "test_absent.py").write_text('import pytest\npytest.importorskip("nowhere")\n')
    (folder / "test_there.py").write_text("def test_runs():\n    pass\n")
    given = ["-p", "imports_files", "-p", "no:cacheprovider", "-q", "test"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *given],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "1 passed, 1 skipped" in done.stdout, done.stdout + done.stderr


ROWS = {"view": {("cut", "is shown"), ("full", "says so")}, "find-gap": {("no pose", "says so")}}


def seen(**changes: set[tuple[str, str]]) -> dict[str, set[tuple[str, str]]]:
    return {**ROWS, **changes}


@pytest.mark.parametrize(
    ("now", "skipped", "wrong"),
    [
        (seen(), (), []),
        (seen(view={("cut", "is shown")}), (), ["view: full: says so (no test saw this)"]),
        (seen(view={("cut", "is shown")}), ("view",), []),
        (seen(view={("cut", "is shown")}), ("find-gap",), ["view: full"]),
        (
            seen(view={("cut", "is refused"), ("full", "says so")}),
            ("view",),
            ["view: cut: is refused (another answer", "view: cut: is shown (no test saw"],
        ),
        (seen(view=ROWS["view"] | {("new", "x")}), (), ["view: new: x (it is not there)"]),
    ],
)
def test_answers_that_are_not_those_of_the_page_are_found(
    tool: Any, now: dict[str, set[tuple[str, str]]], skipped: tuple[str, ...], wrong: list[str]
) -> None:
    table = tool("faults_table")
    there, now = ({area: rows.get(area, set()) for area in table.AREAS} for rows in (ROWS, now))
    found = table.differences(there, now, set(skipped))
    assert [line[: len(start)] for line, start in zip(found, wrong, strict=True)] == wrong
