# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Many sensors at once, each against one gel and one renderer of its own; and what is not valid."""

import tracemalloc
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import NoiseSpecification, load_sensor

pytest.importorskip("torch")

import torch

from dotsim_ros import tactile_array
from dotsim_ros.gel.batched.gel import BatchedGel
from dotsim_ros.io.warp_runtime import DeviceError, wp
from dotsim_ros.tactile_array import TactileArray

INDENTERS = {
    "densetact2": ("sphere_4mm", "box_edge", "sphere_4mm"),
    "gelsight_mini": ("sphere_4mm",) * 3,
}
SKIN_M = {"densetact2": 3e-6, "gelsight_mini": 10e-6}
"""By which a solve differs with how many gels are solved: it ends where none moves farther than its
tolerance."""
TURNED = np.array([0.0, 0.0, 0.6, 0.8])


@pytest.fixture(scope="module")
def arrays():
    """Return a function that gives the array of a sensor, which is made once, at rest."""
    made = {}

    def array_of(name):
        if name not in made:
            made[name] = TactileArray(name, 3, INDENTERS[name])
        made[name].reset()
        return made[name]

    return array_of


def places(array, depths_m):
    """Return where (B, 3) indenters press as deep above the middle, a little apart."""
    apex_m = np.array([0.0, 0.0, float(array.rest_position_m[:, 2].max())])
    aside = np.array([[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0], [0.0, -1e-3, 0.0]])
    return apex_m + aside - np.array([[0.0, 0.0, 1.0]]) * np.reshape(depths_m, (-1, 1))


@pytest.mark.parametrize("name", ["densetact2", "gelsight_mini"])
def test_each_sensor_is_one_of_its_own_whatever_the_others_are_given(arrays, name):
    array, sensor = arrays(name), load_sensor(name)
    turn = np.tile(TURNED, (3, 1))
    valid = [places(array, depth) for depth in ([2e-4] * 3, [4e-4, 3e-4, 5e-4], [6e-4] * 3)]
    wrong = valid[1].copy()
    # The second gel is given no number, then no rotation; the third a press through its core.
    wrong[1] = np.nan
    no_turn = turn.copy()
    no_turn[1] = 0.0
    through = valid[2].copy()
    through[2, 2] = 1e-3
    steps = [(valid[0], turn), (wrong, turn), (through, no_turn), (valid[2], 3.0 * turn)]
    frames = [array.step(*step) for step in steps]
    assert [frame.is_valid.tolist() for frame in frames] == [
        [True, True, True],
        [True, False, True],
        [True, False, False],
        [True, True, True],
    ]
    for frame in frames[1:3]:
        for field in ("skin_position_m", "force_n", "torque_nm", "depth_m", "normal"):
            last = getattr(frames[0], field)[1]
            np.testing.assert_array_equal(getattr(frame, field)[1], last)
    np.testing.assert_array_equal(frames[2].skin_position_m[2], frames[1].skin_position_m[2])
    see = SkinRenderer(array.camera, skin_of(sensor.gel)).render
    shapes = {one: load_indenter(one) for one in INDENTERS[name]}
    gel = BatchedGel(sensor, shapes[INDENTERS[name][0]], 1)
    for b, indenter in enumerate(INDENTERS[name]):
        gel.set_indenters(shapes[indenter])
        for frame, (position_m, _) in zip(frames, steps, strict=True):
            if not frame.is_valid[b]:
                continue
            right = gel.step(position_m[b : b + 1], turn[b : b + 1])
            skin_m = frame.skin_position_m[b].numpy()
            np.testing.assert_allclose(skin_m, right.skin_position_m[0], atol=SKIN_M[name])
            newtons = np.linalg.norm(right.force_n[0])
            assert newtons > 0.05
            np.testing.assert_allclose(frame.force_n[b], right.force_n[0], atol=0.02 * newtons)
            view = see(skin_m)
            np.testing.assert_allclose(frame.depth_m[b], view.depth_m, atol=1e-6)
            np.testing.assert_allclose(frame.normal[b], view.normal, atol=1e-4)


def test_a_frame_keeps_its_arrays_and_a_far_indenter_leaves_the_gel_at_rest(arrays):
    array = arrays("densetact2")
    turn = torch.tensor([[0.0, 0.0, 0.0, 1.0]]).repeat(3, 1)
    # A gel that has had no valid pose yet is at rest.
    position = torch.from_numpy(places(array, 5e-4))
    position[0, 1] = torch.nan
    first = array.step(position, turn)
    assert first.is_valid.tolist() == [False, True, True]
    assert torch.equal(first.skin_position_m[0], array.rest_position_m)
    assert not first.force_n[0].any()
    kept = first.depth_m.numpy().copy()
    # As far as a number in millimetres takes it, and farther than that.
    position = torch.tensor([[0.0, 0.0, 20.0], [1.0, 0.0, 20.0], [0.0, 0.0, 2e4]])
    away = array.step(position, turn)
    assert away.is_valid.tolist() == [True, True, False]
    assert torch.equal(away.skin_position_m[1], array.rest_position_m)
    assert not away.force_n[1].any()
    assert torch.equal(away.force_n[2], first.force_n[2])
    np.testing.assert_array_equal(first.depth_m.numpy(), kept)
    assert np.nanmax(np.abs(away.depth_m[1].numpy() - kept[1])) > 1e-4


@pytest.mark.parametrize(
    ("name", "size"), [("sensor_a", (640, 480)), ("gelsight_mini_markers", (160, 120))]
)
def test_images_are_those_of_one_sensor(name, size):
    array = TactileArray(name, 3, image_size=size)
    at_rest = array.image()
    frame = array.step(places(array, [3e-4, 4e-4, 5e-4]), [[0.0, 0.0, 0.0, 1.0]] * 3)
    image = array.image().numpy().astype(int)
    one = TactileSensor.load(name)
    # A network, as sensor_a has one, takes the whole view only.
    if not one.has_network:
        one.set_view(size_px=size)
    np.testing.assert_array_equal(at_rest[0], one.idle_image)
    gel = one.press(None)
    for b, skin_m in enumerate(frame.skin_position_m.double().numpy()):
        right = one.see(replace(gel, skin_position_m=skin_m), None).image
        assert np.abs(image[b] - right).max() <= 1
        assert np.mean(image[b] != right) < 1e-3
        assert np.abs(right.astype(int) - one.idle_image).max() > 10


def test_images_have_the_noise_of_the_camera_and_a_network_its_whole_view():
    sensor = load_sensor("flat_pad")
    clean = TactileArray(sensor, 2).image().float()
    noisy = TactileArray(replace(sensor, noise=NoiseSpecification(deviation_levels=2.0)), 2)
    off = noisy.image().float() - clean
    inside = (clean > 20.0) & (clean < 235.0)
    assert off[inside].std() == pytest.approx(2.0, rel=0.05)
    assert not torch.equal(off[0], off[1])
    assert not torch.equal(noisy.image(), clean + off)
    noisy.reset()
    assert torch.equal(noisy.image(), clean + off)
    with pytest.raises(
        ValueError, match=r"image_size is \(64, 64\), expected the shape of \(640, 480"
    ):
        TactileArray("sensor_a", 1).image()


def test_some_sensors_begin_again_and_the_others_go_on(arrays):
    turn = torch.tensor([[0.0, 0.0, 0.0, 1.0]]).repeat(3, 1)
    array = arrays("densetact2")
    array.step(places(array, 1e-3), turn)
    array.reset(torch.tensor([False, True, False]))
    at_rest = array.image()
    there = places(array, 5e-4)
    frame = array.step(there, turn)
    assert frame.is_valid.all()
    array.reset()
    fresh = array.step(there, turn)
    np.testing.assert_allclose(frame.skin_position_m[1], fresh.skin_position_m[1], atol=3e-6)
    array.reset()
    assert torch.equal(at_rest[1], array.image()[1])
    assert not torch.equal(at_rest[0], array.image()[0])


def test_a_gel_that_is_not_solved_to_the_end_is_marked(arrays, monkeypatch):
    array = arrays("densetact2")
    position = torch.from_numpy(places(array, 1e-3))
    position[0] = torch.tensor([0.0, 0.0, 1.0])
    turn = torch.tensor([[0.0, 0.0, 0.0, 1.0]]).repeat(3, 1)
    assert array.step(position, turn).converged.all()
    array.reset()
    monkeypatch.setattr(array._gel, "effort", replace(array._gel.effort, outer=1))
    hurried = array.step(position, turn)
    assert hurried.is_valid.all()
    # The first indenter is away.
    assert hurried.converged.tolist() == [True, False, False]


def test_what_is_no_pose_for_each_sensor_is_refused(arrays):
    array = arrays("densetact2")
    with pytest.raises(ValueError, match=r"position_m has the shape \(2, 3\), expected \(3, 3\)"):
        array.step(np.zeros((2, 3)), np.zeros((3, 4)))
    with pytest.raises(ValueError, match=r"quaternion_xyzw has the shape \(4,\)"):
        array.step(np.zeros((3, 3)), torch.zeros(4))
    with pytest.raises(ValueError, match="position_m holds what is not a number"):
        array.step([["a", "b", "c"]] * 3, np.zeros((3, 4)))
    with pytest.raises(ValueError, match="2 indenters for 3 sensors"):
        TactileArray("densetact2", 3, ["sphere_4mm"] * 2)
    with pytest.raises(ValueError, match="count is 0"):
        TactileArray("densetact2", 0)
    with pytest.raises(ValueError, match=r"friction holds -0\.5"):
        TactileArray("densetact2", 2, friction=[-0.5, 0.2])


def test_a_device_that_fails_says_so_in_a_line_and_the_sensors_go_on(arrays, monkeypatch):
    array = arrays("densetact2")
    turn = torch.tensor([[0.0, 0.0, 0.0, 1.0]]).repeat(3, 1)
    position = torch.from_numpy(places(array, 3e-4))
    with monkeypatch.context() as broken:

        def launch(*given, **named):
            raise RuntimeError("CUDA error: an illegal memory access\nCompile with TORCH_USE_CUDA")

        broken.setattr(wp, "launch", launch)
        with pytest.raises(DeviceError) as refused:
            array.step(position, turn)
    assert str(refused.value).startswith("cpu failed: CUDA error: an illegal memory access; with")
    assert "\n" not in str(refused.value)
    frame = array.step(position, turn)
    assert frame.is_valid.all()
    assert frame.converged.all()


def test_more_sensors_than_fit_are_refused_before_any_memory_is_taken(monkeypatch):
    monkeypatch.setattr(tactile_array, "BatchedGel", None)
    with pytest.raises(ValueError, match=r"1000000000 sensors take .* GB free: at most \d+ fit"):
        TactileArray("densetact2", 10**9)
    least_gb = {}
    for grid in ("default", "fine"):
        with pytest.raises(ValueError, match="at most") as refused:
            TactileArray("densetact2", 10**6, grid=grid)
        least_gb[grid] = float(str(refused.value).split("about ")[1].split(" GB")[0])
    assert least_gb["fine"] > 2.0 * least_gb["default"]
    with pytest.raises(ValueError, match="grid is 'finest', expected default or fine"):
        TactileArray("densetact2", 2, grid="finest")
    sensor, ball = load_sensor("densetact2"), load_indenter("sphere_4mm")
    with pytest.raises(ValueError, match="1000000000 gels take"), _little_memory():
        BatchedGel(sensor, ball, 10**9)


@contextmanager
def _little_memory():
    tracemalloc.start()
    try:
        yield
    finally:
        _, most_bytes = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert most_bytes < 1e8
