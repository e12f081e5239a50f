# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""xarm_adapter: between standard messages and the driver of a real xArm."""
