# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gap finder: where simulation and measurement disagree, which effect is missing, and the model
with it. Entry: `find.find_gap`."""
