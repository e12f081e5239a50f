# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Files of ROS parameters: what nodes and launch files refuse, and what checking one needs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from dotsim_ros.nodes.common.parameter_file import check_parameter_file, check_params_file

ROOT = Path(__file__).parents[2]
SHIPPED = [path for path in sorted((ROOT / "params").glob("*.yaml")) if path.stem != "participants"]
CONTENTS = {
    "is no YAML": "a: [1\n  b",
    "holds a sensor": "geometry: {outer_radius_m: 0.01575}\n",
    "has `ros_parameters` for `ros__parameters`": "/**: {ros_parameters: {force_limit_n: 8.0}}\n",
    "holds a section without parameters": "/**:\n  ros__parameters:\n",
    "is empty": "",
}


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_every_shipped_file_is_taken(path):
    check_params_file(str(path))


def test_parameters_may_stand_below_namespaces(tmp_path):
    path = tmp_path / "node.yaml"
    path.write_text("left: {arm: {tactile_policy: {ros__parameters: {force_limit_n: 8.0}}}}\n")
    check_parameter_file(str(path))


NAMES = {
    "is not there": ("closed_lop.yaml", "no node is started: no file"),
    "is empty": ("", "params_file is empty"),
    "is a folder": ("params", "is a folder"),
}


@pytest.mark.fault("node parameters", "a launch's `params_file` that is no file")
@pytest.mark.parametrize("what", NAMES)
def test_a_launch_refuses_what_is_no_file(tmp_path, monkeypatch, what, answered):
    monkeypatch.chdir(tmp_path)
    Path("params").mkdir()
    name, reason = NAMES[what]
    with pytest.raises(ValueError, match=reason) as caught:
        check_params_file(name)
    answered(caught.value, what=f"a launch's `params_file` that {what}")


@pytest.mark.fault("node parameters", "a launch's `params_file` that is no file of parameters")
@pytest.mark.parametrize("what", CONTENTS)
def test_a_launch_refuses_a_file_without_parameters(tmp_path, monkeypatch, what, answered):
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text(CONTENTS[what])
    with pytest.raises(ValueError, match=r"no node is started: mine\.yaml") as caught:
        check_params_file("mine.yaml")
    assert "\n" not in str(caught.value)
    answered(caught.value, what=f"a launch's `params_file` {what}")


def test_what_launch_files_ask_of_one_loads_neither_ros_nor_what_nodes_need():
    code = (
        "import sys, dotsim_ros.nodes.indenter_player.launched\n"
        "print({'rclpy', 'cv2', 'warp', 'scipy', 'torch'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.strip() == "set()"
