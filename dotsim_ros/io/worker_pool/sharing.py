# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Work as bytes, with its large arrays next to it: these are put once where all workers find them.

A task is small, what it looks at may not be: the same measured press, mesh or skin is part of
hundreds of tasks. Arrays are told apart by their content, not by their name, so that one which is
read twice is kept once, and one which has changed in between is another.
"""

from __future__ import annotations

import hashlib
import io
import pickle
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from ray import cloudpickle

LEAST_BYTES = 64 * 1024
"""Smaller arrays travel with the task: to find them elsewhere takes longer than to copy them."""
KEPT_BYTES = 1 << 30
"""Arrays that are kept for tasks to come; those which were used last stay."""


@dataclass(frozen=True)
class Packed:
    """A piece of work.

    Attributes:
        data: pickled, with numbers in place of the large arrays.
        arrays: what stands for them, in the order of the numbers.
    """

    data: bytes
    arrays: tuple[Any, ...]


class ArrayShelf:
    """Keeps the large arrays of tasks.

    Args:
        put: places an array where all workers find it, and returns what stands for it.
        kept_bytes: of arrays that are kept for tasks to come.

    Attributes:
        put_bytes: of all arrays that were placed.
        put_count: how many.
    """

    def __init__(self, put: Callable[[Any], Any], kept_bytes: int = KEPT_BYTES) -> None:
        self._put, self._limit = put, kept_bytes
        self._kept: OrderedDict[bytes, tuple[Any, int]] = OrderedDict()
        self._kept_bytes = 0
        self.put_bytes = self.put_count = 0

    def pack(self, work: Any) -> Packed:
        """Return work whose large arrays are on the shelf."""
        out = io.BytesIO()
        packer = _Packer(out, self._on_shelf)
        packer.dump(work)
        return Packed(out.getvalue(), tuple(place for _, place in packer.found.values()))

    def _on_shelf(self, key: bytes, array: np.ndarray[Any, Any]) -> Any:
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key][0]
        place = self._put(array)
        self.put_bytes += array.nbytes
        self.put_count += 1
        self._kept[key] = place, array.nbytes
        self._kept_bytes += array.nbytes
        while self._kept_bytes > self._limit and len(self._kept) > 1:
            self._kept_bytes -= self._kept.popitem(last=False)[1][1]
        return place


def is_large(thing: Any) -> bool:
    """Return whether something is an array that is shared."""
    is_array = type(thing) is np.ndarray
    return is_array and thing.nbytes >= LEAST_BYTES and not thing.dtype.hasobject


def unpack(data: bytes, arrays: Sequence[Any]) -> Any:
    """Return packed work.

    Args:
        data: of it.
        arrays: in place of what stood for them.
    """
    return _Unpacker(io.BytesIO(data), arrays).load()


class _Packer(cloudpickle.Pickler):
    """Writes a number in place of each large array."""

    def __init__(self, out: io.BytesIO, on_shelf: Callable[[bytes, Any], Any]) -> None:
        super().__init__(out)
        self._on_shelf = on_shelf
        self.found: dict[bytes, tuple[int, Any]] = {}

    def persistent_id(self, thing: Any) -> int | None:
        if not is_large(thing):
            return None
        key = _key(thing)
        if key not in self.found:
            self.found[key] = len(self.found), self._on_shelf(key, thing)
        return self.found[key][0]


class _Unpacker(pickle.Unpickler):
    """Takes arrays from where they lie, not from the stream."""

    def __init__(self, data: io.BytesIO, arrays: Sequence[Any]) -> None:
        super().__init__(data)
        self._arrays = arrays

    def persistent_load(self, number: Any) -> Any:
        return self._arrays[number]


def _key(array: np.ndarray[Any, Any]) -> bytes:
    form = f"{array.dtype}{array.shape}{array.flags.f_contiguous}".encode()
    return hashlib.blake2b(array.tobytes(order="A") + form, digest_size=16).digest()
