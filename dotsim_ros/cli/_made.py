# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A folder that a command makes again, of those that show something by themselves."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def recreated(directory: Path, name: str) -> Iterator[None]:
    """Remove the sub-folder that the same command made before, and note the one that the block
    makes.

    What a block leaves that ends with Ctrl-C or a failure is the command's, too: the next run
    removes it. All that writes there must have ended with the block.

    Args:
        directory: in which the sub-folder lies.
        name: of it.

    Raises:
        FileExistsError: as `dotsim_ros.io.replacement.remove_made`, before the block.
    """
    from dotsim_ros.io.replacement import note_made, remove_made

    remove_made(directory, name)
    try:
        yield
    finally:
        if (directory / name).exists():
            note_made(directory, name)
