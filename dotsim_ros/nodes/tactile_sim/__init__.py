# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""tactile_sim: stands where the driver of an optical tactile sensor would."""
