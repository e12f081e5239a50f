# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a worker on Ray does; it travels to the worker's machine as it stands here.

That machine may have another version of this package, or none. So nothing of the package is
imported before the two have been compared.
"""

from __future__ import annotations

import io
import os
import pickle
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Expected:
    """What a worker must find on its machine.

    Attributes:
        package: name of this package.
        release: its version.
        code: hash of its source.
        folder: that the command was given in, for paths from there.
        needed: folders, and files that were left in the folders which the machines must share.
    """

    package: str
    release: str
    code: str
    folder: str
    needed: tuple[str, ...]


_pool = ""
"""The pool that this process has begun to work for."""


def check(expected: Expected) -> None:
    """Refuse to work on a machine that is not as expected.

    Raises:
        OSError: what is wrong with it.
    """
    if wrong := _wrong_package(expected) or _wrong_folders(expected):
        import ray

        place = f"{ray.util.get_node_ip_address()} ({platform.node()})"
        raise OSError(f"the worker on {place} {wrong}")


def work(
    expected: Expected, pool: str, beginning: bytes, count: int, task: bytes, *arrays: Any
) -> Any:
    """Return the answer to a packed task.

    Args:
        expected: of the machine.
        pool: that the task is of.
        beginning: the packed initializer with its arguments, called once for a pool.
        count: of its arrays, which are the first of `arrays`.
        task: packed.
        arrays: of both.
    """
    global _pool
    if _pool != pool:
        check(expected)
        initialize, given = unpack(beginning, arrays[:count])
        initialize(*given)
        from dotsim_ros.io.cores import keep_single_threaded

        # Whatever the raylet was started with: last digits must not depend on who found them.
        keep_single_threaded()
        _pool = pool
    function, given, named = unpack(task, arrays[count:])
    return function(*given, **named)


def unpack(data: bytes, arrays: Sequence[Any]) -> Any:
    """Return work that `ArrayShelf.pack` packed.

    Args:
        data: of it.
        arrays: that its numbers stand for.
    """
    return _Unpickler(io.BytesIO(data), arrays).load()


class _Unpickler(pickle.Unpickler):
    """Reads work whose arrays are numbers."""

    def __init__(self, file: io.BytesIO, arrays: Sequence[Any]) -> None:
        super().__init__(file)
        self._arrays = arrays

    def persistent_load(self, number: int) -> Any:
        return self._arrays[number]


def _wrong_package(expected: Expected) -> str:
    wanted = (
        f"expected {expected.package} {expected.release} with the code of the command: install "
        "the same into the Python that `ray start` is run with there, and start Ray again"
    )
    try:
        from dotsim_ros import __version__
        from dotsim_ros.io.provenance import source_hash

        code = source_hash(".")
    except (ImportError, FileNotFoundError) as error:
        return f"cannot load {expected.package} ({error}); {wanted}"
    if (__version__, code) != (expected.release, expected.code):
        other = "other code" if __version__ == expected.release else "another version"
        return f"has {expected.package} {__version__}, {other}; {wanted}"
    return ""


def _wrong_folders(expected: Expected) -> str:
    if not expected.needed:
        return ""
    for path in (expected.folder, *expected.needed):
        if not Path(path).exists():
            return (
                f"does not see {path}; expected a file system that all machines of the cluster "
                "share, with each folder at the same place: mount it there, or use machines "
                "that have it"
            )
    os.chdir(expected.folder)
    return ""
