# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The network that completes the warped image: its card, its input, and how it is run."""
