# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Data sets of simulated touches, to learn from. Entry: `run.make_touches`."""
