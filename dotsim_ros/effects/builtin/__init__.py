# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The library of effects: one module, one effect, in its attribute `EFFECT`."""
