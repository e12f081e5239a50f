# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The library of effects: a module is a family, and each `Effect` in it is found by
`dotsim_ros.effects.library.load_effects`."""
