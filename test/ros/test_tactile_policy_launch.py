# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The launch file of the closed loop: what it starts, and that its parameters are the nodes'."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest
import yaml

from dotsim_ros.files import parameter_path
from dotsim_ros.nodes.common.options import option_of
from dotsim_ros.nodes.tactile_policy.parameters import TactilePolicyParameters
from dotsim_ros.nodes.tactile_record.node import RecordParameters
from dotsim_ros.nodes.tactile_sim.parameters import TactileSimParameters
from dotsim_ros.nodes.xarm_sim.parameters import XarmSimParameters

PATH = Path(__file__).parents[2] / "launch" / "closed_loop.launch.py"
CLASSES = {
    "tactile_sim": TactileSimParameters,
    "tactile_policy": TactilePolicyParameters,
    "tactile_record": RecordParameters,
    "xarm_sim": XarmSimParameters,
}
STEPPER = "time_stepper"


def test_every_section_of_the_parameters_is_valid_for_its_node() -> None:
    content = yaml.safe_load(parameter_path("closed_loop.yaml").read_text())
    assert set(content) == {f"/**/{name}" for name in CLASSES}
    for name, kind in CLASSES.items():
        given: dict[str, Any] = content[f"/**/{name}"]["ros__parameters"]
        plain = {key: tuple(v) if isinstance(v, list) else v for key, v in given.items()}
        parameters = kind(**plain)
        for field in plain:
            assert option_of(kind.__dataclass_fields__[field]).description
            # ROS refuses an int for a float, which the class itself would take.
            assert type(plain[field]) is type(getattr(kind(), field)), field
        assert parameters


def test_it_describes_the_nodes() -> None:
    pytest.importorskip("launch", reason="launch comes with a ROS installation only")
    pytest.importorskip("launch_ros", reason="launch_ros comes with a ROS installation only")
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

    try:
        get_package_share_directory("dotsim_ros")
    except PackageNotFoundError:
        pytest.skip("the package is not installed in a workspace: colcon build")
    from launch_ros.actions import Node

    specification = importlib.util.spec_from_file_location("closed_loop_launch", PATH)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    entities = module.generate_launch_description().entities
    nodes = {entity.node_executable for entity in entities if isinstance(entity, Node)}
    assert nodes == {*CLASSES, STEPPER}
