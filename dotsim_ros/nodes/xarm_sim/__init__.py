# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""xarm_sim: stands where the driver of an xArm 7 would."""
