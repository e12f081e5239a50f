# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""DiffTactile's gel: its elements, its rest, its symmetry, and constants told from a simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from dotsim_ros.data.presses import Press
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin
from studies.rivals import difftactile, fem_kernels
from studies.rivals.difftactile import (
    DiffTactile,
    DiffTactileDivergenceError,
    DynamicGel,
    FitTrials,
    GelConstants,
    Shell,
    stiffness_at_rest,
)
from studies.rivals.tetrahedra import TetrahedralMesh, attach_skin, dome_shell, edge_matrices

RADIUS_M = 0.01575
SHELL = Shell(0.006, 5.0e-3, 2)
CONSTANTS = GelConstants(0.43, 1.0e4, 1.0, 3.0, 0.4, 1.5)
BALL = sphere(0.005)


@pytest.fixture(scope="module")
def skin() -> SkinMesh:
    return dome_skin(RADIUS_M, 1.2e-3)


@pytest.fixture(scope="module")
def gel(skin: SkinMesh) -> DynamicGel:
    return DynamicGel(SHELL.mesh(skin), skin)


@pytest.fixture(scope="module")
def mesh() -> TetrahedralMesh:
    return dome_shell(RADIUS_M, 0.006, 4.0e-3, 3)


def press_to(*depths_m: float, side_m: float = 0.0) -> Press:
    poses = [Pose(np.array([side_m, 0.0, RADIUS_M - depth])) for depth in depths_m]
    return Press("press", "ball", poses, np.arange(len(poses), dtype=float))


def nodal_forces(mesh: TetrahedralMesh, position_m: np.ndarray, poisson_ratio: float) -> np.ndarray:
    """Return (N, 3) forces of the elements on the nodes, in units of the modulus."""
    edges = edge_matrices(mesh.position_m, mesh.tetrahedra)
    shear, dilation = difftactile.neo_hookean_constants(poisson_ratio)
    force = wp.zeros((len(edges), 4), dtype=fem_kernels.VEC3, device="cpu")
    wp.launch(
        fem_kernels.element_forces,
        dim=len(edges),
        inputs=[
            wp.array(position_m, dtype=fem_kernels.VEC3, device="cpu"),
            wp.array(mesh.tetrahedra, dtype=wp.vec4i, device="cpu"),
            wp.array(np.linalg.inv(edges), dtype=fem_kernels.MAT33, device="cpu"),
            wp.array(np.linalg.det(edges) / 6.0, dtype=fem_kernels.SCALAR, device="cpu"),
            shear,
            dilation,
        ],
        outputs=[force],
        device="cpu",
    )
    summed = np.zeros_like(position_m)
    np.add.at(summed, mesh.tetrahedra, force.numpy())
    return summed


def test_the_tetrahedra_fill_the_shell_without_gaps(mesh: TetrahedralMesh) -> None:
    volume = np.linalg.det(edge_matrices(mesh.position_m, mesh.tetrahedra)) / 6.0
    assert volume.min() > 0.0
    faces = np.concatenate(
        [mesh.tetrahedra[:, list(face)] for face in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))]
    )
    _, first, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    assert count.max() == 2
    # What belongs to one tetrahedron is skin, or bonded to core or base.
    outer = {tuple(sorted(face)) for face in mesh.surface.tolist()}
    for face in faces[first[count == 1]]:
        assert tuple(sorted(face.tolist())) in outer or mesh.is_fixed[face].all()
    assert len(outer) == sum(tuple(sorted(f)) in outer for f in faces[first[count == 1]].tolist())


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.49])
def test_patch_of_an_even_deformation(mesh: TetrahedralMesh, poisson_ratio: float) -> None:
    gradient = np.eye(3) + np.array([[0.1, 0.05, 0.0], [-0.02, -0.08, 0.03], [0.04, 0.0, 0.06]])
    force = nodal_forces(mesh, mesh.position_m @ gradient.T, poisson_ratio)
    on_skin = np.isin(np.arange(len(force)), mesh.surface)
    inside = ~mesh.is_fixed & ~on_skin
    assert inside.sum() > 100
    assert np.abs(force[inside]).max() < 1e-12 * np.abs(force[on_skin]).max() * 1e3
    assert np.abs(force.sum(axis=0)).max() < 1e-12 * np.abs(force).sum()


def test_a_small_strain_is_that_of_the_linear_solid(mesh: TetrahedralMesh) -> None:
    # Hooke: a free bar of unit modulus under axial strain e contracts by nu e and carries e.
    strain, poisson_ratio = 1.0e-5, 0.4
    bar = np.diag([-poisson_ratio, -poisson_ratio, 1.0]) * strain
    moved = mesh.position_m @ (np.eye(3) + bar)
    force = nodal_forces(mesh, moved, poisson_ratio)
    linear = (stiffness_at_rest(mesh, poisson_ratio) @ (moved - mesh.position_m).ravel()).reshape(
        -1, 3
    )
    assert force == pytest.approx(-linear, abs=2e-4 * np.abs(linear).max())
    # Virtual work of the boundary against the same strain: stress strain volume.
    volume = np.linalg.det(edge_matrices(mesh.position_m, mesh.tetrahedra)).sum() / 6.0
    work = float(np.sum(linear * (moved - mesh.position_m)))
    assert work == pytest.approx(strain**2 * volume, rel=1e-9)


def test_the_skin_rides_on_the_surface(mesh: TetrahedralMesh, skin: SkinMesh) -> None:
    weight = attach_skin(mesh, skin)
    assert weight.sum(axis=1) == pytest.approx(1.0)
    assert weight.min() >= 0.0
    # A chord of 4 mm lies 0.13 mm below the dome.
    gap = np.linalg.norm(weight @ mesh.position_m - skin.rest_position_m, axis=1)
    assert gap.max() < 2.5e-4


def test_mirrored_presses_are_answered_alike(gel: DynamicGel) -> None:
    _, left = gel.run(press_to(0.001, 0.002, side_m=-0.003).poses, BALL, CONSTANTS)
    _, right = gel.run(press_to(0.001, 0.002, side_m=0.003).poses, BALL, CONSTANTS)
    assert left[1, 0] < 0.0 < right[1, 0]
    # The mesh is no mirror image of itself: a degree of the force's direction.
    difference = left[1] * [-1.0, 1.0, 1.0] - right[1]
    assert np.linalg.norm(difference) < 0.02 * np.linalg.norm(right[1])


def test_a_slide_is_held_back_by_friction(gel: DynamicGel) -> None:
    poses = [Pose(np.array([x, 0.0, RADIUS_M - 0.0015])) for x in (0.0, 0.0008, 0.0016)]
    _, rough = gel.run(poses, BALL, replace(CONSTANTS, friction=0.8))
    _, smooth = gel.run(poses, BALL, replace(CONSTANTS, friction=0.0))
    # The gel pushes the indenter back, against its motion along +x.
    assert rough[-1, 0] < smooth[-1, 0] - 0.05 * smooth[-1, 2]


def test_a_gel_that_blows_up_is_told(gel: DynamicGel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(difftactile, "STEP_SHARE", 3.0)
    with pytest.raises(DiffTactileDivergenceError, match="frame 0: the gel diverged"):
        gel.run(press_to(0.002).poses, BALL, CONSTANTS)


def test_a_known_gel_is_told_from_noisy_measurements(gel: DynamicGel, skin: SkinMesh) -> None:
    known = replace(difftactile.START, poisson_ratio=0.43, friction=0.2)
    truth = DiffTactile(known, 2.5e5, gel)
    # A press and a slide: without sliding, nothing tells the friction.
    poses = [
        Pose(np.array([side, 0.0, RADIUS_M - depth]))
        for side, depth in ((0.0, 0.001), (0.0, 0.002), (0.001, 0.002), (0.002, 0.002))
    ]
    press = Press("press", "ball", poses, np.arange(4, dtype=float))
    seen = truth.predict(press, BALL, skin)
    assert seen.force_n is not None
    rng = np.random.default_rng(0)
    measured = replace(
        press,
        skin_position_m=seen.skin_position_m
        + rng.normal(scale=4e-5, size=seen.skin_position_m.shape),
        force_n=seen.force_n + rng.normal(scale=0.015, size=seen.force_n.shape),
    )
    grid = {"poisson_ratio": (0.38, 0.43, 0.48), "friction": (0.0, 0.2, 0.8)}
    fitted = difftactile.fit([measured], FitTrials(gel, {"ball": BALL}), grid=grid)
    assert fitted.constants == truth.constants
    assert fitted.youngs_modulus_pa == pytest.approx(2.5e5, rel=1e-2)
