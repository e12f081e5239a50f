"""Deprecated: the effects' interface has moved to `dotsim_ros.effects.effect`.

Files of effects that import from here still work.
"""

from __future__ import annotations

import warnings

from dotsim_ros.effects.effect import *  # noqa: F403
from dotsim_ros.effects.effect import (  # noqa: F401
    FORCE,
    IMAGE,
    SKIN,
    Active,
    Array,
    Effect,
    EffectParameter,
    GelTerm,
    ImageFilter,
    MotionFilter,
    Response,
    ResponseFilter,
    SeenImage,
    Values,
)

warnings.warn(
    "dotsim_ros.gap.effect has moved: import from dotsim_ros.effects.effect",
    FutureWarning,
    stacklevel=2,
)
