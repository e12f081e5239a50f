# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters of the nodes: refused with a reason, or taken; the node goes on."""

from __future__ import annotations

import os
from pathlib import Path
from random import Random
from typing import Any

import rclpy
from rclpy.parameter import Parameter

from fuzz.mutate import HOSTILE, spoilt_tree
from fuzz.target import LONGEST_ANSWER, Finding, Target

TYPES = (
    Parameter.Type.BOOL,
    Parameter.Type.INTEGER,
    Parameter.Type.DOUBLE,
    Parameter.Type.STRING,
    Parameter.Type.BYTE_ARRAY,
    Parameter.Type.BOOL_ARRAY,
    Parameter.Type.INTEGER_ARRAY,
    Parameter.Type.DOUBLE_ARRAY,
    Parameter.Type.STRING_ARRAY,
)
INDENTER = {"kind": "sphere", "radius_m": 0.004, "name": "ball"}


def _node(_folder: Path) -> Any:
    from dotsim_ros.nodes.common.transport import stay_local
    from dotsim_ros.nodes.tactile_sim.node import TactileSim

    # A domain that neither the tests nor, by default, anybody else is in.
    os.environ.setdefault("ROS_DOMAIN_ID", "101")
    stay_local()
    rclpy.init()
    return TactileSim()


def _attempt(node: Any, random: Random, _folder: Path) -> None:
    names = sorted(node._parameters)
    name = random.choice([*names, "indenter", "indenter"])
    value = _value(name, random)
    kind = random.choice(TYPES) if random.random() < 0.3 else None
    try:
        parameter = Parameter(name, kind, value)
    except (ValueError, TypeError, AssertionError):
        return  # No client can send it either.
    (result,) = node.set_parameters([parameter])
    if not result.successful and not result.reason.strip():
        raise Finding(f"{name} = {value!r}: refused without a reason")
    if len(result.reason) > LONGEST_ANSWER or "Traceback" in result.reason:
        raise Finding(f"{name}: refused in {len(result.reason)} characters: {result.reason[:300]}")


def _value(name: str, random: Random) -> Any:
    if name == "indenter" and random.random() < 0.7:
        tree = spoilt_tree(INDENTER, random)
        return random.choice((str(tree), "{kind: " + "[" * 3000, "{a: &a [*a]}"))
    value = random.choice(HOSTILE)
    if isinstance(value, list) and random.random() < 0.5:
        return [random.choice((0.0, -1.0, 1e308, float("nan")))] * random.choice((1, 3, 7))
    return value


TARGETS = (Target("parameter", _node, _attempt),)
