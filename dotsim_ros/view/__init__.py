# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags made visible: a video and a contact sheet. Entry: `bag.view_bag`."""
