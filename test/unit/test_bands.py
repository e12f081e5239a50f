# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bands that threads share: no number of them, and no other thread, changes a bit."""

import os
import subprocess
import sys
import threading

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from dotsim_ros.geometry.camera import FisheyeCamera
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import dome_skin, flat_pad_skin
from dotsim_ros.optics import host_kernels
from dotsim_ros.optics.bands import cut
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.optics.visibility import lens_of

SIZES = [(7, 5), (8, 1), (1, 17), (17, 3), (161, 121)]
COUNTS = [2, 8]
VIEW = ("normal", "material_point_m", "depth_m", "barycentric", "triangle")

RENDERED = """
import os, sys, threading, time
import numpy as np
from dotsim_ros.geometry.camera import FisheyeCamera
from dotsim_ros.geometry.skin_mesh import flat_pad_skin
from dotsim_ros.optics.renderer import SkinRenderer

mesh = flat_pad_skin((0.02, 0.02), 0.004, 1e-3)
camera = FisheyeCamera(101, 101, 60.0, (50.0, 50.0))
renderer = SkinRenderer(camera, mesh, band_count=2)
expected = SkinRenderer(camera, mesh, band_count=1).render(mesh.rest_position_m)

def is_right():
    view = renderer.render(mesh.rest_position_m)
    return np.array_equal(view.depth_m, expected.depth_m, equal_nan=True)

def helpers():
    return [t.name for t in threading.enumerate() if t.name.startswith(f"bands of {os.getpid()}")]

assert is_right() and len(helpers()) == 1, helpers()
"""


def run(code):
    return subprocess.run(
        [sys.executable, "-c", RENDERED + code],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@given(st.integers(1, 9000), st.integers(1, 8), st.integers(1, 3))
def test_bands_cover_the_whole_once_and_evenly(size, count, smallest):
    bands = cut(size, count, smallest=smallest)
    assert [row for first, end in bands for row in range(first, end)] == list(range(size))
    lengths = [end - first for first, end in bands]
    assert max(lengths) - min(lengths) <= 1
    assert len(bands) == 1 or min(lengths) >= smallest
    assert len(bands) == max(1, min(count, size // smallest))


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize(("width", "height"), SIZES)
def test_view_is_the_same_in_any_number_of_bands(width, height, count):
    # The skin fills the image, and is uneven, so that triangles cross the bands' borders.
    camera = FisheyeCamera(width, height, 0.4 * width, (0.5 * (width - 1), 0.5 * (height - 1)))
    mesh = flat_pad_skin((0.02, 0.02), 0.004, 1e-3)
    position = mesh.rest_position_m.copy()
    position[:, 2] += 0.0005 * np.sin(1500.0 * position[:, 0] + 900.0 * position[:, 1])
    expected = SkinRenderer(camera, mesh, band_count=1).render(position)
    renderer = SkinRenderer(camera, mesh, band_count=count)
    assert expected.mask.any()
    for _ in range(5):
        view = renderer.render(position)
        for name in VIEW:
            first, second = getattr(view, name), getattr(expected, name)
            assert np.array_equal(first, second, equal_nan=True), name


def test_image_is_the_same_in_any_number_of_bands():
    camera = FisheyeCamera(320, 241, 80.0, (160.0, 120.0), pose=Pose(np.array([0, 0, 0.0025])))
    mesh = dome_skin(0.01575, 0.5e-3)
    position = mesh.rest_position_m * np.array([1.02, 0.99, 0.97])
    idle = np.random.default_rng(0).integers(1, 255, (241, 320, 3), dtype=np.uint8)
    view = SkinRenderer(camera, mesh).render(position)
    expected = ImageRenderer(camera, mesh, idle, band_count=1).render(view)
    assert np.count_nonzero(expected != idle) > 10_000
    assert np.array_equal(ImageRenderer(camera, mesh, idle, band_count=3).render(view), expected)


def test_a_band_writes_nothing_beyond_its_last_row():
    # Rows of 9 pixels: the lanes after the eighth reach into the row below, another thread's. It is
    # seen where the compiler stores all lanes; with masked stores nothing is lost either way.
    width, height, rows = 9, 4, 2
    camera = FisheyeCamera(width, height, 4.0, (4.0, 1.5))
    # Every triangle covers the image, and the last of the mesh is drawn first.
    corners = np.array([[-9.0, -9.0, 1.0], [9.0, -9.0, 1.0], [0.0, 9.0, 1.0]], np.float32)
    triangles = np.tile(np.arange(3, dtype=np.int32), (20_000, 1))
    rays = np.ascontiguousarray(np.moveaxis(camera.rays()[0].astype(np.float32), 2, 0))
    triangle = wp.full((height, width), -1, dtype=wp.int32, device="cpu")
    outputs = [
        triangle,
        wp.zeros((height, width), dtype=wp.vec2, device="cpu"),
        wp.zeros((height, width), dtype=wp.float32, device="cpu"),
    ]
    launch = wp.launch(
        host_kernels.rasterize,
        dim=len(triangles),
        inputs=[
            wp.array(corners, dtype=wp.vec3, device="cpu"),
            wp.array(100.0 * corners[:, :2], dtype=wp.vec2, device="cpu"),
            wp.array(triangles, dtype=wp.int32, device="cpu"),
            wp.array(np.arange(len(triangles))[::-1], dtype=wp.int32, device="cpu"),
            wp.array(rays, dtype=wp.float32, device="cpu"),
            lens_of(camera),
            0,
            rows,
        ],
        outputs=outputs,
        device="cpu",
        record_cmd=True,
    )
    thread = threading.Thread(target=lambda: [launch.launch() for _ in range(200)])
    below = triangle.numpy()[rows]
    lost = 0
    thread.start()
    value = 0
    while thread.is_alive():
        value += 1
        below[:] = value
        lost += int(np.any(below != value))
    thread.join()
    assert value > 1000
    assert lost == 0
    # Of many at one distance the first of the mesh is seen.
    assert np.all(triangle.numpy()[:rows] == 0)


def test_renderers_of_two_threads_share_the_other_thread():
    camera = FisheyeCamera(101, 101, 60.0, (50.0, 50.0))
    mesh = flat_pad_skin((0.02, 0.02), 0.004, 1e-3)
    shapes = [mesh.rest_position_m, 0.9 * mesh.rest_position_m]
    expected = [SkinRenderer(camera, mesh, band_count=1).render(shape) for shape in shapes]
    wrong = []

    def render(index):
        renderer = SkinRenderer(camera, mesh, band_count=3)
        for _ in range(100):
            depth_m = renderer.render(shapes[index]).depth_m
            if not np.array_equal(depth_m, expected[index].depth_m, equal_nan=True):
                wrong.append(index)

    threads = [threading.Thread(target=render, args=(index,)) for index in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not np.array_equal(expected[0].depth_m, expected[1].depth_m, equal_nan=True)
    assert wrong == []


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_fork_has_a_thread_of_its_own():
    done = run(
        "process = os.fork()\n"
        "if process == 0:\n"
        "    os._exit(0 if not helpers() and is_right() and len(helpers()) == 1 else 1)\n"
        "assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 0\n"
        "assert is_right()\n"
    )
    assert done.returncode == 0, done.stderr


def test_a_thread_may_render_while_the_interpreter_ends():
    done = run(
        "def late():\n"
        "    threading.main_thread().join()\n"
        "    print('rendered:', is_right())\n"
        "threading.Thread(target=late).start()\n"
    )
    assert done.stdout.splitlines()[-1:] == ["rendered: True"], done.stderr
