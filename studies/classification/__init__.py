# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which indenter touches the sensor: learnt from simulated images, judged on measured ones."""
