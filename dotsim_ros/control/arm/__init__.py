# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The arm: simulated, its kinematics, and its commands. Entry: `simulated.SimulatedArm`."""
