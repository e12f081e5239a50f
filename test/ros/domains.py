# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""ROS domains that no two runs on one machine use at a time."""

from __future__ import annotations

import fcntl
import os
import tempfile
from pathlib import Path

LAST_DOMAIN = 101
"""Beyond, the ports of DDS lie among those that Linux gives to any program."""


def take_domain(last: int = LAST_DOMAIN) -> int:
    """Return a domain that is this process's own until it ends.

    A file in the temporary folder stands for each; `.ci/run` locks the same ones.

    Args:
        last: the largest that is taken; the smallest is 1.

    Raises:
        OSError: all are in use.
    """
    for offset in range(last):
        # By its number, so that few are asked before one is free.
        domain = 1 + (os.getpid() + offset) % last
        path = Path(tempfile.gettempdir()) / f"dotsim_ros_domain_{domain}.lock"
        try:
            # Never closed: the lock goes with the process, however that ends.
            held = os.open(path, os.O_WRONLY | os.O_CREAT, 0o666)
        except PermissionError:
            continue  # of another user
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(held)
            continue
        return domain
    raise OSError(f"all {last} ROS domains are in use on this machine")
