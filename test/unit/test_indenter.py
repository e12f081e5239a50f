# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Indenters: exact distances, grids, kernels, meshes that must be refused, definitions."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import warp as wp
import yaml
from numpy.typing import NDArray
from scipy import ndimage

from dotsim_ros.gel.distance_field import distance_functions, indenter_field
from dotsim_ros.geometry.indenter import (
    Indenter,
    IndenterMesh,
    box,
    box_edge,
    capsule,
    cone,
    flat_punch,
    load_indenter,
    load_mesh,
    lying_cylinder,
    sphere,
    torus,
    warn_of_misfit,
)
from dotsim_ros.geometry.signed_distance import SignedDistanceGrid

SHARED = Path(__file__).resolve().parents[3] / "shared"
REAL_MESHES = sorted((SHARED / "real/indenters").glob("*.stl"))

PRIMITIVES = {
    "sphere": sphere(0.004),
    "sharp_box": box([0.006, 0.004, 0.005]),
    "box": box([0.006, 0.004, 0.005], 0.0005),
    "box_edge": box_edge([0.008, 0.006, 0.005], 0.0003),
    "flat_punch": flat_punch(0.003, 0.008, 0.0005),
    "lying_cylinder": lying_cylinder(0.002, 0.006, 0.0002),
    "cone": cone(np.radians(36.0), 0.009, 0.001),
    "sharp_cone": cone(np.radians(50.0), 0.006),
    "capsule": capsule(0.002, 0.004),
    "torus": torus(0.0028, 0.0015),
}
PAD_20_MM = np.array([[-0.01, -0.008, 0.004], [0.01, 0.008, 0.004]])
CORNER = 0.0005 * (np.sqrt(3.0) - 1.0)


def sampled(grid: SignedDistanceGrid, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance (N,) at points (N, 3), as the kernels have it: outside of the grid it
    grows with the distance to the grid's box."""
    position = (points - grid.origin_m) / grid.spacing_m
    inside = np.clip(position, 0.5, np.array(grid.coefficients.shape) - 1.5)
    value = ndimage.map_coordinates(grid.coefficients, inside.T, order=2, prefilter=False)
    return np.asarray(value + np.linalg.norm(position - inside, axis=1) * grid.spacing_m)


@cache
def evaluation_kernel(scalar: Any) -> wp.Kernel:
    functions = distance_functions(scalar)
    field_type = functions.IndenterField
    indenter_distance = functions.indenter_distance
    vec3 = wp.types.vector(3, scalar)
    mat33 = wp.types.matrix((3, 3), scalar)

    @wp.kernel
    def evaluate(
        field: field_type,  # type: ignore[valid-type]
        points: wp.array(dtype=vec3),  # type: ignore[valid-type]
        distance: wp.array(dtype=scalar),  # type: ignore[valid-type]
        gradient: wp.array(dtype=vec3),  # type: ignore[valid-type]
        hessian: wp.array(dtype=mat33),  # type: ignore[valid-type]
    ) -> None:
        i = wp.tid()
        d, g, h = indenter_distance(field, points[i])
        distance[i] = d
        gradient[i] = g
        hessian[i] = h

    return evaluate


def run_kernel(
    indenter: Indenter, points: NDArray[np.float64], scalar: Any = wp.float32
) -> tuple[NDArray[np.float64], ...]:
    """Return distance, gradient, Hessian, and the gradient of the distance by the tape."""
    count = len(points)
    vec3 = wp.types.vector(3, scalar)
    inputs: wp.array = wp.array(points, dtype=vec3, device="cpu", requires_grad=True)
    outputs = (
        wp.zeros(count, dtype=scalar, device="cpu", requires_grad=True),
        wp.zeros(count, dtype=vec3, device="cpu"),
        wp.zeros(count, dtype=wp.types.matrix((3, 3), scalar), device="cpu"),
    )
    field = indenter_field(indenter, scalar=scalar, device="cpu")
    tape = wp.Tape()
    with tape:
        wp.launch(
            evaluation_kernel(scalar),
            count,
            inputs=[field, inputs],
            outputs=list(outputs),
            device="cpu",
        )
    tape.backward(grads={outputs[0]: wp.ones(count, dtype=scalar, device="cpu")})
    return tuple(array.numpy() for array in (*outputs, inputs.grad))


def points_around(indenter: Indenter, count: int = 4000) -> NDArray[np.float64]:
    bounds = indenter.bounds_m()
    return np.random.default_rng(1).uniform(bounds[0] - 0.002, bounds[1] + 0.002, (count, 3))


def numerical_gradient(indenter: Indenter, points: NDArray[np.float64]) -> NDArray[np.float64]:
    step = 1e-7
    return np.stack(
        [
            (
                indenter.signed_distance(points + step * axis)
                - indenter.signed_distance(points - step * axis)
            )
            / (2 * step)
            for axis in np.eye(3)
        ],
        axis=1,
    )


@pytest.mark.parametrize(
    ("indenter", "point", "expected"),
    [
        (sphere(0.004), [0.0, 0.0, 0.004], -0.004),
        (box([0.006, 0.004, 0.005]), [0.006, 0.006, 0.0025], 0.005),
        (box([0.006, 0.004, 0.005], 0.0005), [0.003, 0.002, 0.0], CORNER),
        (flat_punch(0.003, 0.008), [0.006, 0.0, -0.004], 0.005),
        (lying_cylinder(0.002, 0.006), [0.0, 0.004, 0.002], 0.001),
        (cone(np.pi / 4, 0.01), [0.001, 0.0, 0.0], 0.001 * np.sqrt(0.5)),
        (capsule(0.002, 0.004), [0.0, 0.005, 0.002], 0.001),
        (torus(0.003, 0.001), [0.0, 0.0, 0.001], 0.002),
    ],
)
def test_distance_equals_the_value_by_hand(
    indenter: Indenter, point: list[float], expected: float
) -> None:
    assert indenter.signed_distance([point])[0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("name", PRIMITIVES)
def test_distance_is_that_to_the_nearest_surface_point(name: str) -> None:
    indenter = PRIMITIVES[name]
    points = points_around(indenter)
    distance, gradient = indenter.signed_distance(points), numerical_gradient(indenter, points)
    length = np.linalg.norm(gradient, axis=1)
    outside = distance > 0.0
    if name == "torus":
        outside &= np.hypot(points[:, 0], points[:, 1]) > 1e-5
    # But for the medial axis.
    assert np.abs(length[outside] - 1.0).max() < 1e-5
    assert np.mean(np.abs(length - 1.0) < 1e-5) > 0.99
    smooth = np.abs(length - 1.0) < 1e-6
    foot = points - distance[:, None] * gradient
    assert np.abs(indenter.signed_distance(foot[smooth])).max() < 1e-8
    # The tip is at the origin, and nothing lies lower.
    tip = [0.0028, 0.0, 0.0] if name == "torus" else [0.0, 0.0, 0.0]
    assert indenter.signed_distance([tip])[0] == pytest.approx(0.0, abs=1e-12)
    points[:, 2] = -1e-9
    assert indenter.signed_distance(points).min() > 0.0


@pytest.mark.parametrize(("scalar", "tolerance"), [(wp.float32, 1e-4), (wp.float64, 1e-6)])
@pytest.mark.parametrize("name", PRIMITIVES)
def test_kernel_agrees_with_the_host(name: str, scalar: Any, tolerance: float) -> None:
    indenter = PRIMITIVES[name]
    points = points_around(indenter).astype(np.float32).astype(np.float64)
    distance, gradient, hessian, taped = run_kernel(indenter, points, scalar)
    numerical = numerical_gradient(indenter, points)
    # On a crease of the distance (the medial axis) either side's gradient is right.
    smooth = np.abs(np.linalg.norm(numerical, axis=1) - 1.0) < 1e-5
    assert np.abs(distance - indenter.signed_distance(points)).max() < 1e-4 * tolerance
    assert np.quantile(np.abs(gradient - numerical)[smooth], 0.999) < tolerance
    assert np.quantile(np.abs(taped - numerical)[smooth], 0.999) < 10 * tolerance

    far = smooth & (indenter.signed_distance(points) > 5e-4)
    direction = np.array([0.36, -0.48, 0.8])
    step = 1e-6
    ahead = numerical_gradient(indenter, points + step * direction)
    behind = numerical_gradient(indenter, points - step * direction)
    change = (ahead - behind) / (2 * step)
    error = np.abs(hessian @ direction - change)[far]
    assert np.quantile(error, 0.99) < 1e-2 * np.abs(change[far]).max()


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Indenter:
    path = tmp_path_factory.mktemp("mesh") / "ball.ply"
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=4.0)
    mesh.apply_translation([0.0, 0.0, 4.0])
    mesh.export(path)
    return load_mesh(path, 0.001)


def test_distance_grid_is_as_exact_as_the_mesh_near_the_surface(ball: Indenter) -> None:
    grid = ball.distance_grid(2e-4)
    points = points_around(ball)
    exact = sphere(0.004).signed_distance(points)
    # The facets' sagitta: 2.4 um.
    assert np.abs(ball.signed_distance(points) - exact).max() < 3e-6
    near = np.abs(exact) < 1e-3
    assert np.abs(sampled(grid, points) - exact)[near].max() < 5e-6
    far = np.array([[0.05, 0.0, 0.0], [0.0, 0.0, -0.05]])
    assert np.all(sampled(grid, far) > 0.035)


def test_the_same_surface_read_twice_shares_its_grid(ball: Indenter) -> None:
    assert ball.mesh is not None
    again = replace(ball, mesh=IndenterMesh(ball.mesh.vertices_m.copy(), ball.mesh.triangles))
    assert again.distance_grid(2e-4) is ball.distance_grid(2e-4)
    larger = replace(ball, mesh=IndenterMesh(1.1 * ball.mesh.vertices_m, ball.mesh.triangles))
    assert larger.distance_grid(2e-4) is not ball.distance_grid(2e-4)
    top = np.array([[0.0, 0.0, 0.0088]])
    assert larger.signed_distance(top)[0] == pytest.approx(0.0, abs=5e-6)
    assert ball.signed_distance(top)[0] == pytest.approx(0.0008, abs=5e-6)


def test_kernel_samples_the_grid_with_a_continuous_gradient(ball: Indenter) -> None:
    points = points_around(ball)
    distance, gradient, _, taped = run_kernel(ball, points)
    assert np.abs(distance - sampled(ball.distance_grid(), points)).max() < 1e-7
    assert np.abs(taped - gradient).max() < 1e-3
    near = np.abs(distance) < 1e-3
    assert np.abs(np.linalg.norm(gradient, axis=1) - 1.0)[near].max() < 0.02
    line = np.linspace([0.0, -0.006, 0.001], [0.0003, 0.006, 0.0011], 20001)
    _, along, _, _ = run_kernel(ball, line)
    assert np.linalg.norm(np.diff(along, axis=0), axis=1).max() < 5e-3


def test_kernel_continues_outside_of_the_grid(ball: Indenter) -> None:
    points = np.array([[1.0, -2.0, 3.0], [0.0, 0.0, -0.1], [np.float32(1e6), 0.0, 0.0]])
    distance, gradient, _, _ = run_kernel(ball, points)
    assert np.all(distance > 0.5 * np.linalg.norm(points, axis=1))
    assert np.all(np.isfinite(gradient))


def block(extents: Sequence[float], place: Sequence[float]) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(extents=extents)
    mesh.apply_translation(place)
    return mesh


def closed_mesh() -> trimesh.Trimesh:
    return block([0.004, 0.004, 0.004], [0.0, 0.0, 0.002])


def assert_same_distance(mesh: Indenter, primitive: Indenter, tolerance_m: float) -> None:
    points = points_around(primitive)
    error = mesh.signed_distance(points) - primitive.signed_distance(points)
    assert np.abs(error).max() < tolerance_m


def ball_mesh(radius: float, place: Sequence[float] = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    ball.apply_translation(place)
    return ball


def write_ball(path: Path, place: Sequence[float] = (0.0, 0.0, 0.004)) -> Path:
    ball_mesh(0.004, place).export(path)
    return path


def test_mesh_with_a_hole_is_refused(tmp_path: Path) -> None:
    mesh = closed_mesh()
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    mesh.export(tmp_path / "hole.stl")
    with pytest.raises(ValueError, match=r"not closed \(3 edges"):
        load_mesh(tmp_path / "hole.stl")


@pytest.mark.fault("meshes", "a mesh in another unit")
@pytest.mark.parametrize(
    ("unit", "scale", "right"),
    [
        ("inches", 0.0254, r"in inches: it is then 8 mm long: scale=0\.0254"),
        ("millimetres", 0.001, r"in millimetres: it is then 8 mm long: scale=0\.001"),
    ],
)
def test_a_mesh_in_another_unit_is_refused_with_the_size_that_each_unit_gives(
    tmp_path: Path, unit: str, scale: float, right: str, answered: Callable[..., None]
) -> None:
    ball_mesh(0.004 / scale).export(tmp_path / "ball.stl")
    with pytest.raises(ValueError, match=right) as refused:
        load_mesh(tmp_path / "ball.stl")
    answered(refused.value, what=f"a ball of 8 mm in {unit}")
    assert load_mesh(tmp_path / "ball.stl", scale).bounds_m()[1][2] == pytest.approx(0.004)


@pytest.mark.fault("meshes", "a mesh in inches that was given as millimetres")
def test_a_mesh_that_is_tiny_in_its_unit_is_doubted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, answered: Callable[..., None]
) -> None:
    ball_mesh(0.004 / 0.0254).export(tmp_path / "inches.stl")
    warn_of_misfit(load_mesh(tmp_path / "inches.stl", 0.001), PAD_20_MM)
    assert "is 0.315 mm wide and 0.315 mm long, the gel 20 mm wide" in caplog.text
    assert "in inches: it is then 8 mm long: scale=0.0254" in caplog.text
    answered(caplog.records[-1].getMessage())
    with pytest.raises(ValueError, match=r"8 mm long: scale=1\), or scaled once too often"):
        load_mesh(write_ball(tmp_path / "metres.stl"), 0.001)


@pytest.mark.fault("meshes", "a mesh in millimetres that was given as inches")
def test_a_mesh_that_is_wider_than_the_gel_is_doubted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, answered: Callable[..., None]
) -> None:
    ball_mesh(2.0).export(tmp_path / "wide.stl")
    warn_of_misfit(load_mesh(tmp_path / "wide.stl", 0.0254), PAD_20_MM)
    assert "is 102 mm wide" in caplog.text
    assert "another unit (in millimetres: it is then 4 mm long: scale=0.001)" in caplog.text
    answered(caplog.records[-1].getMessage())
    warn_of_misfit(load_mesh(tmp_path / "wide.stl", 0.001), PAD_20_MM)
    assert len(caplog.records) == 1


@pytest.mark.fault("meshes", "a mesh that was drawn far from its file's origin")
def test_a_mesh_beside_its_axis_is_doubted_and_its_tip_can_be_the_origin(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, answered: Callable[..., None]
) -> None:
    path = write_ball(tmp_path / "aside.stl", place=[0.05, -0.02, 0.1])
    warn_of_misfit(load_mesh(path), PAD_20_MM)
    assert "from 46 to 54 mm along x and from -24 to -16 mm along y" in caplog.text
    answered(caplog.records[-1].getMessage())
    caplog.clear()
    at_tip = load_mesh(path, origin="tip")
    warn_of_misfit(at_tip, PAD_20_MM)
    assert not caplog.records
    assert_same_distance(at_tip, sphere(0.004), 6e-5)  # the facets' sagitta


def test_the_tip_of_a_level_face_or_edge_is_its_middle(tmp_path: Path) -> None:
    block([0.004, 0.006, 0.005], [0.03, 0.02, 0.01]).export(tmp_path / "block.stl")
    bounds = load_mesh(tmp_path / "block.stl", origin="tip").bounds_m()
    assert bounds == pytest.approx(np.array([[-0.002, -0.003, 0], [0.002, 0.003, 0.005]]), abs=1e-8)


def test_texture_seams_do_not_open_a_mesh(tmp_path: Path) -> None:
    corners = [(x, y, z) for x in (-2, 2) for y in (-2, 2) for z in (0, 4)]
    sides = ["2 1 3 4", "5 6 8 7", "1 2 6 5", "4 3 7 8", "3 1 5 7", "2 4 8 6"]
    # Each corner has a texture point of its own on each side.
    (tmp_path / "cube.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in corners)
        + "".join(f"vt {k / 24} 0.5\n" for k in range(24))
        + "".join(
            f"f {' '.join(f'{v}/{4 * k + i + 1}' for i, v in enumerate(side.split()))}\n"
            for k, side in enumerate(sides)
        )
    )
    textured = trimesh.load(tmp_path / "cube.obj", process=False)
    assert len(textured.vertices) == 24
    textured.export(tmp_path / "cube.ply")
    for name in ("cube.obj", "cube.ply"):
        loaded = load_mesh(tmp_path / name, 0.001)
        assert loaded.mesh is not None
        assert (len(loaded.mesh.vertices_m), len(loaded.mesh.triangles)) == (8, 12)
        assert_same_distance(loaded, box([0.004] * 3), 1e-8)


@pytest.mark.parametrize("content", [b"", b"\x00\xff" * 90])
def test_broken_file_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "broken.stl").write_bytes(content)
    with pytest.raises(ValueError, match=r"broken\.stl"):
        load_mesh(tmp_path / "broken.stl")


def test_inverted_and_doubled_triangles_are_repaired(tmp_path: Path) -> None:
    mesh = closed_mesh()
    mesh.invert()
    mesh = trimesh.Trimesh(mesh.vertices, np.vstack([mesh.faces, mesh.faces[:2]]), process=False)
    mesh.export(tmp_path / "inverted.ply")
    loaded = load_mesh(tmp_path / "inverted.ply")
    assert loaded.signed_distance([[0.0, 0.0, 0.001]])[0] == pytest.approx(-0.001, abs=1e-8)


@pytest.mark.fault("meshes", "a mesh of two bodies, one of them inside out")
@pytest.mark.parametrize("suffix", ["stl", "obj", "ply"])
def test_a_body_that_is_inside_out_is_turned(
    tmp_path: Path, suffix: str, caplog: pytest.LogCaptureFixture, answered: Callable[..., None]
) -> None:
    tip = ball_mesh(0.002, [0.0, 0.0, 0.002])
    tip.invert()
    # It reaches into the block that holds it, which is larger: the whole volume is positive.
    holder = block([0.01, 0.01, 0.01], [0.0, 0.0, 0.008])
    path = tmp_path / f"held_tip.{suffix}"
    trimesh.util.concatenate([tip, holder]).export(path)
    loaded = load_mesh(path)
    probes = [[0.0, 0.0, 0.0005], [0.0, 0.0, 0.0035], [0.0, 0.0, 0.006], [0.0, 0.003, 0.001]]
    assert np.sign(loaded.signed_distance(probes)).tolist() == [-1.0, -1.0, -1.0, 1.0]
    assert "held_tip" in caplog.text
    assert "1 of 2 bodies" in caplog.text
    if suffix == "stl":
        answered(caplog.records[-1].getMessage())


@pytest.mark.parametrize("outer_inverted", [False, True])
@pytest.mark.parametrize("inner_inverted", [False, True])
def test_a_cavity_stays_one_whichever_way_its_shells_are_turned(
    tmp_path: Path, outer_inverted: bool, inner_inverted: bool
) -> None:
    shells = [ball_mesh(radius, [0.0, 0.0, 4.0]) for radius in (4.0, 2.0, 1.0)]
    for shell, inverted in zip(shells, (outer_inverted, inner_inverted, False), strict=True):
        if inverted:
            shell.invert()
    trimesh.util.concatenate(shells[:2]).export(tmp_path / "hollow.stl")
    hollow = load_mesh(tmp_path / "hollow.stl", 0.001)
    probes = [[0.0, 0.0, -0.001], [0.0, 0.0, 0.001], [0.0, 0.0, 0.0025]]
    # A body within a body whose outside is right is left as it is: both are solid.
    inside = 1.0 if outer_inverted or inner_inverted else -1.0
    assert np.sign(hollow.signed_distance(probes)).tolist() == [1.0, -1.0, inside]
    # In a cavity there may be a body again.
    trimesh.util.concatenate(shells).export(tmp_path / "loose.stl")
    loose = load_mesh(tmp_path / "loose.stl", 0.001)
    assert loose.signed_distance([[0.0, 0.0, 0.0035]])[0] < 0.0


def test_collinear_and_doubled_triangles_do_not_open_a_mesh(tmp_path: Path) -> None:
    mesh = closed_mesh()
    (a, b, c), middle = mesh.faces[0], len(mesh.vertices)
    vertices = np.vstack([mesh.vertices, mesh.vertices[[a, b]].mean(axis=0)])
    # The new vertex splits an edge on one side only: a triangle without area closes the gap.
    split = [[a, middle, c], [middle, b, c], [a, b, middle], [a, a, b]]
    faces = np.vstack([mesh.faces[1:], split, mesh.faces[-2:]])
    trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "split.ply")
    assert_same_distance(load_mesh(tmp_path / "split.ply"), box([0.004] * 3), 1e-8)


@pytest.mark.fault("meshes", "bodies that share an edge")
def test_bodies_that_touch_along_an_edge_are_refused(
    tmp_path: Path, answered: Callable[..., None]
) -> None:
    aside = closed_mesh()
    aside.apply_translation([0.004, 0.004, 0.0])
    trimesh.util.concatenate([closed_mesh(), aside]).export(tmp_path / "touching.stl")
    with pytest.raises(ValueError, match=r"1 edges do not .* unite bodies") as refused:
        load_mesh(tmp_path / "touching.stl")
    answered(refused.value)


def test_mesh_is_turned_and_moved_to_its_tip(tmp_path: Path) -> None:
    mesh = trimesh.creation.cone(radius=0.003, height=0.006)
    mesh.export(tmp_path / "cone.obj")  # its apex points along +z
    loaded = load_mesh(tmp_path / "cone.obj", away_axis="-z", origin="tip")
    assert loaded.bounds_m()[0][2] == pytest.approx(0.0)
    probe = np.array([[0.0, 0.0, 0.001], [0.002, 0.0, 0.001], [0.002, 0.0, 0.0055]])
    assert np.sign(loaded.signed_distance(probe)).tolist() == [-1.0, 1.0, -1.0]


def test_missing_file_and_unknown_format_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        load_mesh(tmp_path / "nothing.stl")
    (tmp_path / "shape.step").write_text("ISO-10303-21;")
    with pytest.raises(ValueError, match="expected a mesh file"):
        load_mesh(tmp_path / "shape.step")


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: sphere(-0.004), "radius_m"),
        (lambda: sphere(float("nan")), "radius_m"),
        (lambda: sphere(4.0), r"at most 0\.2 m"),
        (lambda: box([0.004, 0.004]), "3 lengths"),
        (lambda: box([0.004, 0.004, 0.004], 0.003), "rounding"),
        (lambda: torus(0.001, 0.002), "minor_radius_m"),
        (lambda: cone(np.pi, 0.004), "half_angle_rad"),
    ],
)
def test_impossible_primitives_are_refused(build: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build()  # type: ignore[operator]


@pytest.mark.skipif(not REAL_MESHES, reason="no real indenters next to this checkout")
def test_a_real_mesh_loads_in_millimetres_only() -> None:
    path = REAL_MESHES[0]
    with pytest.raises(ValueError, match="millimetres"):
        load_mesh(path)
    indenter = load_mesh(path, 0.001, away_axis="-y", origin="tip")
    assert indenter.mesh is not None
    inside = indenter.signed_distance(indenter.mesh.vertices_m[::50] * [1.0, 1.0, 0.0] - 1e-4)
    assert np.all(inside > 0.0)
    assert np.abs(indenter.signed_distance(indenter.mesh.vertices_m[::50])).max() < 1e-6


@pytest.mark.parametrize(
    ("definition", "message"),
    [
        ("kind: pyramid\n", "kind must be one of"),
        ("kind: sphere\nradius: 0.004\n", "radius"),
        ("kind: sphere\nradius_m: four\n", "radius_m"),
        ("- sphere\n", "expected a mapping"),
    ],
)
def test_bad_definitions_are_refused(tmp_path: Path, definition: str, message: str) -> None:
    (tmp_path / "bad.yaml").write_text(definition)
    with pytest.raises(ValueError, match=message):
        load_indenter(tmp_path / "bad.yaml")


@pytest.mark.fault("sensor and YAML files", "an indenter that is not there")
def test_unknown_name_is_refused_with_those_that_there_are(answered: Callable[..., None]) -> None:
    expected = (
        r"no indenter is named 'Sphere_5mm' \(did you mean 'sphere_4mm'\?\), expected one of "
        r"box_edge, .*torus, or the path of a .* or a definition such as sphere\(radius_m=0\.003\)"
    )
    with pytest.raises(FileNotFoundError, match=expected) as refused:
        load_indenter("Sphere_5mm")
    answered(refused.value)
    with pytest.raises(ValueError, match=r"kind must be one of .* \(did you mean 'sphere'\?\)"):
        load_indenter("spere(radius_m=0.003)")


def test_a_home_is_meant_by_a_tilde(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    write_ball(tmp_path / "ball.stl")
    (tmp_path / "ball.yaml").write_text("kind: mesh\npath: ~/ball.stl\nname: mine\n")
    assert load_indenter("~/ball.yaml").name == "mine"
    for source in ("~/ball.stl", Path("~/ball.yaml"), "mesh(path=~/ball.stl)"):
        assert load_indenter(source).mesh == load_mesh(tmp_path / "ball.stl").mesh
    with pytest.raises(FileNotFoundError, match=r"no mesh file ~nobody_of_this_name/ball\.stl"):
        load_indenter("~nobody_of_this_name/ball.stl")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("sphere(radius_m=0.003)", sphere(0.003)),
        (" capsule( radius_m = 0.002 ,length_m=0.004)", PRIMITIVES["capsule"]),
        ("box(size_m=[0.006, 0.004, 0.005], edge_radius_m=0.0005)", PRIMITIVES["box"]),
        ("{kind: sphere, radius_m: 0.003}", sphere(0.003)),
    ],
)
def test_a_definition_in_one_line_is_what_a_parameter_can_hold(text, expected):
    found = load_indenter(text)
    assert (found.kind, found.parameters) == (expected.kind, expected.parameters)
    if text.startswith("{"):
        assert load_indenter(yaml.safe_load(text)).parameters == expected.parameters
    # Two of one kind differ by their names, under which a data set keeps them.
    assert found.name == text.strip()
    # What reads values as YAML, as ros2 param set does, must take it for text.
    assert isinstance(yaml.safe_load(text), str) is not text.startswith("{")


@pytest.mark.parametrize(
    "text", ["sphere()", "ball(radius_m=1)", "sphere(0.003)", "sphere(radius_m=[)"]
)
def test_a_wrong_definition_in_one_line_is_refused_with_the_reason(text):
    with pytest.raises(ValueError, match=r"indenter (definition|is no valid)"):
        load_indenter(text)
