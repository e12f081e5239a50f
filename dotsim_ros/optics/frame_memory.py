# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Memory of a frame's arrays, used again once nobody holds them.

A frame of 640x480 pixels takes 13 MB. From the operating system they come a page at a time, each
cleared first; that can take longer than the rendering.
"""

from __future__ import annotations

import weakref
from collections import defaultdict
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from dotsim_ros.io.warp_runtime import wp

AnyArray = NDArray[Any]

_NUMPY_TYPES: dict[Any, tuple[DTypeLike, tuple[int, ...]]] = {
    wp.uint8: (np.uint8, ()),
    wp.int32: (np.int32, ()),
    wp.float32: (np.float32, ()),
    wp.vec2: (np.float32, (2,)),
    wp.vec3: (np.float32, (3,)),
}

KEPT_ARRAYS = 2
"""Arrays of one shape that are kept while nobody holds them: one is written while one is shown."""


class _Loan:
    """What the arrays that share lent memory hold on to; it ends with the last of them."""

    def __init__(self, memory: AnyArray) -> None:
        self.__array_interface__ = memory.__array_interface__
        self._memory = memory


class FrameMemory:
    """Lends arrays. What is lent belongs to its holder alone, for as long as there is one: an
    array, a view of it, or anything else that keeps one alive.

    Args:
        device: where the arrays lie. Warp keeps CUDA's memory itself, so only a CPU's is kept here.
    """

    def __init__(self, device: wp.Device) -> None:
        self._device = device
        self._free: defaultdict[tuple[tuple[int, ...], np.dtype[Any]], list[AnyArray]] = (
            defaultdict(list)
        )

    def array(self, shape: tuple[int, ...], dtype: type) -> wp.array:
        """Return a Warp array of numbers, vec2 or vec3, with any content."""
        if not self._device.is_cpu:
            return wp.empty(shape, dtype=dtype, device=self._device)
        number, parts = _NUMPY_TYPES[dtype]
        lent = self._lend((*shape, *parts), np.dtype(number))
        return wp.array(lent, dtype=dtype, device=self._device, copy=False)

    def _lend(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> AnyArray:
        free = self._free[shape, dtype]
        # Without a look first: another thread may end a loan, or lend, in between.
        try:
            memory = free.pop()
        except IndexError:
            memory = np.empty(shape, dtype)
        loan = _Loan(memory)
        weakref.finalize(loan, _take_back, free, memory).atexit = False
        return np.asarray(loan)


def _take_back(free: list[AnyArray], memory: AnyArray) -> None:
    if len(free) < KEPT_ARRAYS:
        free.append(memory)
