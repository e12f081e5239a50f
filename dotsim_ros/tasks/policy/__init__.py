# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The policy that follows paths by touch: its training, its inputs, and what guards the arm."""
