# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Many gels of one sensor in one state, on a CPU or a GPU. Entry: `gel.BatchedGel`."""
