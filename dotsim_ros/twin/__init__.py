# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The twin: a sensor's gel and camera follow recorded poses, and how far they are off. Entry:
`follow.follow`, `press_metrics.score_press`."""
