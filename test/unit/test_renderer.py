# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The camera's view: against the sphere's closed form, and three ways to render against another."""

import numpy as np
import pytest
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from dotsim_ros.geometry.camera import Camera, FisheyeCamera, PinholeCamera
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import dome_skin, flat_pad_skin
from dotsim_ros.optics import kernels
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.optics.visibility import RayQueryFinder
from dotsim_ros.specification import load_sensor

RADIUS_M = 0.01575
SPACING_M = 0.5e-3
# A plane between points of a sphere lies inside it by at most (the triangle's circumradius)^2 / 2R.
SAG_M = (SPACING_M / np.sqrt(3.0)) ** 2 / (2.0 * RADIUS_M)


class EmbreeFinder:
    """Intel's Embree: a reference that shares no code with the package."""

    def __init__(self, camera, triangles):
        rays = camera.rays()[0].astype(np.float32)
        self._valid = np.isfinite(rays[..., 2])
        self._rays = np.ascontiguousarray(rays[self._valid])
        self._triangles = triangles

    def find(self, position, pixel, triangle, barycentric, depth):
        # Embree's own tolerances suit millimetres better than metres.
        scene = EmbreeScene()
        TriangleMesh(scene, np.ascontiguousarray(1e3 * position.numpy()[self._triangles]))
        hits = scene.run(np.zeros_like(self._rays), self._rays, output=True)
        triangle.fill_(kernels.NO_TRIANGLE)
        triangle.numpy()[self._valid] = hits["primID"]
        barycentric.numpy()[self._valid] = np.stack([hits["u"], hits["v"]], axis=-1)
        depth.numpy()[self._valid] = 1e-3 * hits["tfar"]


def by_embree(camera, mesh):
    renderer = SkinRenderer(camera, mesh)
    renderer._finder = EmbreeFinder(camera, mesh.triangles)
    return renderer


def by_ray_query(camera, mesh):
    """The way of CUDA."""
    renderer = SkinRenderer(camera, mesh)
    vertices = renderer._optical(mesh.rest_position_m)
    renderer._finder = RayQueryFinder(renderer._rays, renderer._triangles, vertices)
    return renderer


OTHERS = [by_embree, by_ray_query]


@pytest.fixture(scope="module")
def camera():
    return Camera.from_specification(load_sensor("densetact2").camera).scaled(320, 240)


@pytest.fixture(scope="module")
def dome():
    return dome_skin(RADIUS_M, SPACING_M)


def pressed(mesh, direction=(0.35, 0.2, 0.9), depth_m=0.003):
    """Push the skin in around a direction, and drag it aside a little."""
    axis = np.array(direction) / np.linalg.norm(direction)
    distance = np.linalg.norm(mesh.rest_position_m - RADIUS_M * axis, axis=1)
    share = np.exp(-((distance / 0.004) ** 2))[:, None]
    return mesh.rest_position_m + share * (np.array([0.0005, -0.001, 0.0]) - depth_m * axis)


def sphere_depth(camera):
    """Return depth (H, W) and hit points (H, W, 3), base frame, of the whole sphere."""
    rays = camera.rays()[0] @ camera.pose.rotation().T
    origin = camera.pose.position_m
    along = rays @ origin
    depth = -along + np.sqrt(along**2 - origin @ origin + RADIUS_M**2)
    return depth, origin + depth[..., None] * rays


@pytest.mark.parametrize("renderer_of", [SkinRenderer, *OTHERS])
def test_dome_at_rest_is_the_sphere(camera, dome, renderer_of):
    view = renderer_of(camera, dome).render(dome.rest_position_m)
    depth, points = sphere_depth(camera)
    # The polygon of the base ring ends where the sphere does, up to its sag.
    assert view.mask[points[..., 2] > SAG_M].all()
    assert not view.mask[points[..., 2] < -SAG_M].any()
    seen = view.mask
    error = depth[seen] - view.depth_m[seen]
    assert error.min() > -2e-8
    assert error.max() < 1.1 * SAG_M
    normal = points / RADIUS_M @ camera.pose.rotation()
    inner = seen & (points[..., 2] > SPACING_M)
    cosine = -np.sum(view.normal * normal, axis=2)[inner]
    assert np.degrees(np.arccos(cosine.min())) < 0.15
    assert np.linalg.norm(view.material_point_m - points, axis=2)[seen].max() < 1.2 * SAG_M


@pytest.mark.parametrize("other", OTHERS)
def test_rasteriser_agrees_with_ray_tracing_on_a_pressed_skin(camera, dome, other):
    position = pressed(dome)
    view = SkinRenderer(camera, dome).render(position)
    expected = other(camera, dome).render(position)
    # Single precision may put a ray at the base ring on either side.
    assert np.count_nonzero(view.mask != expected.mask) <= 2
    both = view.mask & expected.mask
    assert np.abs(view.depth_m - expected.depth_m)[both].max() < 1e-7
    assert np.abs(view.normal - expected.normal)[both].max() < 1e-4
    assert np.abs(view.material_point_m - expected.material_point_m)[both].max() < 1e-7


@pytest.mark.parametrize("other", OTHERS)
def test_rasteriser_agrees_where_the_skin_folds(camera, dome, other):
    # The skin is dragged over itself: some rays meet it three times.
    position = pressed(dome, depth_m=0.002)
    near = np.linalg.norm(position - np.array([0.0, 0.006, 0.0145]), axis=1) < 0.003
    position[near] += np.array([0.0, 0.004, -0.002])
    view = SkinRenderer(camera, dome).render(position)
    expected = other(camera, dome).render(position)
    both = view.mask & expected.mask
    assert np.count_nonzero(view.mask != expected.mask) <= 2
    differs = np.abs(view.depth_m - expected.depth_m)[both] > 1e-6
    # A ray through an edge of the nearer sheet may see either sheet.
    assert np.count_nonzero(differs) <= 5


def test_material_points_move_with_the_skin(camera, dome):
    position = pressed(dome)
    view = SkinRenderer(camera, dome).render(position)
    rays = camera.rays()[0] @ camera.pose.rotation().T
    seen = view.mask
    for array in (view.depth_m, view.normal, view.material_point_m):
        assert np.all(np.isfinite(array[seen]))
        assert np.all(np.isnan(array[~seen]))
    assert np.sum(view.normal * camera.rays()[0], axis=2)[seen].max() <= 0.0
    assert np.linalg.norm(view.normal[seen], axis=1) == pytest.approx(1.0, abs=1e-5)
    hit = camera.pose.position_m + view.depth_m[..., None] * rays
    weight = np.concatenate(
        [1.0 - view.barycentric.sum(axis=2, keepdims=True), view.barycentric], axis=2
    )[seen]
    corners = dome.triangles[view.triangle[seen]]
    now = np.einsum("nk,nkx->nx", weight, position[corners])
    rest = np.einsum("nk,nkx->nx", weight, dome.rest_position_m[corners])
    assert np.linalg.norm(now - hit[seen], axis=1).max() < 1e-7
    assert np.linalg.norm(rest - view.material_point_m[seen], axis=1).max() < 1e-7
    assert np.linalg.norm(rest - hit[seen], axis=1).max() > 0.002


def test_large_triangles_lose_no_pixel_to_the_fisheye():
    # Each triangle fills a good part of the image, where its edges are strongly curved.
    mesh = dome_skin(RADIUS_M, 0.5 * RADIUS_M)
    camera = FisheyeCamera(200, 200, 60.0, (99.5, 99.5), pose=Pose(np.array([0, 0, 0.0025])))
    view = SkinRenderer(camera, mesh).render(mesh.rest_position_m)
    expected = by_embree(camera, mesh).render(mesh.rest_position_m)
    assert np.array_equal(view.mask, expected.mask)
    assert np.abs(view.depth_m - expected.depth_m)[view.mask].max() < 1e-7


def test_large_triangles_lose_no_pixel_to_a_distorting_pinhole():
    # Bent outwards by the lens, the edges leave the boxes around their ends.
    mesh = flat_pad_skin((0.02, 0.02), 0.004, 4e-3)
    pose = Pose(np.array([0.0, 0.0, -0.01]))
    distortion = (-0.3, 0.1, 0.01, -0.01)
    camera = PinholeCamera(200, 200, 130.0, (99.5, 99.5), distortion, pose)
    view = SkinRenderer(camera, mesh).render(mesh.rest_position_m)
    expected = by_embree(camera, mesh).render(mesh.rest_position_m)
    assert 0.3 < view.mask.mean() < 1.0
    assert np.array_equal(view.mask, expected.mask)
    assert np.abs(view.depth_m - expected.depth_m)[view.mask].max() < 1e-7
    assert camera.project(view.material_point_m[100, 40]) == pytest.approx([40.0, 100.0], abs=1e-3)


@pytest.mark.parametrize(("width", "height"), [(7, 5), (1, 9), (17, 3)])
def test_images_of_any_size_are_seen_to_the_last_pixel(width, height):
    # The skin fills the image; a row is no multiple of the pixels that are tested at once.
    camera = FisheyeCamera(width, height, 20.0, (0.5 * (width - 1), 0.5 * (height - 1)))
    mesh = flat_pad_skin((0.02, 0.02), 0.004, 1e-3)
    view = SkinRenderer(camera, mesh).render(mesh.rest_position_m)
    expected = by_embree(camera, mesh).render(mesh.rest_position_m)
    assert view.mask.all()
    assert np.abs(view.depth_m - expected.depth_m).max() < 1e-7
    assert np.abs(view.material_point_m - expected.material_point_m).max() < 1e-7


def test_image_too_small_for_the_rasteriser_is_refused():
    camera = FisheyeCamera(7, 1, 20.0, (3.0, 0.0))
    mesh = flat_pad_skin((0.02, 0.02), 0.004, 1e-3)
    with pytest.raises(ValueError, match="at least 8 pixels"):
        SkinRenderer(camera, mesh)


def test_flat_pad_through_a_turned_camera():
    # Turned by 90 degrees about its axis: the image's x runs along the base frame's y.
    half = np.sqrt(0.5)
    pose = Pose(np.array([0.001, 0.002, 0.0]), np.array([0.0, 0.0, half, half]))
    camera = FisheyeCamera(101, 101, 60.0, (50.0, 50.0), pose=pose)
    mesh = flat_pad_skin((0.02, 0.02), 0.004, 1e-3)
    view = SkinRenderer(camera, mesh).render(mesh.rest_position_m)
    assert view.depth_m[50, 50] == pytest.approx(0.004)
    assert view.material_point_m[50, 50] == pytest.approx([0.001, 0.002, 0.004], abs=1e-8)
    assert view.material_point_m[50, 70, 1] > 0.0025
    assert view.normal[50, 50] == pytest.approx([0.0, 0.0, -1.0], abs=1e-6)


def test_kernels_of_a_cpu_fill_in_the_normals_as_the_others_do(camera, dome):
    renderer = SkinRenderer(camera, dome)
    position = pressed(dome)
    normal = renderer.render(position).normal
    renderer.pixel_kernels = kernels
    assert np.array_equal(normal, renderer.render(position).normal, equal_nan=True)


def test_vertices_of_another_skin_or_that_are_not_finite_are_refused(camera, dome):
    with pytest.raises(ValueError, match="as the skin mesh"):
        SkinRenderer(camera, dome).render(np.zeros((5, 3)))
    position = dome.rest_position_m.copy()
    position[7, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        SkinRenderer(camera, dome).render(position)
