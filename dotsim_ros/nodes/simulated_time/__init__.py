# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Simulated time: what nodes do when, and the steps that they take together."""
