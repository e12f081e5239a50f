# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pose offset along z: every true pose lies above or below the recorded one, base frame.

Errors of rotation are left to the offsets along x and y: about the base they move the contact by
the sensor's height, and a round indenter that turns about its tip presses alike.
"""

from __future__ import annotations

from dotsim_ros.effects.pose_terms import offset_effect

EFFECT = offset_effect(
    "z",
    name="pose_offset",
    protocol="the approach: presses that begin above the skin, at three places of it",
    taken_for=("base_compliance", "latency", "youngs_modulus"),
)
