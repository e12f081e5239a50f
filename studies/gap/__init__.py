# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How well the gap finder names effects that were hidden on purpose."""
