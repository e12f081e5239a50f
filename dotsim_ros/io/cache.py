# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Answers that take long to compute, kept on disk under the content of all that decides them.

A key is a hash of the inputs and of the source files that turn them into the answer, so that an
answer of older code, or of a file that has changed under the same name, is never taken.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import logging
import os
import time
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.io.documents import ArrayForm, Arrays, read_arrays
from dotsim_ros.io.files import whole_file
from dotsim_ros.io.printable import one_line
from dotsim_ros.io.provenance import source_hash

_log = logging.getLogger(__name__)

KEY_LENGTH = 24
TABLES_LIMIT_BYTES = 4_000_000_000
"""What the tables of a folder may take together, some forty sensors."""
GEL = ("geometry", "gel", "specification")
"""Source that decides what a gel answers."""
PHYSICS = (*GEL, "effects", "sensor.py", "twin")
"""Source that decides where the skin goes and with what force."""


def content_key(source: tuple[str, ...], *content: Any) -> str:
    """Return a key of the source and the inputs that decide an answer.

    Args:
        source: what computes the answer, as for `source_hash`.
        content: the inputs: numbers, texts, bytes, None, enumerations, arrays, data classes (by
            their fields), and sequences and mappings of these.

    Raises:
        TypeError: an input of another kind, whose content cannot be hashed.
    """
    digest = hashlib.sha256(source_hash(*source).encode())
    _add(digest, content)
    return digest.hexdigest()[:KEY_LENGTH]


def _add(digest: hashlib._Hash, value: Any) -> None:
    if isinstance(value, np.ndarray):
        digest.update(f"array {value.dtype.str} {value.shape}:".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        digest.update(f"{type(value).__name__}(".encode())
        for field in dataclasses.fields(value):
            digest.update(f"{field.name}=".encode())
            _add(digest, getattr(value, field.name))
        digest.update(b")")
    elif isinstance(value, Mapping):
        digest.update(b"{")
        for name in sorted(value, key=str):
            _add(digest, name)
            _add(digest, value[name])
        digest.update(b"}")
    elif isinstance(value, list | tuple):
        digest.update(b"[")
        for item in value:
            _add(digest, item)
        digest.update(b"]")
    elif value is None or isinstance(value, bool | int | float | str | bytes | Enum | np.generic):
        digest.update(f"{type(value).__name__} {value!r};".encode())
    else:
        raise TypeError(
            f"the content of {type(value).__name__} cannot be hashed, expected numbers, texts, "
            "arrays, data classes, or sequences and mappings of these"
        )


def load_arrays(path: Path, forms: Mapping[str, ArrayForm] | None = None) -> Arrays | None:
    """Return the arrays of a kept answer; None where there is none, or none that can be read.

    Its time of access becomes now: `keep_table` drops what was not read for the longest time.

    Args:
        path: of the answer.
        forms: the arrays that it must hold, and what they must be; None for any.
    """
    try:
        arrays = read_arrays(path, forms)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        tell_broken(path, error)
        return None
    with contextlib.suppress(OSError):  # a folder that can only be read
        os.utime(path, ns=(time.time_ns(), path.stat().st_mtime_ns))
    return arrays


def tell_broken(path: Path, reason: object) -> None:
    """Log that a kept answer cannot be used, which is computed again then."""
    _log.warning("%s cannot be used and is computed again: %s", path, one_line(reason))


def store_arrays(path: Path, arrays: Mapping[str, np.ndarray[Any, Any]]) -> None:
    """Keep the arrays of an answer (.npz), whole or not at all."""
    with whole_file(path) as part:
        np.savez(part, **dict(arrays))  # type: ignore[arg-type]


def keep_arrays(path: Path, arrays: Mapping[str, np.ndarray[Any, Any]]) -> None:
    """Keep the arrays of an answer as `store_arrays`; where that fails, log it and go on."""
    try:
        store_arrays(path, arrays)
    except OSError as error:
        _log.warning("an answer is not kept, and will be computed again: %s", one_line(error))


def keep_table(
    path: Path,
    arrays: Mapping[str, np.ndarray[Any, Any]],
    *,
    limit_bytes: int = TABLES_LIMIT_BYTES,
) -> None:
    """Keep a table as `keep_arrays`, and remove those of its folder that were not read for the
    longest time until all take at most the limit. The new one stays."""
    keep_arrays(path, arrays)
    others = []
    for other in path.parent.glob("*.npz"):
        # Another process may remove it first.
        with contextlib.suppress(OSError):
            status = other.stat()
            others.append((other != path, status.st_atime, status.st_size, other))
    taken = 0
    for _, _, size, other in sorted(others, key=lambda one: (one[0], -one[1])):
        taken += size
        if taken > limit_bytes and other != path:
            with contextlib.suppress(OSError):
                other.unlink()
