# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Warp, initialised as all of the package needs it: modules import `wp` from here.

What Warp says of itself, its banner and the load of each module, goes to the debug log: it would
write it to stdout, where the output of a program that uses this package belongs. What it compiles
is kept in `$WARP_CACHE_PATH`, otherwise next to what else the package keeps: Warp would end where
the user's own cache cannot be written.
"""

from __future__ import annotations

import functools
import logging
import os
import tempfile
import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, TypeVar, cast

import warp as wp

from dotsim_ros.io.files import cache_directory, usable_folder
from dotsim_ros.io.progress import say_first_time

__all__ = ["DeviceError", "known_device", "on_torch_stream", "say_if_kernels_compile", "wp"]

COMPILE_S = 12.0
"""Seconds that the kernels of one sensor take to compile on two cores."""

Method = TypeVar("Method", bound=Callable[..., Any])
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


def known_device(name: str) -> str:
    """Return the name that Warp and torch both have for a device: cpu, cuda:0.

    Raises:
        ValueError: there is none of this name.
    """
    there = [str(device) for device in wp.get_devices()]
    if name == "cuda" and wp.is_cuda_available():
        return str(wp.get_cuda_device())
    if name not in there:
        raise ValueError(
            f"there is no device {name!r} on this machine, expected {' or '.join(there)}"
        )
    return name


class DeviceError(RuntimeError):
    """A device did not do what it was asked: it lacks memory, or has failed."""


def on_torch_stream(method: Method) -> Method:
    """Let a method of an object with a `device` launch kernels on torch's stream: neither then has
    to wait for the other, and torch gives no memory away that a kernel still reads.

    Raises:
        DeviceError: what torch or Warp say of the device, in one line.
    """

    @functools.wraps(method)
    def called(self: Any, *given: Any, **named: Any) -> Any:
        try:
            with _torch_stream(self.device):
                return method(self, *given, **named)
        except DeviceError:
            raise
        except RuntimeError as error:
            why = str(error).partition("\n")[0]
            raise DeviceError(
                f"{self.device} failed: {why}; with too little memory take fewer sensors, a GPU "
                "that has failed needs another process"
            ) from error

    return cast(Method, called)


def _torch_stream(device: str) -> AbstractContextManager[Any]:
    if wp.get_device(device).is_cpu:
        return nullcontext()
    import torch

    stream = _stream(device, torch.cuda.current_stream(device).cuda_stream)
    # What Warp has uploaded on its own stream must be there, and is when a graph is captured.
    return wp.ScopedStream(stream, sync_enter=not torch.cuda.is_current_stream_capturing())


@functools.cache
def _stream(device: str, handle: int) -> Any:
    # Torch's streams are never destroyed; Warp would forget one with the first object for it.
    return wp.Stream(device, cuda_stream=handle)


def say_if_kernels_compile() -> None:
    """Print on stderr that the kernels are compiled, where none is in Warp's cache."""
    assert wp.config.kernel_cache_dir is not None
    if not any(Path(wp.config.kernel_cache_dir).glob("wp_dotsim_ros*")):
        say_first_time("compiling the kernels", COMPILE_S)


_initialise()
