# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The rivals' gels: Tacto's clipped skin, Taxim's Gaussians, DiffTactile's elements; each finds the
constants of its own simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from dotsim_ros.data.presses import Press
from dotsim_ros.geometry.indenter import Indenter, box, cone, flat_punch, sphere, torus
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin, flat_pad_skin
from studies.rivals import difftactile, fem_kernels, tacto, taxim
from studies.rivals.clipping import clip_depths, clipped_skin
from studies.rivals.difftactile import (
    DiffTactile,
    DiffTactileDivergenceError,
    DynamicGel,
    FitTrials,
    GelConstants,
    Shell,
    stiffness_at_rest,
)
from studies.rivals.penalty_force import penetration_vectors
from studies.rivals.tetrahedra import TetrahedralMesh, attach_skin, dome_shell, edge_matrices

RADIUS_M = 0.01575
TURNED = np.array([np.sin(0.2), 0.0, 0.0, np.cos(0.2)])
SHELL = Shell(0.006, 5.0e-3, 2)
CONSTANTS = GelConstants(0.43, 1.0e4, 1.0, 3.0, 0.4, 1.5)
BALL = sphere(0.005)


@pytest.fixture(scope="module")
def skin() -> SkinMesh:
    return dome_skin(RADIUS_M, 8.0e-4)


@pytest.fixture(scope="module")
def coarse_skin() -> SkinMesh:
    return dome_skin(RADIUS_M, 1.2e-3)


@pytest.fixture(scope="module")
def gel(coarse_skin: SkinMesh) -> DynamicGel:
    return DynamicGel(SHELL.mesh(coarse_skin), coarse_skin)


@pytest.fixture(scope="module")
def mesh() -> TetrahedralMesh:
    return dome_shell(RADIUS_M, 0.006, 4.0e-3, 3)


def press_to(*depths_m: float, side_m: float = 0.0) -> Press:
    poses = [Pose(np.array([side_m, 0.0, RADIUS_M - depth])) for depth in depths_m]
    return Press("press", "ball", poses, np.arange(len(poses), dtype=float))


@pytest.mark.parametrize(
    "indenter",
    [
        sphere(0.004),
        flat_punch(0.003, 0.01, 0.0003),
        cone(0.7, 0.008, 0.0005),
        torus(0.004, 0.0015),
        box((0.004, 0.006, 0.01)),
    ],
    ids=lambda indenter: indenter.name,
)
def test_no_vertex_stays_inside(indenter: Indenter, skin: SkinMesh) -> None:
    pose = Pose(np.array([0.001, -0.002, RADIUS_M - 0.003]), TURNED)
    depth = clip_depths(skin, [pose], indenter)
    moved = clipped_skin(skin, depth)[0]
    distance = indenter.signed_distance((moved - pose.position_m) @ pose.rotation())
    touched = depth[0] > 0.0
    assert touched.sum() > 5
    assert distance.min() >= -1.0e-12
    # On the surface, not beyond it: 24 nm along the normal at most.
    assert distance[touched].max() < 3.0e-8
    assert np.array_equal(moved[~touched], skin.rest_position_m[~touched])


def test_the_force_of_a_straight_press_is_its_depth_times_the_stiffness(skin: SkinMesh) -> None:
    press = press_to(0.0005, 0.001, 0.002)
    force = tacto.Tacto(1500.0).predict(press, sphere(0.004), skin).force_n
    assert force is not None
    assert force[:, 2] == pytest.approx([0.75, 1.5, 3.0], rel=1e-4)
    assert np.abs(force[:, :2]).max() < 0.01 * force[-1, 2]


def test_a_known_stiffness_is_found_from_noisy_forces(skin: SkinMesh) -> None:
    truth = tacto.Tacto(1234.0)
    press = press_to(*np.linspace(0.0002, 0.003, 8))
    seen = truth.predict(press, sphere(0.004), skin)
    assert seen.force_n is not None
    noise = np.random.default_rng(3).normal(scale=0.015, size=seen.force_n.shape)
    measured = replace(press, skin_position_m=seen.skin_position_m, force_n=seen.force_n + noise)
    fitted = tacto.fit([measured], {"ball": sphere(0.004)}, skin)
    assert fitted.stiffness_n_m == pytest.approx(1234.0, rel=5e-3)


def test_a_tilted_press_is_answered_along_its_own_normal(skin: SkinMesh) -> None:
    turn = Pose(np.zeros(3), TURNED)
    pose = Pose(turn.apply([0.0, 0.0, RADIUS_M - 0.002]), TURNED)
    depth = clip_depths(skin, [pose], sphere(0.004))
    vector = penetration_vectors(skin, depth)[0]
    along = turn.rotation()[:, 2]
    assert vector @ along == pytest.approx(0.002, abs=2e-5)
    assert np.linalg.norm(vector - (vector @ along) * along) < 4e-5


def test_smoothing_keeps_the_integral_and_the_range(skin: SkinMesh) -> None:
    values = np.random.default_rng(0).uniform(0.0, 1.0, size=(skin.vertex_count, 2))
    smooth = taxim.skin_smoother(skin).smooth(values, 0.003)
    assert skin.rest_area_m2 @ smooth == pytest.approx(skin.rest_area_m2 @ values, rel=1e-12)
    assert smooth.min() >= values.min()
    assert smooth.max() <= values.max()
    assert smooth.std() < 0.2 * values.std()


def test_a_peak_spreads_as_the_gaussian_of_the_width_does() -> None:
    pad = flat_pad_skin((0.024, 0.024), 0.004, 4.0e-4)
    width = 0.0015
    peak = np.zeros((pad.vertex_count, 1))
    middle = np.argmin(np.linalg.norm(pad.rest_position_m[:, :2], axis=1))
    peak[middle] = 1.0 / pad.rest_area_m2[middle]
    smooth = taxim.skin_smoother(pad).smooth(peak, width)[:, 0]
    away = np.linalg.norm(pad.rest_position_m[:, :2] - pad.rest_position_m[middle, :2], axis=1)
    gaussian = np.exp(-0.5 * (away / width) ** 2) / (2.0 * np.pi * width**2)
    assert np.abs(smooth - gaussian).max() < 0.03 * gaussian.max()


def test_the_contact_keeps_the_shape_of_the_object(skin: SkinMesh) -> None:
    depth = clip_depths(skin, press_to(0.002).poses, sphere(0.004))
    smoother = taxim.skin_smoother(skin)
    sharp = taxim.Pyramid(0.002, 0.5, 0.5, 0.0)
    smooth = taxim.smoothed_depths(smoother, depth, sharp)
    core = depth > 0.5 * depth.max()
    assert np.array_equal(smooth[core], depth[core])
    # Next to the contact the gel is drawn in.
    beside = (depth == 0.0) & (smooth > 1.0e-4)
    assert beside.sum() > 20
    assert smooth.min() >= 0.0


def test_known_widths_are_found(skin: SkinMesh) -> None:
    truth = taxim.Taxim(taxim.Pyramid(0.0025, 0.4, 0.6, 2.0e-4), 900.0)
    press = press_to(0.001, 0.002, 0.003)
    seen = truth.predict(press, sphere(0.004), skin)
    measured = replace(press, skin_position_m=seen.skin_position_m, force_n=seen.force_n)
    fitted = taxim.fit([measured], {"ball": sphere(0.004)}, skin, seed=1)
    assert fitted.stiffness_n_m == pytest.approx(900.0, rel=1e-9)
    again = fitted.predict(press, sphere(0.004), skin)
    error = np.abs(again.skin_position_m - seen.skin_position_m)
    motion = np.abs(seen.skin_position_m - skin.rest_position_m)
    assert np.sqrt(np.mean(error**2)) < 0.03 * np.sqrt(np.mean(motion**2))
    assert fitted.pyramid.widest_m == pytest.approx(0.0025, rel=0.25)


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


def test_the_skin_rides_on_the_surface(mesh: TetrahedralMesh, coarse_skin: SkinMesh) -> None:
    weight = attach_skin(mesh, coarse_skin)
    assert weight.sum(axis=1) == pytest.approx(1.0)
    assert weight.min() >= 0.0
    # A chord of 4 mm lies 0.13 mm below the dome.
    gap = np.linalg.norm(weight @ mesh.position_m - coarse_skin.rest_position_m, axis=1)
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


def test_a_gel_that_blows_up_is_reported(gel: DynamicGel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(difftactile, "STEP_SHARE", 3.0)
    with pytest.raises(DiffTactileDivergenceError, match="frame 0: the gel diverged"):
        gel.run(press_to(0.002).poses, BALL, CONSTANTS)


def test_a_known_gel_is_found_from_noisy_measurements(
    gel: DynamicGel, coarse_skin: SkinMesh
) -> None:
    known = replace(difftactile.START, poisson_ratio=0.43, friction=0.2)
    truth = DiffTactile(known, 2.5e5, gel)
    # A press and a slide: without sliding, nothing tells the friction.
    poses = [
        Pose(np.array([side, 0.0, RADIUS_M - depth]))
        for side, depth in ((0.0, 0.001), (0.0, 0.002), (0.001, 0.002), (0.002, 0.002))
    ]
    press = Press("press", "ball", poses, np.arange(4, dtype=float))
    seen = truth.predict(press, BALL, coarse_skin)
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
