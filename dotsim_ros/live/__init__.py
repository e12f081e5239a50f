# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The live page: a sensor, a running node or a bag in the browser. Entry: `desk.LiveDesk`,
`server.PageServer`."""
