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
from programs import ROOT

from dotsim_ros.cli.main import MOVED, main, verbs
from dotsim_ros.io.provenance import commit_of, provenance
from studies import run
from studies.results_page import RESULTS


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


def test_every_record_is_sealed_or_can_be_made() -> None:
    sealed = {"gap_physics_new/gap_physics"}
    records = {
        path.relative_to(RESULTS).with_suffix("").as_posix() for path in RESULTS.rglob("*.json")
    }
    assert records - set(run.STUDIES) == sealed
    for name, study in run.STUDIES.items():
        assert study.summary(), name
        for command in (*study.before, *filter(None, [study.command])):
            program, verb = command.split()[:2]
            assert program == "dotsim_ros", name
            assert verb in verbs(), name


def test_a_command_that_moved_is_answered_with_its_study(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for old, new in MOVED.items():
        assert main([*old.split(), "--help"]) == 2
        assert f"`{new}` in a checkout" in capsys.readouterr().err
        program, name = new.rsplit(" ", 1)
        assert program == "python -m studies"
        assert name in run.STUDIES


@pytest.fixture
def studies(checkout: Checkout, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two studies, and a folder of records of a clean checkout."""
    module = ModuleType("studies.made_up")

    def fast(*, count: int = 1, names: list[str] | None = None) -> dict[str, object]:
        """Count."""
        print("computed")
        return {"count": count, "names": names}

    def broken() -> dict[str, object]:
        """Fail."""
        raise ValueError("no such unit")

    module.__dict__.update(fast=fast, broken=broken)
    monkeypatch.setitem(sys.modules, "studies.made_up", module)
    made_up = {
        "fast": run.Study(1, "made_up:fast", {"count": 3}),
        "broken": run.Study(2, "made_up:broken"),
    }
    monkeypatch.setattr(run, "STUDIES", made_up)
    monkeypatch.setattr(run, "ROOT", checkout.root)
    monkeypatch.setattr(run, "RESULTS", checkout.root / "docs" / "results")
    monkeypatch.setattr(run, "provenance", lambda: {"commit": checkout.commit})
    return checkout.root / "docs" / "results"


def test_records_are_made_once_and_a_failed_one_again(
    studies: Path, checkout: Checkout, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run.main(["all", "--json", str(studies)]) == 1
    printed, errors = capfd.readouterr()
    assert printed.count("computed\n") == 1
    assert "broken: no such unit" in errors
    record = json.loads((studies / "fast.json").read_text())
    options = {"count": 3, "names": None}
    assert record == {"commit": checkout.commit, "options": options, **options}
    assert run.main(["fast", "broken", "--json", str(studies)]) == 1
    assert "computed\n" not in capfd.readouterr().out
    (studies / "fast.json").write_text(json.dumps({"sealed": True}))
    assert run.main(["fast", "--count", "5", "--json", str(studies)]) == 0
    assert "fast: made at this commit, or sealed" in capfd.readouterr().out
    (checkout.root / "dotsim_ros" / "new.py").write_text("")
    assert run.main(["broken", "--json", str(studies)]) == 2
    assert "commit or stash" in capfd.readouterr().err


def test_options_are_those_of_the_function(
    studies: Path,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert run.main(["fast", "--names", "a", "b", "--json", str(tmp_path)]) == 0
    record = json.loads((tmp_path / "fast.json").read_text())
    assert (record["count"], record["names"]) == (3, ["a", "b"])
    assert run.main(["slow"]) == 2
    assert "there is no study slow; they are fast, broken" in capfd.readouterr().err
    with pytest.raises(SystemExit):
        run.main(["fast", "--size", "3"])
    assert run.main(["fast", "broken", "--count", "3"]) == 2
    assert "options are of one study" in capfd.readouterr().err
    # What the record needs is not what other options need.
    monkeypatch.setitem(run.STUDIES, "fast", run.Study(1, "made_up:fast", before=("false",)))
    assert run.main(["fast"]) == 1
    assert run.main(["fast", "--count", "2"]) == 0


def test_a_study_says_what_brings_a_package_that_is_missing(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "studies.tumour.study", raising=False)
    assert run.main(["tumour"]) == 1
    asked = "tumour: it needs torch, which is not installed: pip install 'dotsim_ros[test]'"
    assert asked in capfd.readouterr().err


@pytest.mark.parametrize("called_by", ["real", "link"])
def test_an_installed_command_goes_by_its_name(
    called_by: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    monkeypatch.setattr(sys, "executable", str(tmp_path / called_by / "python"))
    monkeypatch.setattr(sys, "argv", [str(tmp_path / "real" / "dotsim_ros"), "view", "bag"])
    assert provenance()["command"] == "dotsim_ros view bag"


@pytest.mark.parametrize(
    ("program", "command"),
    [("tools/canary.py", "tools/canary.py"), ("/home/me/studies/__main__.py", "-m studies")],
)
def test_a_script_goes_by_its_path_and_a_package_by_its_name(
    program: str, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", [program, "--seconds", "15"])
    assert provenance()["command"] == f"python {command} --seconds 15"
