# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The plugin for LeRobot: named as LeRobot finds it; its own tests say what it does."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

PLUGIN = Path(__file__).parents[2] / "plugins" / "lerobot_camera_dotsim"


def test_the_plugin_is_named_as_lerobot_looks_for_it():
    project = tomllib.loads((PLUGIN / "pyproject.toml").read_text())["project"]
    assert project["name"].startswith("lerobot_camera_")
    assert (PLUGIN / project["name"] / "__init__.py").is_file()


def test_the_plugins_own_tests_pass():
    pytest.importorskip("lerobot", reason="lerobot is not installed")
    pytest.importorskip("lerobot_camera_dotsim", reason=f"needs pip install {PLUGIN.name}")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(PLUGIN)]
    assert subprocess.run(command, check=False).returncode == 0
