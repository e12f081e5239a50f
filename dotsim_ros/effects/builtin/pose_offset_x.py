# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pose offset along x: every true pose lies beside the recorded one, base frame."""

from __future__ import annotations

from dotsim_ros.effects.pose_terms import offset_effect

EFFECT = offset_effect(
    "x",
    name="pose_offset_x",
    protocol="presses on both sides of the apex along x, with the skin or the image measured",
    taken_for=("camera extrinsics", "latency"),
)
