# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Realities with something wrong in them, to test the gap finder on.

Imports nothing of `dotsim_ros.gap`: a hidden effect follows a law of its own, not the library's.
"""
