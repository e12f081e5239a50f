# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0
