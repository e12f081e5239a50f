# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the live page presses: a sensor of this process, or a running node."""
