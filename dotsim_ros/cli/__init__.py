# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Commands that need no ROS graph, one verb a file. Entry: `main.main`."""
