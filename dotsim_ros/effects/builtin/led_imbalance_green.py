# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""LED imbalance: the green LEDs shine weaker or brighter than those of the other colours."""

from __future__ import annotations

from dotsim_ros.effects.optical_terms import led_imbalance

EFFECT = led_imbalance("green", channel=1)
