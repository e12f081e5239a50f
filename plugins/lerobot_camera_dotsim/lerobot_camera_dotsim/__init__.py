# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Simulated tactile sensors as cameras of LeRobot, which imports this package by its name."""

from lerobot_camera_dotsim.config_dotsim import DotsimCameraConfig
from lerobot_camera_dotsim.dotsim import DotsimCamera

__all__ = ["DotsimCamera", "DotsimCameraConfig"]
