# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Shapes: poses, the sensor's body and camera, and rigid indenters. Entry:
`indenter.load_indenter`, `pose.Pose`."""
