# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The worlds that policies are judged in: the one they learn in, and others that they never saw."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from dotsim_ros.control.environments.box_yaw import BoxYawTask
from dotsim_ros.specification import load_sensor

AS_LEARNT = "as learnt"
SENSOR = "densetact2"
WORLDS = {
    AS_LEARNT: (1.0, 1.0),
    "gel 1.5 times as stiff": (1.5, 1.0),
    "gel twice as stiff": (2.0, 1.0),
    "half the friction": (1.0, 0.5),
    "twice the friction": (1.0, 2.0),
}
"""Factors on Young's modulus, and on the friction of gel, box and table."""


def options_of(world: str) -> dict[str, Any]:
    """Return the options of the environment that make one of `WORLDS`."""
    stiffness, friction = WORLDS[world]
    sensor, task = load_sensor(SENSOR), BoxYawTask()
    return {
        "sensor": replace(
            sensor,
            material=replace(
                sensor.material, youngs_modulus_pa=stiffness * sensor.material.youngs_modulus_pa
            ),
            contact=replace(
                sensor.contact,
                friction_coefficient=friction * sensor.contact.friction_coefficient,
            ),
        ),
        "task": replace(task, friction=friction * task.friction),
    }
