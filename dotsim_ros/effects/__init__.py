# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects: what a sensor may do that its model leaves out, the library of them, and overlays."""
