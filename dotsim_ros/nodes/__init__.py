# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""ROS 2 executables, one a file: they translate, schedule and report; no numerics."""
