# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Many skins through one camera, each against the renderer of a single sensor."""

import numpy as np
import pytest

from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.camera import Camera, middle_part
from dotsim_ros.geometry.markers import PrintedMarkers
from dotsim_ros.optics.idle import part_of_idle
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.pattern import idle_frame_of
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import load_sensor

pytest.importorskip("torch")

import torch

from dotsim_ros.optics.batched import BatchedImages, BatchedRenderer

SENSORS = ("densetact2", "gelsight_mini_markers")


def pressed(rest_m, place_m, depth_m, width_m=3e-3):
    """Push a skin in around a place, and drag it aside."""
    share = np.exp(-(np.linalg.norm(rest_m - place_m, axis=1, keepdims=True) ** 2) / width_m**2)
    return rest_m + share * np.array([0.4e-3, -0.6e-3, -depth_m])


def folded(rest_m):
    """Drag a skin over itself: some rays meet it three times."""
    apex_m = rest_m[rest_m[:, 2].argmax()]
    near = np.linalg.norm(rest_m - apex_m, axis=1, keepdims=True) < 2e-3
    return rest_m + near * np.array([3.5e-3, 0.0, -0.5e-3])


def skins(rest_m):
    """Return an untouched skin, a pressed one, one that is partly out of view, and a folded one."""
    apex_m = rest_m[rest_m[:, 2].argmax()]
    gone = rest_m + np.array([9e-3, 4e-3, 0.0])
    touched = pressed(rest_m, apex_m + np.array([2e-3, 1e-3, 0.0]), 2e-3)
    return np.stack([rest_m, touched, gone, folded(rest_m)]).astype(np.float32)


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("size", [(64, 64), (100, 75)])
def test_each_skin_is_seen_as_by_the_renderer_of_one(name, size):
    sensor = load_sensor(name)
    mesh = skin_of(sensor.gel)
    whole = Camera.from_specification(sensor.camera)
    part = middle_part((whole.width, whole.height), size)
    camera = whole.part(*part).scaled(*size)
    markers = PrintedMarkers(sensor.markers, mesh) if sensor.markers.columns else None
    position = skins(mesh.rest_position_m)
    many = BatchedRenderer(camera, mesh, len(position), markers=markers)
    # What the call before has left does not show.
    many.render(torch.as_tensor(position[::-1].copy()))
    view = many.render(torch.as_tensor(position))
    idle = part_of_idle(idle_frame_of(sensor, whole), part, size)
    image = BatchedImages(many, mesh, idle).render().numpy().astype(int)
    one = SkinRenderer(camera, mesh)
    images = ImageRenderer(
        camera, mesh, idle.image, lighting=idle.lighting, vignetting=idle.vignetting, fine=idle.fine
    )
    for b, skin in enumerate(position):
        right = one.render(skin)
        np.testing.assert_array_equal(view.triangle[b] != -1, right.mask)
        assert right.mask.any()
        np.testing.assert_allclose(view.depth_m[b], right.depth_m, atol=1e-7)
        np.testing.assert_allclose(view.normal[b], right.normal, atol=1e-4)
        expected = np.zeros((0, 2)) if markers is None else markers.motion(skin, camera).position_px
        np.testing.assert_allclose(view.marker_px[b], expected, atol=1e-3)
        # A last bit of the geometry may round to another grey level.
        off = np.abs(image[b] - images.render(right))
        assert off.max() <= 1
        assert np.mean(off > 0) < 1e-3
    np.testing.assert_array_equal(image[0], idle.image)
    assert np.abs(image[1] - idle.image).max() > 10
    out = camera.project(position[2])
    assert np.any((out < 0.0) | (out > np.array(size)))
    # Where a skin lies over itself, its triangles turn to the camera the other way round.
    corner = camera.project(position[3])[mesh.triangles]
    area = np.linalg.det(corner[:, 1:] - corner[:, :1])
    assert np.count_nonzero(area < 0.0) > 5
    assert np.count_nonzero(area > 0.0) > 5


def test_a_skin_of_another_shape_is_refused():
    sensor = load_sensor("flat_pad")
    mesh = skin_of(sensor.gel)
    many = BatchedRenderer(Camera.from_specification(sensor.camera), mesh, 2)
    with pytest.raises(ValueError, match=r"of torch\.float32, expected \(2, "):
        many.render(torch.zeros(3, mesh.vertex_count, 3))
    with pytest.raises(ValueError, match=r"is .* of torch\.float64"):
        many.render(torch.zeros(2, mesh.vertex_count, 3, dtype=torch.float64))
