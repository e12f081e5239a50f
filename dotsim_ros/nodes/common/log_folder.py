# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where ROS writes its logs: it does not start without a folder for them."""

from __future__ import annotations

import os
from pathlib import Path

from dotsim_ros.io.files import expanded, usable_folder


def prepare_log_folder() -> None:
    """Choose a folder that can be written for the logs of ROS, by its own rules where they give
    one; call it before `rclpy.init`."""
    home = os.environ.get("ROS_HOME")
    try:
        below = expanded(home) if home else Path.home() / ".ros"
    except RuntimeError:  # a user without a home
        below = None
    os.environ["ROS_LOG_DIR"] = str(usable_folder("ROS_LOG_DIR", below and below / "log"))
