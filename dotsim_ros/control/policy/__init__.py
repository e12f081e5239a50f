# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The policy that follows paths by touch. Entry: `training.train_policy`, `network.load_policy`."""
