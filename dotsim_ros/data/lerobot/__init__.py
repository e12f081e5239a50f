# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Data sets in the layout LeRobotDataset v3.0. Entry: `writer.LeRobotWriter`."""
