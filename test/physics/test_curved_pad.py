# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A pad with a curved face: its shape, and presses of it between Hertz's balls and the flat pad."""

from __future__ import annotations

import numpy as np
import pytest

from dotsim_ros.gel.discretization import discretize
from dotsim_ros.gel.make import body_of, make_gel_batch, skin_of
from dotsim_ros.geometry.camera import PinholeCamera
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pad_face import face_normal, meet_face
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import vertex_normals
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import (
    GelSpecification,
    SensorSpecification,
    SolverSpecification,
    face_drop_m,
    sensor_from,
)

SIZE_M = (0.016, 0.016, 0.005)
BALL_PER_M, CYLINDER_PER_M = (40.0, 40.0), (0.0, 60.0)


def gel_of(curvature_per_m: tuple[float, float]) -> GelSpecification:
    return GelSpecification(
        shape="curved_pad",
        pad_size_m=SIZE_M,
        face_radius_m=tuple(1.0 / k if k else 0.0 for k in curvature_per_m),
        skin_spacing_m=0.6e-3,
    )


def test_the_face_is_that_of_a_ball_or_of_a_cylinder() -> None:
    x, y = np.meshgrid(np.linspace(-0.008, 0.008, 9), np.linspace(-0.008, 0.008, 9))
    height = 0.025 - face_drop_m(x, y, BALL_PER_M)
    assert np.sqrt(x**2 + y**2 + height**2) == pytest.approx(0.025)
    height = 1.0 / 60.0 - face_drop_m(x, y, CYLINDER_PER_M)
    assert np.hypot(y, height) == pytest.approx(1.0 / 60.0)
    assert np.isnan(face_drop_m(0.026, 0.0, BALL_PER_M))


@pytest.mark.parametrize("curvature", [BALL_PER_M, (25.0, 60.0)])
def test_skin_normals_and_rays_lie_on_the_face(curvature: tuple[float, float]) -> None:
    gel = gel_of(curvature)
    skin = skin_of(gel)
    x, y, z = skin.rest_position_m.T
    assert z == pytest.approx(SIZE_M[2] - face_drop_m(x, y, curvature), abs=1e-12)
    corner = skin.rest_position_m[skin.triangles]
    assert np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max() < 0.6001e-3
    inside = np.all(np.abs(skin.rest_position_m[:, :2]) < 0.0075, axis=1)
    normal = vertex_normals(skin.rest_position_m, skin.triangles)[inside]
    assert np.abs(normal - face_normal(x, y, curvature)[inside]).max() < 1e-3
    camera = PinholeCamera(64, 64, 60.0, (31.5, 31.5), pose=Pose(np.array([1e-3, 0.0, -0.01])))
    points, meets = meet_face(camera.pose.position_m, camera.rays()[0], SIZE_M, curvature)
    view = SkinRenderer(camera, skin).render(skin.rest_position_m)
    assert np.mean(meets == view.mask) > 0.99
    both = meets & view.mask
    # Triangles cut the corners of an arc by s^2 k / 8.
    assert np.abs(points - view.material_point_m)[both].max() < 8e-6


def test_the_grid_fills_the_volume_below_the_face() -> None:
    gel = gel_of(BALL_PER_M)
    grid = discretize(body_of(gel), skin_of(gel).rest_position_m, 0.002)
    axes = [(np.arange(400) + 0.5) / 400 * SIZE_M[0] - 0.5 * SIZE_M[0]] * 2
    drop = face_drop_m(*np.meshgrid(*axes), BALL_PER_M)
    volume = SIZE_M[0] * SIZE_M[1] * (SIZE_M[2] - drop.mean())
    assert grid.particle_volume_m3.sum() == pytest.approx(volume, rel=2e-3)


def force_n(gel: GelSpecification) -> float:
    sensor = SensorSpecification(
        gel=gel, solver=SolverSpecification(grid_spacing_m=0.0025, refined=False)
    )
    batch = make_gel_batch(sensor, indenter=load_indenter("sphere_4mm"), environment_count=1)
    pressed = batch.step([Pose(np.array([0.0, 0.0, SIZE_M[2] - 0.8e-3]))], 0.04)[0]
    assert pressed.converged
    return float(pressed.wrench.force_n[2])


def test_a_bent_face_is_softer_and_becomes_the_flat_pad_as_it_straightens() -> None:
    flat = GelSpecification(shape="flat_pad", pad_size_m=SIZE_M, skin_spacing_m=0.6e-3)
    straight = force_n(flat)
    assert force_n(gel_of((0.0, 0.0))) == straight
    half, whole = (straight - force_n(gel_of((k, k))) for k in (20.0, 40.0))
    # To first order in the curvature.
    assert whole / half == pytest.approx(2.0, rel=0.25)
    # 1/R grows by k: Hertz's half-space softens by its root, a thin layer by the ratio itself.
    ratio = 250.0 / (250.0 + 40.0)
    assert ratio < 1.0 - whole / straight < np.sqrt(ratio) + 0.02


@pytest.mark.parametrize(
    ("gel", "message"),
    [
        ({"shape": "flat_pad", "face_radius_m": [0.1, 0]}, "'curved_pad' has radii"),
        (
            {"shape": "curved_pad", "face_radius_m": [0.005, 0]},
            r"leaves less than 0\.0005 m of gel at the corners",
        ),
    ],
)
def test_a_face_that_no_pad_has_is_refused(gel: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sensor_from({"gel": gel, "solver": {"grid_spacing_m": 0.002}}, "file")
