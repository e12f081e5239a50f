# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A finite-element reference of presses on the dome, solved by CalculiX in a process of its own."""
