# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gel at equilibrium in every frame: grid, contact, solver, refinement."""
