# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""ROS 2 executables, a folder each, whose entry is `node.main`: they translate, schedule
and report."""
