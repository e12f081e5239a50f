# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Does a batch fit into the memory of its device? Asked before any is taken."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import torch

Grid = Literal["default", "fine"]
"""The sensor's own grid with its refinement, or one of half the spacing, that of the refinement,
for the whole gel."""
TABLE_BYTES: dict[Grid, float] = {"default": 1.0e9, "fine": 1.6e9}
"""Of the tables that all gels share, by their grid."""
TOGETHER = {"cpu": 8, "cuda": 512}
"""So many gels solve their contact together: what a CPU's cache holds, and what fills a GPU..."""
TOGETHER_BYTES = 20.0e6
"""...where each takes this while its compliance is made."""
VECTORS_A_MARKER = 50
"""What a gel keeps and computes with, in vectors (3 numbers of single precision) for each marker of
its skin..."""
GRID_BYTES: dict[Grid, float] = {"default": 0.0, "fine": 10.0e6}
"""...more on a finer grid..."""
CONTACT_BYTES = {"cpu": 0.0, "cuda": 6.0e6}
"""...and for the compliance between the markers around its contact on a GPU, which takes the memory
of the most markers for all gels, twice while some are left out."""


def expect_room(
    count: int,
    vertex_count: int,
    grid: Grid,
    device: str,
    *,
    image_bytes: float = 0.0,
    what: str = "gels",
) -> None:
    """Refuse more gels than fit into the free memory of a device.

    Args:
        count: B.
        vertex_count: markers of a skin.
        grid: of the gels.
        device: cpu, cuda:0.
        image_bytes: that each takes besides.
        what: they are called.

    Raises:
        ValueError: they do not fit, or torch cannot use the device.
    """
    if device != "cpu" and not torch.cuda.is_available():
        raise ValueError(f'device is {device!r}, and torch finds no GPU that it can use; try "cpu"')
    free = _free_host_bytes() if device == "cpu" else torch.cuda.mem_get_info(device)[0]
    kind, room = torch.device(device).type, free - TABLE_BYTES[grid]
    each = 12.0 * VECTORS_A_MARKER * vertex_count + GRID_BYTES[grid] + image_bytes
    each, together = each + CONTACT_BYTES[kind], TOGETHER[kind]
    fitting = int(
        max(
            (room - together * TOGETHER_BYTES) / each,
            min(room / (each + TOGETHER_BYTES), together),
            0.0,
        )
    )
    if count > fitting:
        taken = TABLE_BYTES[grid] + count * each + min(count, together) * TOGETHER_BYTES
        raise ValueError(
            f"{count} {what} take about {taken / 1e9:.1f} GB, and {device} has {free / 1e9:.1f} GB "
            f"free: at most {fitting} fit"
        )


def _free_host_bytes() -> float:
    """Return the memory that the system can give to programs."""
    lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    kilobytes = dict(line.split(":", 1) for line in lines)["MemAvailable"]
    return 1024.0 * float(kilobytes.split()[0])
