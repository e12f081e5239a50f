# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The other simulators' images: each learns what it can express, and nothing moves at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from dotsim_ros.data.motion import pose_along
from dotsim_ros.geometry.camera import FisheyeCamera
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.twin.footage import OpticalPress, Rest
from studies.rivals.clipping import clip_depths, clipped_skin
from studies.rivals.optics import per_pixel, tacto, taxim
from studies.rivals.optics.pixels import (
    pixel_grid,
    relative_normal,
    seen_region,
    warped_ground,
)

FloatArray = NDArray[np.float64]

RADIUS_M = 0.01575
CAMERA = FisheyeCamera(
    width=96,
    height=72,
    focal_px=24.0,
    principal_point_px=np.array([47.5, 35.5]),
    pose=Pose(np.array([0.0, 0.0, 0.0025])),
)
SKIN = dome_skin(RADIUS_M, 0.0008)
RENDERER = SkinRenderer(CAMERA, SKIN)
BALL = sphere(0.004)
DEPTHS_M = (0.0004, 0.0012, 0.002, 0.003)


def rest_of() -> Rest:
    """Return a grey gel at rest, lit within 80 degrees from the axis."""
    view = RENDERER.render(SKIN.rest_position_m)
    lit = CAMERA.rays()[0][..., 2] > np.cos(np.radians(80.0))
    idle = np.where(lit[..., None], 110, 0).astype(np.uint8) + np.zeros(3, dtype=np.uint8)
    return Rest(idle, view.depth_m, view.normal, lit)


REST = rest_of()


def poses(direction: FloatArray) -> list[Pose]:
    """Return poses of a ball that presses ever deeper from a direction."""
    outward = direction / np.linalg.norm(direction)
    return [pose_along((RADIUS_M - depth) * outward, outward) for depth in DEPTHS_M]


def pressed(name: str, direction: FloatArray) -> OpticalPress:
    """Return a clipped press; its measured and warped images are the idle one."""
    depth = clip_depths(SKIN, poses(direction), BALL)
    views = [RENDERER.render(position) for position in clipped_skin(SKIN, depth)]
    images = np.broadcast_to(REST.idle, (len(DEPTHS_M), *REST.idle.shape)).copy()
    return OpticalPress(
        name=name,
        indenter="ball",
        tip_depth_m=np.array(DEPTHS_M),
        measured=images,
        depth_m=np.stack([view.depth_m for view in views]),
        normal=np.stack([view.normal for view in views]),
        warped=images,
    )


def presses(count: int, seed: int) -> list[OpticalPress]:
    """Return presses from random directions near the axis."""
    random = np.random.default_rng(seed)
    directions = np.column_stack([random.uniform(-0.5, 0.5, (count, 2)), np.ones(count)])
    return [pressed(f"press_{k}", d) for k, d in enumerate(directions)]


TRAIN, TEST = presses(5, 0), presses(2, 1)
TINT = np.array([0.3, 0.2, -0.2])


def coloured(press: OpticalPress) -> OpticalPress:
    """Return a press whose colours change with the slope, more so towards one side."""
    grid = pixel_grid(REST)
    images = []
    for normal in press.normal:
        slope = grid.normals(normal)[1]
        share = slope[:, :1] * (1.0 + 0.5 * grid.position[:, :1]) + 0.3 * slope[:, 1:2]
        images.append(grid.changed(REST.idle, share * TINT))
    return replace(press, measured=np.stack(images))


def error(images: NDArray[np.uint8], press: OpticalPress) -> float:
    """Return the root mean square error in grey levels over the lit disc."""
    difference = images.astype(np.float64) - press.measured
    return float(np.sqrt(np.mean(difference[:, REST.lit] ** 2)))


def idle_error(press: OpticalPress) -> float:
    """Return the error of the idle image."""
    return error(np.broadcast_to(REST.idle, press.measured.shape), press)


def test_turning_to_the_flat_gel_keeps_angles() -> None:
    seen = seen_region(REST)
    rest, normal = REST.normal[seen], TRAIN[0].normal[-1][seen]
    relative = relative_normal(normal, rest)
    assert np.linalg.norm(relative, axis=1) == pytest.approx(np.ones(len(relative)), abs=1e-5)
    assert -relative[:, 2] == pytest.approx(np.sum(normal * rest, axis=1), abs=1e-5)


@pytest.mark.parametrize("name", ["taxim", "difftactile"])
def test_a_colour_that_follows_the_slope_is_learned(name: str) -> None:
    train, test = [coloured(press) for press in TRAIN], [coloured(press) for press in TEST]
    if name == "taxim":
        model: taxim.TaximImage | per_pixel.PerPixelImage = taxim.fit(train, REST, CAMERA)
    else:
        pytest.importorskip("torch", reason="the network is trained with torch")
        settings = per_pixel.PerPixelSettings("difftactile", (24, 24), steps=500, batch=1024)
        model = per_pixel.fit(train, REST, CAMERA, settings=settings)
    assert model.name == name
    for press in test:
        assert idle_error(press) > 3.0
        assert error(model.predict(press, REST), press) < 0.5 * idle_error(press)


def test_a_network_is_the_same_for_one_seed() -> None:
    pytest.importorskip("torch", reason="the network is trained with torch")
    train = [coloured(press) for press in TRAIN[:2]]
    settings = per_pixel.PerPixelSettings("fots", (8,), steps=20, batch=256)
    first, again, other = (
        per_pixel.fit(train, REST, CAMERA, seed=seed, settings=settings).layers
        for seed in (3, 3, 4)
    )
    assert np.array_equal(first[0][0], again[0][0])
    assert not np.array_equal(first[0][0], other[0][0])


def shone(press: OpticalPress, light: tacto.PhongLight, intensity: FloatArray) -> OpticalPress:
    """Return a press whose measured images are Tacto's own."""
    return replace(press, measured=tacto.TactoImage(light, intensity, CAMERA).predict(press, REST))


def test_tacto_finds_its_lights_again(monkeypatch: pytest.MonkeyPatch) -> None:
    light = tacto.PhongLight(0.010, -0.001, (1.0, 3.1, 5.3), 8.0)
    intensity = np.concatenate([0.4 * np.eye(3), 0.1 * np.eye(3)])
    train = [shone(press, light, intensity) for press in TRAIN]
    monkeypatch.setattr(tacto, "GENERATIONS", 12)
    monkeypatch.setattr(tacto, "SEARCH_PIXELS", 3000)
    model = tacto.fit(train, REST, CAMERA)
    assert np.all(model.intensity >= 0.0)
    for press in (shone(press, light, intensity) for press in TEST):
        assert idle_error(press) > 2.0
        assert error(model.predict(press, REST), press) < 0.5 * idle_error(press)


def over_pattern(press: OpticalPress, seed: int) -> OpticalPress:
    """Return a press with a pattern, moved in each frame, under what its measured images show."""
    random = np.random.default_rng(seed)
    shape = (*press.measured.shape[:3], 1)
    pattern = REST.lit[None, ..., None] * random.integers(-40, 40, shape)
    moved = (press.warped + pattern).astype(np.uint8)
    return replace(press, warped=moved, measured=(press.measured + pattern).astype(np.uint8))


@pytest.mark.parametrize("kind", ["taxim", "difftactile", "tacto"])
def test_on_the_warped_image_only_the_rest_is_learned(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    light = tacto.PhongLight(0.010, -0.001, (1.0, 3.1, 5.3), 8.0)
    intensity = np.concatenate([0.4 * np.eye(3), 0.1 * np.eye(3)])
    presses = [
        over_pattern(shone(press, light, intensity) if kind == "tacto" else coloured(press), seed)
        for seed, press in enumerate([*TRAIN, *TEST])
    ]
    train, test = presses[: len(TRAIN)], presses[len(TRAIN) :]
    model: tacto.TactoImage | taxim.TaximImage | per_pixel.PerPixelImage
    if kind == "tacto":
        monkeypatch.setattr(tacto, "GENERATIONS", 12)
        monkeypatch.setattr(tacto, "SEARCH_PIXELS", 3000)
        model = tacto.fit(train, REST, CAMERA, ground=warped_ground)
    elif kind == "taxim":
        model = taxim.fit(train, REST, CAMERA, ground=warped_ground)
    else:
        pytest.importorskip("torch", reason="the network is trained with torch")
        settings = per_pixel.PerPixelSettings("difftactile", (24, 24), steps=500, batch=1024)
        model = per_pixel.fit(train, REST, CAMERA, settings=settings, ground=warped_ground)
    for press in test:
        assert error(press.warped, press) > 2.0
        assert error(model.predict(press, REST), press) < 0.5 * error(press.warped, press)


def test_light_behind_the_surface_lights_nothing() -> None:
    surface = tacto.Surface(np.array([[0.0, 0.0, 0.01]]), np.array([[0.0, 0.0, -1.0]]))
    behind = tacto.PhongLight(0.005, 0.02, (0.0, 2.0, 4.0), 2.0)
    before = tacto.PhongLight(0.005, 0.0, (0.0, 2.0, 4.0), 2.0)
    assert np.all(behind.basis(surface) == 0.0)
    assert np.all(before.basis(surface) > 0.0)
