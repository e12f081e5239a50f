# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Real presses with a force: a few depths of a ball on a pad, and cylinders between plates."""
