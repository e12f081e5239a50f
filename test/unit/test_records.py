# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The records of docs/results: the check of their commits, and the command that makes them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from programs import ROOT, program

from dotsim_ros.provenance import commit_of


class Checkout:
    """A repository with one record."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.record = root / "docs" / "results" / "speed.json"
        self.record.parent.mkdir(parents=True)
        self.git("init", "--quiet")
        (root / "dotsim_ros").mkdir()
        (root / "dotsim_ros" / "__init__.py").write_text("")
        self.commit = self.commit_all()

    def git(self, *arguments: str) -> None:
        # The user's own settings may sign commits, or have hooks.
        bare = {**os.environ, "GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_NOSYSTEM": "1"}
        named = ["-c", "user.name=A", "-c", "user.email=a@example.org"]
        subprocess.run(["git", "-C", self.root, *named, *arguments], check=True, env=bare)

    def commit_all(self) -> str:
        self.git("add", "--all")
        self.git("commit", "--quiet", "--allow-empty", "--message", "Change")
        return commit_of(self.root)

    def write(self, **record: object) -> None:
        self.record.write_text(json.dumps(record))

    def faults(self) -> list[str]:
        check = [sys.executable, ROOT / ".ci" / "check_records.py", self.root]
        done = subprocess.run(check, capture_output=True, text=True)
        lines = done.stdout.splitlines()[:-1]
        assert done.returncode == bool(lines)
        return lines


@pytest.fixture
def checkout(tmp_path: Path) -> Checkout:
    return Checkout(tmp_path)


def test_a_record_names_a_clean_commit_of_the_history(checkout: Checkout) -> None:
    checkout.write(rate=25, provenance={"commit": checkout.commit})
    assert checkout.faults() == []
    # However much the source changes afterwards.
    (checkout.root / "dotsim_ros" / "gel.py").write_text("STIFFNESS = 2\n")
    checkout.commit_all()
    assert checkout.faults() == []
    for wrong in (f"{checkout.commit}-dirty", "0123456789ab", "unknown: not run from a checkout"):
        checkout.write(rows=[{"commit": checkout.commit}, {"commit": wrong}])
        (fault,) = checkout.faults()
        assert f"commit {wrong} is not a clean one" in fault
    checkout.write(rate=25)
    (fault,) = checkout.faults()
    assert "commit none" in fault


def test_a_sealed_record_is_never_written_again(checkout: Checkout) -> None:
    checkout.write(sealed=True, named=7, commit=checkout.commit)
    assert checkout.faults() == []
    checkout.commit_all()
    assert checkout.faults() == []
    checkout.write(sealed=True, named=8, commit=checkout.commit)
    (fault,) = checkout.faults()
    assert "then changed: write another file" in fault
    checkout.commit_all()
    assert len(checkout.faults()) == 1


def test_only_what_figures_may_depend_on_makes_a_commit_unclean(checkout: Checkout) -> None:
    (checkout.root / "README.md").write_text("new")
    checkout.write(rate=25)
    assert commit_of(checkout.root) == checkout.commit
    (checkout.root / "dotsim_ros" / "new.py").write_text("")
    assert commit_of(checkout.root) == f"{checkout.commit}-dirty"


def test_a_copy_that_the_checkout_ignores_has_no_commit(checkout: Checkout) -> None:
    (checkout.root / ".gitignore").write_text("venv/\n")
    copy = checkout.root / "venv" / "dotsim_ros"
    copy.mkdir(parents=True)
    (copy / "__init__.py").write_text("")
    assert commit_of(copy.parent).startswith("unknown")


@pytest.fixture
def results() -> ModuleType:
    return program("tools/results.py")


def test_every_record_is_sealed_or_can_be_made(results: ModuleType) -> None:
    folder = ROOT / results.RESULTS
    sealed = {"gap_physics", "gap_physics_new/gap_physics"}
    records = {
        path.relative_to(folder).with_suffix("").as_posix() for path in folder.rglob("*.json")
    }
    assert records - set(results.TABLES) == sealed
    for name, table in results.TABLES.items():
        for command in (*table.before, table.command):
            program, what = command.split()[:2]
            there = ROOT / what if program == "python" else ROOT / f"dotsim_ros/cli/{what}.py"
            assert there.with_name(there.name.replace("-", "_")).is_file(), name


def test_tables_are_made_once_and_a_failed_one_again(
    results: ModuleType,
    checkout: Checkout,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    write = (
        "import json, sys; "
        f"json.dump({{'commit': '{checkout.commit}'}}, open(sys.argv[-1], 'w')); "
        "print('computed')"
    )
    tables = {
        "fast": results.Table(1, f'{sys.executable} -c "{write}"'),
        "broken": results.Table(2, f'{sys.executable} -c "raise SystemExit(1)"'),
    }
    monkeypatch.setattr(results, "TABLES", tables)
    monkeypatch.setattr(results, "ROOT", checkout.root)
    assert results.main([]) == 1
    printed = capfd.readouterr().out
    assert "2 to make, about 3 minutes" in printed
    assert printed.count("computed\n") == 1
    assert "failed: broken; the same command tries these again" in printed
    assert results.main([]) == 1
    printed = capfd.readouterr().out
    assert "1 to make, about 2 minutes" in printed
    assert "computed\n" not in printed
    with pytest.raises(SystemExit):
        results.main(["slow"])
    assert "no table slow" in capfd.readouterr().err
    (checkout.root / "dotsim_ros" / "new.py").write_text("")
    with pytest.raises(SystemExit):
        results.main(["broken"])
    assert "commit or stash" in capfd.readouterr().err
