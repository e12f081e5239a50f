# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a launch file tells `indenter_player` of the sensor that it starts next to it.

Needs no more than `parameter_file`, for the same reason.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dotsim_ros.nodes.common.parameter_file import named_parameters, parameters_of

PLAYER, SENSOR = "indenter_player", "tactile_sim"
SOURCE = "presses"
"""What is played where nothing else is asked for."""
BASE_FRAME = "densetact_base"
"""That of a sensor whose file names none."""
PATIENCE_S = 600.0
"""The sensor reads poses once its kernels are compiled and its tables computed."""


def player_parameters(
    path: str, *, namespace: str, given: Mapping[str, str], is_recorded: bool
) -> dict[str, Any]:
    """Return the parameters of a player that presses the sensor of the same parameter file.

    What the file says of the player by its name is left out, and so stays, but for what is given
    here.

    Args:
        path: of the file, checked.
        namespace: of both nodes.
        given: `source` and `sensor`, where the launch file was given them.
        is_recorded: whether a recorder hears the poses, which alone is no reason to begin.
    """
    sensor = parameters_of(path, f"{namespace}/{SENSOR}")
    prefix, base_frame = sensor.get("frame_prefix") or "", sensor.get("base_frame") or BASE_FRAME
    found: dict[str, Any] = {
        "source": SOURCE,
        "frame_id": f"{prefix}{base_frame}",
        # What a file says for all nodes is the rate of the sensor's frames.
        "rate_hz": 0.0,
        "subscriber_count": 2 if is_recorded else 1,
        "wait_for_subscriber_s": PATIENCE_S,
    }
    if sensor.get("sensor"):
        found["sensor"] = str(sensor["sensor"])
    own = named_parameters(path, f"{namespace}/{PLAYER}")
    left = {name: value for name, value in found.items() if name not in own}
    return {**left, **given}
