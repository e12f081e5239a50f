# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters of the simulated arm and the file that ships with them; the messages of its joints."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from rosbags.typesys import Stores, get_typestore

from dotsim_ros.control.arm.simulated import ArmFaults, ArmLimits, ArmResponse
from dotsim_ros.io.files import parameter_path
from dotsim_ros.nodes.common.parameters import known_parameters
from dotsim_ros.nodes.xarm_sim.parameters import XarmSimParameters
from msg_adapters import BagTypes, decode_joint_state, encode_joint_state

NAMES = ("joint1", "joint2", "joint3")


def test_the_shipped_parameters_are_the_defaults_and_say_what_they_are():
    values = yaml.safe_load(parameter_path("xarm_sim.yaml").read_text())["/**"]["ros__parameters"]
    plain = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
    assert XarmSimParameters(**plain) == XarmSimParameters()
    parameters = known_parameters(XarmSimParameters)
    assert plain.keys() == parameters.keys()
    assert all(parameter.help.endswith(".") for _, parameter in parameters.values())


def test_the_defaults_of_the_node_are_those_of_the_arm():
    parameters = XarmSimParameters()
    assert parameters.limits() == ArmLimits()
    assert parameters.response() == ArmResponse()
    assert parameters.faults() == ArmFaults()


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"start_pose": (0.0, 0.0)}, "start_pose is .* expected 7 numbers"),
        ({"tool_from_sensor": (0.0,) * 7}, "tool_from_sensor: quaternion_xyzw has length 0"),
        ({"indenter_pose": (np.nan,) + (0.0,) * 6}, "indenter_pose"),
        ({"speed_limit_m_s": 5.0}, "speed_limit_m_s"),
        ({"fail_delay_s": -0.1}, "fail_delay_s"),
        ({"tool_frame": "link_base"}, "must differ"),
        ({"base_frame": ""}, "must not be empty"),
    ],
)
def test_bad_values_are_refused_with_the_reason(changes, reason):
    with pytest.raises(ValueError, match=reason):
        dataclasses.replace(XarmSimParameters(), **changes)


def test_joint_states_come_back_in_any_order():
    types = BagTypes(get_typestore(Stores.ROS2_JAZZY).types)
    message = encode_joint_state(
        NAMES, (0.1, 0.2, 0.3), (1.0, 2.0, 3.0), stamp_ns=5, frame_id="link_base", types=types
    )
    positions, velocities = decode_joint_state(message, ("joint3", "joint1"))
    np.testing.assert_array_equal(positions, [0.3, 0.1])
    np.testing.assert_array_equal(velocities, [3.0, 1.0])
    assert len(message.effort) == 0


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"name": ["joint1"], "position": [0.0], "velocity": [0.0]}, "lacks joint2, joint3"),
        ({"position": [0.0, np.nan, 0.0]}, "joint positions holds"),
        ({"velocity": []}, "joint velocities needs 3"),
    ],
)
def test_joint_states_that_are_broken_are_refused(changes, reason):
    whole = {"name": list(NAMES), "position": [0.0] * 3, "velocity": [0.0] * 3}
    with pytest.raises(ValueError, match=reason):
        decode_joint_state(SimpleNamespace(**{**whole, **changes}), NAMES)
