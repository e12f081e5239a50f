# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Callbacks that a node's executor looks for now and then only."""

from __future__ import annotations

import time
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup

OPEN_S = 0.03
"""Long enough for the executor's next look on a machine that others use."""


class SeldomCallbacks(ReentrantCallbackGroup):
    """Callbacks that can wait, such as those of publishers for readers of another QoS.

    For each message, rclpy's executor makes a new wait set of all that it may execute, and holds
    Python's lock meanwhile: two events of each of 16 publishers take a third of a millisecond. What
    comes while the group is closed is kept, and found when it is open.
    """

    def __init__(self) -> None:
        super().__init__()
        self._open_until_s = 0.0

    def open(self) -> None:
        """Let the executor look for `OPEN_S`."""
        self._open_until_s = time.monotonic() + OPEN_S

    def can_execute(self, entity: Any) -> bool:
        """Return whether the group is open."""
        return time.monotonic() < self._open_until_s
