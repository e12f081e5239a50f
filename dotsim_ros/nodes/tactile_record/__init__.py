# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""tactile_record: writes what the sensor publishes to a bag."""
