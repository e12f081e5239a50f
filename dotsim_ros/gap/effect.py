# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Deprecated: the effects' interface has moved to `dotsim_ros.effects.effect`.

Files of effects that import from here still work.
"""

from __future__ import annotations

import warnings

from dotsim_ros.effects.effect import *  # noqa: F403

warnings.warn(
    "dotsim_ros.gap.effect has moved: import from dotsim_ros.effects.effect",
    FutureWarning,
    stacklevel=2,
)
