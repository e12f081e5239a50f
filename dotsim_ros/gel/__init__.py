# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The soft body: a total-Lagrangian Material Point Method pressed by rigid indenters. Entry:
`make.make_gel`."""
