# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Models of the gel compared on measured presses: surfaces and forces."""
