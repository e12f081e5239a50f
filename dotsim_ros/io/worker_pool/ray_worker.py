# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a worker on Ray is; it travels to the worker's machine as it stands here.

That machine may have another version of this package, or none. So nothing of the package is
imported before the two have been compared.
"""

from __future__ import annotations

import io
import os
import pickle
import platform
import traceback
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


class RayWorker:
    """A worker: `check` and `begin` once, then `work`."""

    def check(self, expected: Expected) -> str:
        """Return what is wrong with the worker's machine, "" for nothing."""
        wrong = _wrong_package(expected) or _wrong_folders(expected)
        if not wrong:
            return ""
        import ray

        return f"the worker on {ray.util.get_node_ip_address()} ({platform.node()}) {wrong}"

    def begin(self, data: bytes, *arrays: Any) -> None:
        """Call the packed initializer with its arguments."""
        initialize, given = unpack(data, arrays)
        initialize(*given)
        from dotsim_ros.io.cores import keep_single_threaded

        # Whatever the raylet was started with: last digits must not depend on who found them.
        keep_single_threaded()

    def work(self, data: bytes, *arrays: Any) -> tuple[bool, Any]:
        """Do packed work; return whether it could be done, and its answer or its exception."""
        try:
            function, given, named = unpack(data, arrays)
            return True, function(*given, **named)
        except Exception as error:
            error.add_note(f"in a worker on Ray:\n{traceback.format_exc()}")
            return False, error


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
