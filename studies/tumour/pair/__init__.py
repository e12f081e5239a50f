# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A gel in contact with a second deformable body, both solved together."""
