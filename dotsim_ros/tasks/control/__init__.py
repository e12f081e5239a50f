# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What stands between a policy and an arm: limits, stale data, stops, and the record of it."""
