# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gel with a batch axis, against the implicit gel and against itself."""

from dataclasses import replace

import numpy as np
import pytest

from dotsim_ros.data.presses import Press
from dotsim_ros.gel.discretization import discretize
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.implicit.rest_compliance import kept_compliance
from dotsim_ros.gel.make import body_of, law_of, make_gel_batch, skin_of
from dotsim_ros.geometry.indenter import Indenter, load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.specification import SensorSpecification, load_sensor

torch = pytest.importorskip("torch")

from dotsim_ros.gel.batched.gel import BatchedGel, BatchState, Effort  # noqa: E402
from dotsim_ros.gel.batched.mixing import Mixing  # noqa: E402
from dotsim_ros.gel.batched.rest_compliance import RestCompliance, kept_blocks  # noqa: E402
from studies.geometry.batched_model import BatchedModel  # noqa: E402
from studies.geometry.implicit_model import ImplicitModel  # noqa: E402
from studies.speed.many_on_device import Counted  # noqa: E402

SENSOR = load_sensor("densetact2")
NAMES = ("sphere_4mm", "box_edge", "torus")


def pressed(depth_m: float, aside_m: float = 0.0) -> Pose:
    """Return a pose that presses along an axis off the dome's own."""
    axis = np.array((0.3, 0.15, 1.0)) / np.linalg.norm((0.3, 0.15, 1.0))
    half = np.array([-axis[1], axis[0], 0.0, 1.0 + axis[2]])
    pose = Pose(axis * (SENSOR.gel.outer_radius_m - depth_m), half / np.linalg.norm(half))
    return Pose(pose.position_m + aside_m * pose.rotation()[:, 1], pose.quaternion_xyzw)


def step(gel: BatchedGel, poses: list[Pose]) -> BatchState:
    return gel.step(
        np.array([pose.position_m for pose in poses]),
        np.array([pose.quaternion_xyzw for pose in poses]),
    )


def solved_closely(sensor: SensorSpecification, indenter: Indenter) -> ImplicitGel:
    solver = replace(sensor.solver, tolerance_m=1e-6, iterations=40)
    return make_gel_batch(replace(sensor, solver=solver), indenter=indenter, environment_count=1)


@pytest.fixture(scope="module")
def indenters():
    return [load_indenter(name) for name in NAMES]


def test_presses_slides_and_releases_are_those_of_the_implicit_gel(indenters):
    gel = BatchedGel(SENSOR, indenters, len(NAMES))
    singles = [solved_closely(SENSOR, one) for one in indenters]
    motion = [(0.5e-3, 0.0), (1.0e-3, 0.0), (1.0e-3, 0.4e-3), (0.4e-3, 0.4e-3)]
    for depth_m, aside_m in motion:
        # Each gel at a depth of its own.
        poses = [pressed(depth_m + 0.1e-3 * k, aside_m) for k in range(len(NAMES))]
        found = step(gel, poses)
        for b, (single, pose) in enumerate(zip(singles, poses, strict=True)):
            [right] = single.step([pose], 0.04)
            force_n = np.linalg.norm(right.wrench.force_n)
            skin_m = found.skin_position_m[b].numpy() - right.skin_position_m
            assert np.linalg.norm(skin_m, axis=1).max() < 60e-6, (NAMES[b], depth_m, aside_m)
            np.testing.assert_allclose(
                found.force_n[b].numpy(), right.wrench.force_n, atol=0.02 * force_n
            )
            np.testing.assert_allclose(
                found.torque_nm[b].numpy(), right.wrench.torque_nm, atol=0.02 * force_n * 16e-3
            )
    # An indenter away leaves nothing behind.
    released = step(gel, [pressed(-1e-3)] * len(NAMES))
    assert not released.force_n.any()
    rest = np.broadcast_to(gel.rest_position_m, released.skin_position_m.shape)
    np.testing.assert_array_equal(released.skin_position_m.numpy(), rest)


def test_the_model_of_studies_presses_the_skin_that_was_measured():
    pad = load_sensor("flat_pad")
    block = replace(
        pad,
        gel=replace(pad.gel, pad_size_m=(8e-3, 8e-3, 4e-3), skin_spacing_m=1e-3),
        solver=replace(pad.solver, refined=False),
    )
    measured = skin_of(replace(block.gel, skin_spacing_m=0.8e-3))
    way = [(0.0, -0.1), (0.0, 0.2), (0.0, 0.4), (0.2, 0.4)]
    poses = [Pose(np.array([1e-3 * x, 0.0, 4e-3 - 1e-3 * depth])) for x, depth in way]
    press = Press("press", "sphere_4mm", poses, 0.04 * np.arange(1.0, 5.0))
    ball = load_indenter("sphere_4mm")
    right = ImplicitModel(block).predict(press, ball, measured)
    model = BatchedModel(block, "default")
    # Another indenter before leaves nothing.
    model.predict(press, load_indenter("cone"), measured)
    found = model.predict(press, ball, measured)
    assert found.skin_position_m.shape == (4, measured.vertex_count, 3)
    assert np.linalg.norm(found.skin_position_m - right.skin_position_m, axis=2).max() < 20e-6
    np.testing.assert_allclose(found.force_n, right.force_n, atol=0.02 * right.force_n.max())


@pytest.mark.parametrize("curvature", [0.0, 0.3])
def test_mixing_converges_where_steps_alone_would_grow_elevenfold(curvature):
    """The gel's stiffness as a multiple of that at rest: what it is under a ball 3 mm deep."""
    torch.manual_seed(0)
    multiple = torch.logspace(-1.0, np.log10(12.0), 300).view(100, 3, 1)
    end = 1e-4 * torch.randn(100, 3, 1)
    mixing, point = Mixing(1, 300, 12, "cpu"), torch.zeros(100, 3, 1)
    for _ in range(48):
        off = end - point
        point = point + mixing.step(point, multiple * off * (1.0 + curvature * (off / 1e-4) ** 2))
    assert (point - end).norm() < 0.02 * end.norm()


def test_a_gel_does_not_depend_on_the_others(indenters):
    """With fixed counts, to what the products of another size round differently. The host then
    reads how many substeps there are and nothing else, and the state keeps its memory: a substep
    can be recorded as a graph."""
    effort = Effort(outer=3, newton=4, tolerance_m=0.0)
    together = BatchedGel(SENSOR, indenters[:2], 2, effort=effort)
    alone = BatchedGel(SENSOR, indenters[1], 1, effort=effort)
    states = {name: each for name, each in vars(together).items() if isinstance(each, torch.Tensor)}
    memory = {name: each.data_ptr() for name, each in states.items()}
    for depth_m in (0.5e-3, 0.8e-3):
        with Counted() as counted:
            both = step(together, [pressed(2.0 * depth_m), pressed(depth_m)])
        assert counted.reads == 1
        assert {name: getattr(together, name).data_ptr() for name in states} == memory
        one = step(alone, [pressed(depth_m)])
        np.testing.assert_allclose(both.skin_position_m[1], one.skin_position_m[0], atol=2e-6)
        np.testing.assert_allclose(both.force_n[1], one.force_n[0], rtol=0.01, atol=1e-4)


def test_friction_and_stiffness_are_those_of_each_gel(indenters):
    gel = BatchedGel(
        SENSOR,
        indenters[0],
        3,
        friction=np.array([0.0, 0.4, 0.4]),
        modulus_factor=np.array([1.0, 1.0, 2.5]),
    )
    step(gel, [pressed(1.0e-3)] * 3)
    slid = step(gel, [pressed(1.0e-3, 0.5e-3)] * 3)
    # The shape does not depend on Young's modulus, the forces are proportional to it; gels round
    # by their places in the batch, which leaves a force of a stiff contact in its fourth digit.
    np.testing.assert_allclose(slid.skin_position_m[2], slid.skin_position_m[1], atol=5e-7)
    np.testing.assert_allclose(slid.force_n[2], 2.5 * slid.force_n[1], rtol=5e-4)
    # Without friction the force points to the middle of the sphere that presses: through the
    # pose's origin plus the sphere's centre, so the moment about that centre vanishes.
    centre_m = pressed(1.0e-3, 0.5e-3).apply(np.array([0.0, 0.0, 4.0e-3]))
    about = slid.torque_nm.numpy() - np.cross(centre_m, slid.force_n.numpy())
    force_n = np.linalg.norm(slid.force_n.numpy(), axis=1)
    assert np.linalg.norm(about[0]) < 1e-3 * force_n[0] * 4e-3
    assert np.linalg.norm(about[1]) > 0.1 * force_n[1] * 4e-3


def test_a_pad_and_an_unrefined_gel_are_solved_too():
    pad = load_sensor("flat_pad")
    sphere = load_indenter("sphere_4mm")
    top_m = pad.gel.pad_size_m[2]
    for sensor in (pad, replace(pad, solver=replace(pad.solver, refined=False))):
        gel = BatchedGel(sensor, sphere, 2, effort=Effort(outer=10, newton=8))
        single = solved_closely(sensor, sphere)
        for depth_m in (0.3e-3, 0.6e-3):
            pose = Pose(np.array([1e-3, 0.0, top_m - depth_m]))
            found = step(gel, [pose] * 2)
            [right] = single.step([pose], 0.04)
            skin_m = found.skin_position_m[0].numpy() - right.skin_position_m
            assert np.linalg.norm(skin_m, axis=1).max() < 5e-6
            np.testing.assert_allclose(
                found.force_n[0].numpy()[2], right.wrench.force_n[2], rtol=0.005
            )


def test_the_fine_grid_is_one_of_half_the_spacing_without_refinement():
    pad = load_sensor("flat_pad")
    pad = replace(pad, gel=replace(pad.gel, pad_size_m=(0.012, 0.01, 0.004)))
    solver = replace(pad.solver, grid_spacing_m=0.5 * pad.solver.grid_spacing_m, refined=False)
    cone = load_indenter("cone")
    fine = BatchedGel(pad, cone, 1, grid="fine")
    single = solved_closely(replace(pad, solver=solver), cone)
    pose = Pose(np.array([1e-3, 0.0, pad.gel.pad_size_m[2] - 0.6e-3]))
    found, [right] = step(fine, [pose]), single.step([pose], 0.04)
    skin_m = found.skin_position_m[0].numpy() - right.skin_position_m
    assert np.linalg.norm(skin_m, axis=1).max() < 10e-6
    np.testing.assert_allclose(found.force_n[0].numpy()[2], right.wrench.force_n[2], rtol=0.01)


def test_a_thin_pad_is_followed_deep_and_aside():
    sensor = load_sensor("gelsight_mini")
    sensor = replace(sensor, solver=replace(sensor.solver, refined=False))
    sphere = load_indenter("sphere_4mm")
    gel, single = BatchedGel(sensor, sphere, 1), solved_closely(sensor, sphere)
    top_m = sensor.gel.pad_size_m[2]
    # To 37 % of the thickness, where the gel is several times as stiff as at rest.
    down = [(depth_m, 0.0) for depth_m in np.arange(0.25e-3, 1.51e-3, 0.25e-3)]
    for depth_m, aside_m in [*down, (1.5e-3, 0.25e-3), (1.5e-3, 0.5e-3)]:
        pose = Pose(np.array([0.3e-3, aside_m, top_m - depth_m]))
        found = step(gel, [pose])
        [right] = single.step([pose], 0.04)
        off_m = found.skin_position_m[0].numpy() - right.skin_position_m
        assert np.linalg.norm(off_m, axis=1).max() < 15e-6
        off_n = np.linalg.norm(found.force_n[0].numpy() - right.wrench.force_n)
        assert off_n < 0.01 * np.linalg.norm(right.wrench.force_n)


def test_a_gel_relaxes_as_the_implicit_gel_does():
    pad = load_sensor("flat_pad")
    material = replace(pad.material, prony_shares=(0.3, 0.2), prony_times_s=(0.1, 1.0))
    sensor = replace(pad, material=material)
    sphere = load_indenter("sphere_4mm")
    gel, single = BatchedGel(sensor, sphere, 2), solved_closely(sensor, sphere)
    top_m = pad.gel.pad_size_m[2]
    # Pressed, held, slid and released; the other gel is left at another time.
    ways = [(0.4, 0.0), (0.8, 0.0), *[(0.8, 0.0)] * 4, (0.8, 0.3), (-0.5, 0.3), (-0.5, 0.3)]
    loads_n = []
    for number, (depth_mm, aside_mm) in enumerate(ways):
        pose = Pose(np.array([1.0 + aside_mm, 0.0, 1e3 * top_m - depth_mm]) * 1e-3)
        other = pose if number < 3 else Pose(np.array([0.0, 0.0, 2.0 * top_m]))
        dt_s = 0.02 if number < 2 else 0.3
        found = gel.step(
            np.array([pose.position_m, other.position_m]),
            np.array([pose.quaternion_xyzw, other.quaternion_xyzw]),
            dt_s,
        )
        [right] = single.step([pose], dt_s)
        loads_n.append(right.wrench.force_n[2])
        np.testing.assert_allclose(found.force_n[0], right.wrench.force_n, atol=0.01 * max(loads_n))
        skin_m = found.skin_position_m[0].numpy() - right.skin_position_m
        assert np.linalg.norm(skin_m, axis=1).max() < 6e-6, number
    assert loads_n[5] < 0.75 * loads_n[1]
    # What is remembered after the release is what moves the skin then.
    left_m = np.abs(found.skin_position_m.numpy() - gel.rest_position_m).max(axis=(1, 2))
    assert left_m[0] > 10e-6
    assert 0.0 < left_m[1] < 0.5 * left_m[0]
    gel.reset(torch.tensor([True, False]))
    found = step(gel, [Pose(np.array([0.0, 0.0, 2.0 * top_m]))] * 2)
    moved_m = np.abs(found.skin_position_m.numpy() - gel.rest_position_m).max(axis=(1, 2))
    assert moved_m[0] == 0.0
    assert moved_m[1] > 0.0


def test_a_gel_that_has_come_off_its_core_is_that_of_the_implicit_gel(indenters):
    solver = replace(SENSOR.solver, grid_spacing_m=3.6e-3, refined=False)
    sound = replace(SENSOR, solver=solver)
    gel = replace(sound.gel, bond_slip_share=1.0, loose_patch_rad=(0.4, -0.2, 0.8))
    loose = replace(sound, gel=gel)
    gels = [BatchedGel(sensor, indenters[0], 1) for sensor in (loose, sound)]
    single = solved_closely(loose, indenters[0])
    for depth_m, aside_m in ((0.5e-3, 0.0), (1.5e-3, 0.0), (1.5e-3, 0.5e-3)):
        pose = pressed(depth_m, aside_m)
        found, bonded = (step(one, [pose]) for one in gels)
        [right] = single.step([pose], 0.04)
        skin_m = found.skin_position_m[0].numpy() - right.skin_position_m
        assert np.linalg.norm(skin_m, axis=1).max() < 15e-6
        newtons = np.linalg.norm(right.wrench.force_n)
        np.testing.assert_allclose(found.force_n[0], right.wrench.force_n, atol=0.005 * newtons)
    assert np.linalg.norm(bonded.force_n[0] - found.force_n[0]) > 0.012 * newtons


def test_the_compliance_at_rest_is_that_of_the_whole_stiffness_inverted():
    sensor = load_sensor("digit")
    body, law = body_of(sensor.gel), law_of(sensor.material)
    skin_m = skin_of(sensor.gel).rest_position_m
    grid = discretize(body, skin_m, sensor.solver.grid_spacing_m)
    whole = kept_compliance(body, skin_m, grid, law)
    rest = RestCompliance(grid, kept_blocks(body, skin_m, grid, law), "cpu")
    node = torch.as_tensor(np.random.default_rng(0).permutation(grid.node_count)[None, :40])
    unknown = (3 * node[0, :, None] + torch.arange(3)).view(-1).numpy()
    between = rest.between(node.to(torch.int32))[0, :, :40].numpy()
    right = whole[np.ix_(unknown, unknown)].reshape(40, 3, 40, 3).transpose(0, 2, 1, 3)
    np.testing.assert_allclose(between, right.reshape(40, 40, 9), atol=3e-5 * np.abs(right).max())
    force = torch.zeros(grid.node_count, 3, 1)
    force[node[0]] = 1.0
    moved = rest.apply(force)[:, :, 0].numpy()
    by_hand = (whole @ force.reshape(-1).numpy()).reshape(-1, 3)
    np.testing.assert_allclose(moved, by_hand, atol=3e-5 * np.abs(by_hand).max())


def test_what_a_batch_cannot_take_is_refused(indenters):
    with pytest.raises(ValueError, match=r"2 indenters for 3 gels"):
        BatchedGel(SENSOR, indenters[:2], 3)
    with pytest.raises(ValueError, match=r"friction has the shape \(2,\), expected \(3,\)"):
        BatchedGel(SENSOR, indenters[0], 3, friction=np.zeros(2))
    for name in ("friction", "modulus_factor"):
        with pytest.raises(ValueError, match=rf"{name} holds nan, expected finite numbers"):
            BatchedGel(SENSOR, indenters[0], 1, **{name: [np.nan]})
    slow = replace(SENSOR, solver=replace(SENSOR.solver, dynamic=True))
    with pytest.raises(ValueError, match="no inertia"):
        BatchedGel(slow, indenters[0], 1)
