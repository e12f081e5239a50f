# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of skin and wrench by everything that the implicit gel depends on."""
