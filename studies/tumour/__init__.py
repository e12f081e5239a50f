# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Whether a soft skin hides a bulge or a dent: learnt in simulation, judged on another solver's."""
