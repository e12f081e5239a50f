# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One number for what a bag holds, to see whether two recordings are the same."""

from __future__ import annotations

import hashlib
from pathlib import Path

from dotsim_ros.data.bag import BagReader


def bag_sha256(path: str | Path) -> str:
    """Return a hash of the topics, times and serialised messages of a bag, in their order.

    Raises:
        OSError, ValueError: as `BagReader`.
    """
    digest = hashlib.sha256()
    with BagReader(path) as bag:
        for each in bag.messages(*bag.topics()):
            serialized = each.serialized
            digest.update(f"{each.topic} {each.log_time_ns} {len(serialized)}\n".encode())
            digest.update(serialized)
    return digest.hexdigest()
