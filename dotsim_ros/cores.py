# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The cores of the machine that this process may use."""

from __future__ import annotations

import os


def available_core_count() -> int:
    """Return on how many cores this process may run."""
    # Linux and some others alone tell it.
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed is not None else os.cpu_count() or 1
