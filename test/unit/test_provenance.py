# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The command that a result says it was made by."""

import sys

import pytest

from dotsim_ros.io.provenance import provenance


@pytest.mark.parametrize("called_by", ["real", "link"])
def test_an_installed_command_goes_by_its_name(called_by, tmp_path, monkeypatch):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    monkeypatch.setattr(sys, "executable", str(tmp_path / called_by / "python"))
    monkeypatch.setattr(sys, "argv", [str(tmp_path / "real" / "dotsim_ros"), "view", "bag"])
    assert provenance()["command"] == "dotsim_ros view bag"


@pytest.mark.parametrize(
    ("program", "command"),
    [("tools/canary.py", "tools/canary.py"), ("/home/me/studies/__main__.py", "-m studies")],
)
def test_a_script_goes_by_its_path_and_a_package_by_its_name(program, command, monkeypatch):
    monkeypatch.setattr(sys, "argv", [program, "--seconds", "15"])
    assert provenance()["command"] == f"python {command} --seconds 15"
