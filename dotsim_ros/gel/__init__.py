# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gel: a total-Lagrangian Material Point Method pressed by rigid indenters."""
