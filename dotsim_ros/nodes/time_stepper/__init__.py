# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""time_stepper: moves simulated time on for nodes that the user launches."""
