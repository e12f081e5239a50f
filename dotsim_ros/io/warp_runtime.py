# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Warp, initialised as all of the package needs it: modules import `wp` from here.

What Warp says of itself, its banner and the load of each module, goes to the debug log: it would
write it to stdout, where the output of a program that uses this package belongs. What it compiles
is kept in `$WARP_CACHE_PATH`, otherwise next to what else the package keeps: Warp would end where
the user's own cache cannot be written.
"""

from __future__ import annotations

import logging
import os
import tempfile
import warnings
from pathlib import Path

import warp as wp

from dotsim_ros.io.files import cache_directory, usable_folder
from dotsim_ros.io.progress import say_first_time

__all__ = ["say_if_kernels_compile", "wp"]

COMPILE_S = 20.0
"""Seconds that the kernels of one sensor take to compile on two cores."""

_log = logging.getLogger(__name__)


class _DebugLog:
    """Takes Warp's messages: `warp.Logger` describes the methods."""

    def debug(self, message: str) -> None:
        _log.debug("%s", message)

    info = debug

    def warning(
        self, message: str, category: type[Warning] | None = None, stacklevel: int = 1
    ) -> None:
        warnings.warn(message, category, stacklevel=stacklevel)

    def error(self, message: str) -> None:
        _log.error("%s", message)


def _initialise() -> None:
    # A program that has initialised Warp itself has chosen its cache.
    if wp.config.kernel_cache_dir is None:
        folder = usable_folder("WARP_CACHE_PATH", cache_directory() / "warp")
        wp.config.kernel_cache_dir = str(folder)
    # Warp's library writes to file descriptor 2 by itself that there is no CUDA driver.
    wp.set_logger(_DebugLog())
    try:
        stderr = os.dup(2)
    except OSError:
        wp.init()
        return
    with tempfile.TemporaryFile() as written:
        try:
            os.dup2(written.fileno(), 2)
            wp.init()
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
        written.seek(0)
        text = written.read().decode(errors="replace").strip()
    if text:
        _log.debug("%s", text)


def say_if_kernels_compile() -> None:
    """Print on stderr that the kernels are compiled, where none is in Warp's cache."""
    assert wp.config.kernel_cache_dir is not None
    if not any(Path(wp.config.kernel_cache_dir).glob("wp_dotsim_ros*")):
        say_first_time("compiling the kernels", COMPILE_S)


_initialise()
