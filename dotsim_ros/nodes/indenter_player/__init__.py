# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""indenter_player: plays presses as poses of the indenter."""
