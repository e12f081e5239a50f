# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pools of workers: processes of this machine, or of a Ray cluster."""
