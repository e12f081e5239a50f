# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fit of the gel to measured presses, and which of its parameters the data identify. Entry:
`calibrate.calibrate`."""
