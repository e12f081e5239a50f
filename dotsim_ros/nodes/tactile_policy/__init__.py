# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""tactile_policy: moves an arm along a path by touch."""
