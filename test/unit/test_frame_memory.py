# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Memory of frames: used again, but never while somebody holds it."""

import gc
import threading

import numpy as np
import pytest
import warp as wp

from dotsim_ros.optics.frame_memory import KEPT_ARRAYS, FrameMemory


@pytest.fixture
def memory():
    return FrameMemory(wp.get_device("cpu"))


def address(array):
    return array.__array_interface__["data"][0]


def test_memory_that_nobody_holds_is_lent_again(memory):
    first = memory.array((40, 30), wp.vec3).numpy()
    place = address(first)
    del first
    gc.collect()
    assert address(memory.array((40, 30), wp.vec3).numpy()) == place


@pytest.mark.parametrize(
    "hold",
    [
        lambda array: array[3:5, ::2],
        lambda array: memoryview(array),
        lambda array: wp.array(array, dtype=wp.float32, device="cpu", copy=False),
    ],
    ids=["part", "buffer", "warp"],
)
def test_memory_that_somebody_holds_is_not_lent(memory, hold):
    held = hold(memory.array((40, 30), wp.float32).numpy())
    gc.collect()
    kept = np.array(held).copy() if not isinstance(held, wp.array) else held.numpy().copy()
    for value in range(5):
        memory.array((40, 30), wp.float32).numpy()[:] = value + 0.5
        gc.collect()
    now = held.numpy() if isinstance(held, wp.array) else np.array(held)
    assert np.array_equal(now, kept, equal_nan=True)


def test_shapes_and_types_do_not_mix(memory):
    for shape, dtype, expected, number in (
        ((4, 6), wp.vec2, (4, 6, 2), np.float32),
        ((4, 6), wp.int32, (4, 6), np.int32),
        ((4, 6, 3), wp.uint8, (4, 6, 3), np.uint8),
        ((4, 6), wp.vec3, (4, 6, 3), np.float32),
    ):
        for _ in range(2):
            array = memory.array(shape, dtype).numpy()
            assert array.shape == expected
            assert array.dtype == number
            assert array.flags.writeable


def test_little_is_kept_after_many_were_held(memory):
    held = [memory.array((50, 50), wp.float32).numpy() for _ in range(10)]
    places = {address(array) for array in held}
    assert len(places) == 10
    del held
    gc.collect()
    again = [memory.array((50, 50), wp.float32) for _ in range(KEPT_ARRAYS)]
    assert {address(array.numpy()) for array in again} <= places
    (kept,) = memory._free.values()
    assert not kept


def test_threads_never_share_memory(memory):
    faults = []

    def use(value):
        for _ in range(300):
            array = memory.array((16, 16), wp.int32).numpy()
            array[:] = value
            if not np.all(array == value):
                faults.append(value)

    threads = [threading.Thread(target=use, args=(value,)) for value in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not faults
