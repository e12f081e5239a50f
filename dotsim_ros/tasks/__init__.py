# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What is done with the sensor: the arm that moves it, and controllers that are tested on both."""
