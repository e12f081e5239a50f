# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The paper's reinforcement learning: policies of several seeds, other worlds, blind moves."""
