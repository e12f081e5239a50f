# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Packages that only an extra of this one brings."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

OWN = {"dotsim_ros", "msg_adapters", "studies"}


@contextmanager
def extra_needed(what: str, extra: str) -> Iterator[None]:
    """Import what an extra brings.

    Args:
        what: needs it, for the message.
        extra: its name.

    Raises:
        ValueError: a package of others is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] in OWN:
            raise
        raise ValueError(
            f"{what} needs {error.name}, which is not installed: pip install 'dotsim_ros[{extra}]'"
        ) from error
