# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Safety layer between policy and arm: limits, stale data, stops. Entry:
`supervisor.Supervisor`."""
