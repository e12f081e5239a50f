# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""MCAP files, the storage of ROS 2 bags: written so that nothing is lost, read so that no damage
passes unseen.

The format: https://mcap.dev/spec.
"""
