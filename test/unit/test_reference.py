# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The finite-element reference: its mesh, its input file, and a press that CalculiX solves."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.data.data_set_writer import DataSetWriter
from dotsim_ros.data.scripted import Site
from dotsim_ros.gel.material import MooneyRivlin, NeoHookean, Yeoh
from dotsim_ros.geometry.indenter import load_indenter, sphere
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.geometry.surface import indenter_surface
from dotsim_ros.specification import (
    ContactSpecification,
    GelSpecification,
    load_sensor,
)
from studies.reference.axisymmetric import (
    AxisymmetricDeck,
    AxisymmetricSettings,
    dome_section,
)
from studies.reference.blocks import StepControl
from studies.reference.deck import EARLY_M, Deck
from studies.reference.mesh import (
    MeshedPress,
    dome_mesh,
    interpolate_skin,
)
from studies.reference.press import (
    ReferencePress,
    ReferenceSettings,
    press_poses,
    reference_deck,
)
from studies.reference.presses import reference_presses
from studies.reference.results import read_solved_presses, solved_press, stamps_ns
from studies.reference.run import CalculixError, CalculixMissingError, solve

OUTER_M, CORE_M = 0.01575, 0.006
INDENTERS = ("sphere_4mm", "cone", "flat_punch", "lying_cylinder", "torus", "box_edge")
FACES = (
    (0, 1, 2, 3),
    (4, 7, 6, 5),
    (0, 4, 5, 1),
    (1, 5, 6, 2),
    (2, 6, 7, 3),
    (3, 7, 4, 0),
)

needs_calculix = pytest.mark.skipif(
    shutil.which("ccx") is None, reason="CalculiX is not installed: apt-get install calculix-ccx"
)


def _mesh(tilt_deg=0.0, spacing_m=1.2e-3, radius_m=3e-3):
    pole = Site(tilt_rad=np.deg2rad(tilt_deg), azimuth_rad=0.7).direction()
    return dome_mesh(
        core_radius_m=CORE_M,
        outer_radius_m=OUTER_M,
        press=MeshedPress(pole, radius_m),
        spacing_m=spacing_m,
    )


# In the order that makes a right-handed triple of edges.
CORNER_NEIGHBOURS = (
    (1, 3, 4),
    (2, 0, 5),
    (3, 1, 6),
    (0, 2, 7),
    (7, 5, 0),
    (4, 6, 1),
    (5, 7, 2),
    (6, 4, 3),
)


def corner_volumes(mesh):
    """Return (E, 8) scaled triple products of the edges at each corner: 1 for a brick, at most 0
    where an element is turned inside out."""
    corner = mesh.node_m[mesh.element[:, :8]]
    products = []
    for own, others in enumerate(CORNER_NEIGHBOURS):
        edges = corner[:, others] - corner[:, own : own + 1]
        edges /= np.linalg.norm(edges, axis=2, keepdims=True)
        products.append(np.linalg.det(edges))
    return np.stack(products, axis=1)


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0, 40.0])
def test_elements_are_well_shaped_wherever_the_dome_is_pressed(tilt_deg):
    assert corner_volumes(_mesh(tilt_deg)).min() > 0.7


def test_elements_fill_the_shell_without_gaps():
    mesh = _mesh(30.0)
    face = np.sort(mesh.element[:, FACES].reshape(-1, 4), axis=1)
    kinds, count = np.unique(face, axis=0, return_counts=True)
    assert set(count.tolist()) == {1, 2}
    node = mesh.node_m[kinds[count == 1]]
    radius = np.linalg.norm(node, axis=2)
    on_skin = np.all(np.isclose(radius, OUTER_M), axis=1)
    on_core = np.all(np.isclose(radius, CORE_M), axis=1)
    on_base = np.all(np.abs(node[..., 2]) < 1e-12, axis=1)
    assert np.all(on_skin | on_core | on_base)
    assert on_skin.sum() == len(mesh.skin_element)


def _pole(tilt_deg):
    return Site(tilt_rad=np.deg2rad(tilt_deg), azimuth_rad=0.7).direction()


def test_interpolation_reproduces_a_quadratic_field_of_the_skin():
    mesh = _mesh(20.0)
    points = dome_skin(OUTER_M, 1e-3).rest_position_m
    at = interpolate_skin(mesh, points)
    np.testing.assert_allclose(at.weight.sum(axis=1), 1.0, atol=1e-12)
    near = np.linalg.norm(points - OUTER_M * _pole(20.0), axis=1) < 4e-3
    assert np.abs(at.of(mesh.node_m) - points)[near].max() < 2e-6


@pytest.mark.parametrize("name", INDENTERS)
def test_surface_of_an_indenter_is_closed_and_exact(name):
    indenter = load_indenter(name)
    surface = indenter_surface(indenter, 0.3e-3)
    mesh = trimesh.Trimesh(surface.vertices_m, surface.triangles, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0.0
    assert np.abs(indenter.signed_distance(surface.vertices_m)).max() < 1e-9
    middle = surface.vertices_m[surface.triangles].mean(axis=1)
    assert np.abs(indenter.signed_distance(middle)).max() < 20e-6
    assert abs(surface.vertices_m[:, 2].min()) < 1e-9


def _deck(law, friction=0.4, depth_m=0.4e-3, spacing_m=2.4e-3):
    indenter = load_indenter("sphere_4mm")
    poses = press_poses(Site(), depth_m=depth_m, frame_count=1)
    settings = ReferenceSettings(spacing_m=spacing_m)
    specification = load_sensor("densetact2")
    skin = dome_skin(OUTER_M, 1e-3)
    deck = reference_deck(specification, skin, indenter, poses, settings)
    contact = ContactSpecification(friction_coefficient=friction)
    return Deck(deck.gel, deck.surface, deck.poses, law, contact, deck.controls)


def _block(text, keyword):
    lines = text.splitlines()
    return lines[lines.index(keyword) + 1]


def test_yeoh_is_given_positive_volumetric_constants():
    line = _block(_deck(Yeoh(4e4, 3e3, 2e2, 5e6)).text(), "*HYPERELASTIC, YEOH")
    constants = [float(entry) for entry in line.split(",")]
    np.testing.assert_allclose(constants[:4], [0.04, 0.003, 0.0002, 0.4])
    assert min(constants[4:]) > 1e3 * constants[3]


def test_laws_have_their_own_cards():
    neo_hooke = _block(_deck(NeoHookean(3e5, 0.48)).text(), "*HYPERELASTIC, NEO HOOKE")
    mu, bulk = 0.3 / 2.96, 0.3 / 0.12
    np.testing.assert_allclose(
        [float(entry) for entry in neo_hooke.split(",")], [0.5 * mu, 2 / bulk]
    )
    mooney = _block(_deck(MooneyRivlin(4e4, 1e4, 5e6)).text(), "*HYPERELASTIC, MOONEY-RIVLIN")
    np.testing.assert_allclose([float(entry) for entry in mooney.split(",")], [0.04, 0.01, 0.4])


def test_press_ends_with_a_drag_along_the_indenter():
    site = Site(tilt_rad=0.5)
    poses = press_poses(site, depth_m=1e-3, frame_count=4, shear_m=0.6e-3)
    assert len(poses) == 1 + 4 + 3
    moved = poses[-1].position_m - poses[4].position_m
    np.testing.assert_allclose(moved, 0.6e-3 * poses[4].rotation()[:, 0], atol=1e-12)
    assert np.all(np.diff(stamps_ns(poses)) > 0)


def test_surface_lies_where_the_gels_contact_begins():
    nodes = _deck(NeoHookean(3e5, 0.48)).indenter_nodes_m()
    distance = sphere(4e-3).signed_distance(nodes[len(nodes) // 2 :])
    # The last ring's normals are those of the triangles on one side alone.
    np.testing.assert_allclose(np.median(distance), EARLY_M, atol=1e-8)
    assert np.abs(distance - EARLY_M).max() < 0.5e-6


def test_missing_calculix_is_reported_with_the_way_to_install_it(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(CalculixMissingError, match="apt-get install calculix-ccx"):
        reference_presses(out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@needs_calculix
def test_a_run_that_takes_too_long_is_ended():
    with pytest.raises(CalculixError, match="ended after"):
        solve(_deck(NeoHookean(3e5, 0.48)), time_limit_s=0.2)


def _section_deck(name):
    settings = AxisymmetricSettings(spacing_m=0.8e-3, surface_step_m=0.4e-3)
    return AxisymmetricDeck(
        section=dome_section(GelSpecification(), settings),
        indenter=load_indenter(name),
        apex_m=OUTER_M,
        depth_m=[-2e-5, 0.5e-3],
        law=NeoHookean(3e5, 0.48),
        contact=ContactSpecification(),
        settings=settings,
    )


def test_half_section_is_filled_without_gaps():
    section = dome_section(GelSpecification(), AxisymmetricSettings(spacing_m=0.8e-3))
    corner = section.node_m[section.element[:, :4]]
    across = corner - corner[:, :1]
    area = 0.5 * (
        across[:, 1, 0] * across[:, 2, 1]
        - across[:, 1, 1] * across[:, 2, 0]
        + across[:, 2, 0] * across[:, 3, 1]
        - across[:, 2, 1] * across[:, 3, 0]
    )
    assert area.min() > 0.0
    np.testing.assert_allclose(area.sum(), 0.25 * np.pi * (OUTER_M**2 - CORE_M**2), rtol=0.01)
    assert set(np.unique(section.element)) == set(range(len(section.node_m)))
    skin = section.node_m[section.element[section.skin_element][:, [2, 6, 3]]]
    np.testing.assert_allclose(np.linalg.norm(skin, axis=2), OUTER_M)
    line = section.node_m[section.skin_node]
    np.testing.assert_allclose(np.linalg.norm(line, axis=1), OUTER_M)
    assert (np.diff(line[:, 0]) > 0.0).all()


@pytest.mark.parametrize("name", ["sphere_4mm", "cone", "flat_punch", "torus"])
def test_meridian_lies_where_contact_begins_all_around(name):
    deck = _section_deck(name)
    line = deck.indenter_nodes_m()[2]
    assert len(line) % 2 == 1
    points = np.stack([line[:, 0], 0.0 * line[:, 0], line[:, 1]], axis=1)
    distance = deck.indenter.signed_distance(points)
    assert line[:, 0].min() > -1e-12
    assert np.abs(distance - EARLY_M).max() < 2e-6
    # The tip is there, on the axis or around it.
    assert line[:, 1].min() < -EARLY_M + 1e-6


@needs_calculix
def test_two_dimensions_give_what_three_give():
    indenter = load_indenter("sphere_4mm")
    specification = load_sensor("densetact2")
    skin = dome_skin(OUTER_M, 1e-3)
    # Without drag, both bear the whole press in one increment.
    quick = {"surface_step_m": 0.4e-3, "control": StepControl(first=1.0)}
    flat = AxisymmetricSettings(spacing_m=0.6e-3, **quick)
    two, three = (
        solved_press(ReferencePress(specification, indenter, 1.0e-3, 1, settings=settings), skin)[0]
        for settings in (flat, ReferenceSettings(spacing_m=2.4e-3, **quick))
    )
    force = two.wrench.force_n[1]
    np.testing.assert_allclose(force[:2], 0.0)
    np.testing.assert_allclose(three.wrench.force_n[1], force, atol=0.05 * force[2])
    apart = two.skin.position_m[1] - three.skin.position_m[1]
    assert np.sqrt(np.mean(np.sum(apart**2, axis=1))) < 15e-6


SENSOR = """
name: coarse
gel: {skin_spacing_m: 0.001}
material: {law: yeoh, c10_pa: 5.0e4, c20_pa: 4.0e3, c30_pa: 2.0e2, bulk_modulus_pa: 2.5e6}
contact: {friction_coefficient: 0.3}
solver: {refined: false}
"""


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """A coarse, tilted press with friction: what asked for it, and its data set."""
    folder = tmp_path_factory.mktemp("reference")
    sensor = folder / "sensor.yaml"
    sensor.write_text(SENSOR)
    asked = {"sensor": str(sensor), "out": folder / "out", "tilts_deg": (25.0,)}
    asked |= {"depth_mm": 0.5, "frames": 1, "spacing_mm": 3.0}
    found = reference_presses(**asked)
    assert not found["failed"]
    (row,) = found["frames"]
    assert row["frame"] == 1
    assert row["iterations"] > 0
    return asked, folder / "out"


@needs_calculix
def test_solved_press_is_a_data_set(reference):
    _, out = reference
    data_set = read_data_set(out)
    entry = data_set.entries[0]
    assert (entry.indenter, entry.frame_count, entry.has_images) == ("sphere_4mm", 2, False)
    indenter = load_indenter(data_set.indenter_file("sphere_4mm"))
    np.testing.assert_allclose(indenter.bounds_m()[1, 2], 8e-3, atol=1e-6)
    trajectory = entry.read()
    rest = data_set.skin_mesh().rest_position_m
    np.testing.assert_allclose(trajectory.skin.position_m[0], rest, atol=1e-8)
    assert not trajectory.wrench.force_n[0].any()


@needs_calculix
def test_solved_force_is_that_of_a_press_along_the_normal(reference):
    _, out = reference
    trajectory = read_data_set(out).entries[0].read()
    axis = trajectory.pose.poses()[1].rotation()[:, 2]
    force = trajectory.wrench.force_n[1]
    normal = float(force @ axis)
    # Hertz, of two spheres and an incompressible half-space of E = 6 C10.
    radius = 1.0 / (1.0 / 4e-3 + 1.0 / OUTER_M)
    hertz = 4.0 / 3.0 * (3e5 / 0.75) * np.sqrt(radius) * 0.5e-3**1.5
    assert 0.9 * hertz < normal < 1.5 * hertz
    assert np.linalg.norm(force - normal * axis) < 0.05 * normal


@needs_calculix
def test_solved_press_says_what_it_was_solved_for(reference):
    _, out = reference
    skin, (press,) = read_solved_presses(out)
    assert press.specification.name == "coarse"
    assert press.trajectory.name == Path(press.notes["bag"]).name
    assert press.trajectory.name.endswith("spacing3")
    assert press.specification.material.c20_pa == 4.0e3
    assert press.specification.contact.friction_coefficient == 0.3
    assert press.notes["press"]["tilt_deg"] == 25.0
    assert press.trajectory.skin.position_m.shape == (2, skin.vertex_count, 3)
    np.testing.assert_allclose(press.indenter.signed_distance([[0.0, 0.0, -1e-3]]), 1e-3, atol=1e-6)


@needs_calculix
def test_broken_off_or_changed_trajectory_does_not_count_as_solved(reference, tmp_path):
    _, out = reference
    _, (solved,) = read_solved_presses(out)
    data_set = DataSetWriter(tmp_path, read_data_set(out).skin_mesh())
    press = ReferencePress(solved.specification, sphere(4e-3), 0.5e-3, 1, tilt_deg=25.0)
    name, notes = solved.trajectory.name, press.notes()
    assert not data_set.holds(name, notes)
    data_set.add(solved.trajectory, press.indenter, notes, failure="stopped")
    assert not data_set.holds(name, notes)
    data_set.add(solved.trajectory, press.indenter, notes)
    assert data_set.holds(name, notes)
    assert not data_set.holds(name, notes | {"settings": {"spacing_m": 1e-3}})
    data_set.bag(name).rename(tmp_path / "elsewhere")
    assert not data_set.holds(name, notes)
    data_set.add(solved.trajectory, press.indenter, notes)
    assert [entry.name for entry in read_data_set(tmp_path).entries] == [name]
