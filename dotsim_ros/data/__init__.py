# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags and data sets, and the motions that replay them. Entry: `data_set.read_data_set`."""
