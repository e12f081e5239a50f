# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Measured data: trajectories in ROS 2 bags, real presses, and the motions that replay them."""
