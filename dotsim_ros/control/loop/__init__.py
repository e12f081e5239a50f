# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One run of the closed loop, read from its bag, judged and reported. Entry: `judge.judge`."""
