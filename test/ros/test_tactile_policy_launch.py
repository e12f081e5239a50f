# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The launch file of the closed loop: what it starts, and that its parameters are the nodes'."""

from __future__ import annotations

from typing import Any

import pytest
import yaml
from launched import started

from dotsim_ros.io.files import parameter_path
from dotsim_ros.nodes.common.parameters import from_values, known_parameters, values_of
from dotsim_ros.nodes.tactile_policy.parameters import TactilePolicyParameters
from dotsim_ros.nodes.tactile_record.node import RecordParameters
from dotsim_ros.nodes.tactile_sim.parameters import TactileSimParameters
from dotsim_ros.nodes.time_stepper.parameters import TimeStepperParameters
from dotsim_ros.nodes.xarm_sim.parameters import XarmSimParameters

CLASSES = {
    "tactile_sim": TactileSimParameters,
    "tactile_policy": TactilePolicyParameters,
    "tactile_record": RecordParameters,
    "time_stepper": TimeStepperParameters,
    "xarm_sim": XarmSimParameters,
}


def test_every_section_of_the_parameters_is_valid_for_its_node() -> None:
    content = yaml.safe_load(parameter_path("closed_loop.yaml").read_text())
    assert set(content) == {f"/**/{name}" for name in CLASSES}
    for name, kind in CLASSES.items():
        given: dict[str, Any] = content[f"/**/{name}"]["ros__parameters"]
        plain = {key: tuple(v) if isinstance(v, list) else v for key, v in given.items()}
        parameters = from_values(kind, plain)
        for field in plain:
            assert known_parameters(kind)[field][1].help
            # ROS refuses an int for a float, which the class itself would take.
            assert type(plain[field]) is type(values_of(kind())[field]), field
        assert parameters


@pytest.mark.parametrize(
    ("one_process", "executables"),
    [("false", set(CLASSES)), ("true", {"dotsim_closed_loop", "tactile_record", "time_stepper"})],
)
def test_it_starts_the_nodes(one_process: str, executables: set[str]) -> None:
    given = {"one_process": one_process, "clock": "simulated", "record": "true"}
    nodes = started("closed_loop.launch.py", **given)
    assert {node.executable for node in nodes} == executables
