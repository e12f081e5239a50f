# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A sensor from photographs of a ball: no force gauge, no stage."""
