# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""All targets of the fuzzer, by name."""

from __future__ import annotations

from importlib.util import find_spec

from fuzz import commands, files, measured, messages, networks, sensors, writing

TARGETS = {
    target.name: target
    for target in (
        *sensors.TARGETS,
        *files.TARGETS,
        *measured.TARGETS,
        *messages.TARGETS,
        *networks.TARGETS,
        *commands.TARGETS,
        *writing.TARGETS,
    )
}
if find_spec("rclpy") is not None:
    from fuzz import parameters

    TARGETS |= {target.name: target for target in parameters.TARGETS}
