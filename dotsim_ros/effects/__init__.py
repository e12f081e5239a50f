# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a sensor may do that its model leaves out. Entry: `library.load_effects`."""
