# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The adjoint of the implicit gel against central finite differences, parameter by parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from dotsim_ros.gel.adjoint.backward import trajectory_gradient
from dotsim_ros.gel.adjoint.differentiable_contact import MarkerContact
from dotsim_ros.gel.adjoint.gradient import Gradient, LossGradient
from dotsim_ros.gel.adjoint.recorder import Recorder
from dotsim_ros.gel.adjoint.refinement_rate import poisson_rate
from dotsim_ros.gel.body import Body, Dome, Pad
from dotsim_ros.gel.discretization import discretize
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.make import material_of
from dotsim_ros.gel.material import (
    ElasticLaw,
    Material,
    MooneyRivlin,
    NeoHookean,
    PronySeries,
    Yeoh,
)
from dotsim_ros.gel.reshape import ReshapedDome, ReshapedPad
from dotsim_ros.geometry.indenter import Indenter, IndenterKind, cone, load_indenter, sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin, flat_pad_skin
from dotsim_ros.specification import ContactSpecification, SolverSpecification, load_sensor

Array = NDArray[np.float64]

TOLERANCE = 1.0e-3
RADIUS, CORE = 0.01575, 0.006
dome_skin_of = cache(dome_skin)
DOME_SKIN = dome_skin_of(RADIUS, 0.8e-3)
PAD = Pad((0.0150, 0.0150, 0.0104))
PAD_SKIN = flat_pad_skin((0.0150, 0.0150), 0.0104, 0.8e-3)
PRESS = ((0.0, 0.0005, -0.0005), (0.0001, 0.0005, -0.0008))
SLIDE = (*PRESS, (0.0005, 0.0004, -0.0009))
HOLD = (*PRESS, PRESS[1])
NEO_HOOKEAN = NeoHookean(3.0e5, 0.45)
ELASTIC = PronySeries()
CONTACT = ContactSpecification()
SPHERE = sphere(0.004)
BLUNT_CONE = cone(1.2, 0.004, 0.0005)
DOME = Dome(RADIUS, CORE)
COARSE = SolverSpecification(grid_spacing_m=4.8e-3, refined=False, iterations=40)
LEVEL = (0.0, 0.0, 0.0, 1.0)
TILTED = (0.02, -0.01, 0.0, float(np.sqrt(1.0 - 0.0005)))


@dataclass(frozen=True)
class Case:
    """A gel, an indenter's path (of its tip, from the apex, m), and motions that all its poses have
    in common: `twist` along the axes of the base, `offset` along the indenter's."""

    law: ElasticLaw = NEO_HOOKEAN
    prony: PronySeries = ELASTIC
    density_kg_m3: float = 1070.0
    contact: ContactSpecification = CONTACT
    indenter: Indenter = SPHERE
    body: Body = DOME
    path: tuple[tuple[float, float, float], ...] = SLIDE
    orientation: tuple[float, float, float, float] = TILTED
    twist: tuple[float, ...] = (0.0,) * 6
    offset: tuple[float, ...] = (0.0,) * 6
    solver: SolverSpecification = COARSE
    dome_skin_spacing_m: float = 0.8e-3
    dt_s: float = 0.04

    def skin(self) -> SkinMesh:
        if isinstance(self.body, Dome):
            ratio = self.body.outer_radius_m / RADIUS
            mesh = dome_skin_of(RADIUS, self.dome_skin_spacing_m)
            return replace(
                mesh,
                rest_position_m=mesh.rest_position_m * ratio,
                rest_area_m2=mesh.rest_area_m2 * ratio**2,
            )
        assert isinstance(self.body, Pad)
        x, y, z = np.divide(self.body.size_m, PAD.size_m)
        return replace(
            PAD_SKIN,
            rest_position_m=PAD_SKIN.rest_position_m * [x, y, z],
            rest_area_m2=PAD_SKIN.rest_area_m2 * x * y,
        )

    def gel(self) -> ImplicitGel:
        gel = ImplicitGel(
            self.body,
            self.skin(),
            Material(self.law, self.prony, self.density_kg_m3),
            contact=self.contact,
            solver=self.solver,
            indenter=self.indenter,
        )
        if gel.refinement is not None:
            # In single precision it scatters differences by more than the tolerance.
            double = gel.refinement.block.astype(np.float64)
            gel.refinement = replace(gel.refinement, block=double)
        return gel

    def poses(self) -> list[Pose]:
        apex = RADIUS if isinstance(self.body, Dome) else PAD.size_m[2]
        at_tip = [Pose(np.array([x, y, apex + z]), self.orientation) for x, y, z in self.path]
        turn, own_turn = small_motion(self.twist), small_motion(self.offset)
        return [product(product(turn, pose), own_turn) for pose in at_tip]


def product(first: Pose, second: Pose) -> Pose:
    """Return the pose in the first's parent of a child of the second."""
    a, b = first.quaternion_xyzw, second.quaternion_xyzw
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return Pose(first.apply(second.position_m), [*vector, a[3] * b[3] - a[:3] @ b[:3]])


def small_motion(twist: Sequence[float]) -> Pose:
    return Pose(np.array(twist[:3]), [*(0.5 * np.array(twist[3:])), 1.0])


def weights(case: Case) -> list[LossGradient]:
    """Return a loss that is linear in all that the steps return, with random weights."""
    random = np.random.default_rng(3)
    count = case.skin().vertex_count
    return [
        LossGradient(
            random.normal(size=(count, 3)) * 100.0,
            random.normal(size=3),
            random.normal(size=3) * 100.0,
        )
        for _ in case.path
    ]


def loss(case: Case) -> float:
    recorder, total = Recorder(case.gel()), 0.0
    for pose, weight in zip(case.poses(), weights(case), strict=True):
        state = recorder.step([pose], case.dt_s)[0]
        assert weight.skin is not None
        total += float(np.vdot(weight.skin, state.skin_position_m))
        total += float(weight.force @ state.wrench.force_n + weight.torque @ state.wrench.torque_nm)
    return total


@cache
def recorded(case: Case) -> tuple[ImplicitGel, Recorder, Gradient]:
    gel = case.gel()
    recorder = Recorder(gel)
    for pose in case.poses():
        recorder.step([pose], case.dt_s)
    return gel, recorder, trajectory_gradient(gel, recorder.trajectories[0], weights(case))


def adjoint(case: Case) -> Gradient:
    return recorded(case)[2]


def difference(case: Case, name: str, value: float, step: float) -> float:
    """Return the central difference of the loss by a field or a nested field of the case."""
    return (loss(changed(case, name, value + step)) - loss(changed(case, name, value - step))) / (
        2.0 * step
    )


def changed(case: Case, name: str, value: float) -> Case:
    owner, _, attribute = name.partition(".")
    if attribute.isdigit():
        if owner == "indenter":
            parameters = list(case.indenter.parameters)
            parameters[int(attribute)] = value
            kind = IndenterKind(case.indenter.kind)
            return replace(case, indenter=Indenter(kind, tuple(parameters)))
        values = list(getattr(case, owner))
        values[int(attribute)] = value
        return replace(case, **{owner: tuple(values)})
    if owner == "prony":
        attribute, _, number = attribute.partition(".")
        values = list(getattr(case.prony, attribute))
        values[int(number)] = value
        return replace(case, prony=replace(case.prony, **{attribute: tuple(values)}))
    if owner == "body":
        return replace(case, body=reshaped(case.body, attribute, value))
    if attribute:
        return replace(case, **{owner: replace(getattr(case, owner), **{attribute: value})})
    return replace(case, **{owner: value})


def reshaped(body: Body, name: str, value: float) -> Body:
    if isinstance(body, Dome):
        lengths = {"outer_radius_m": RADIUS, "core_radius_m": CORE} | {name: value}
        return ReshapedDome(**lengths, reference=body)
    assert isinstance(body, Pad)
    size = list(body.size_m)
    size[("size_x_m", "size_y_m", "thickness_m").index(name)] = value
    return ReshapedPad((size[0], size[1], size[2]), body)


def check(case: Case, name: str, value: float, step: float, derivative: float) -> None:
    expected = difference(case, name, value, step)
    assert abs(expected) > 0.0
    assert derivative == pytest.approx(expected, rel=TOLERANCE)


SLIDING = Case()


@pytest.mark.parametrize("name", ["youngs_modulus_pa", "poisson_ratio"])
def test_gradient_by_the_neo_hookean_law(name: str) -> None:
    value = getattr(SLIDING.law, name)
    derivative = adjoint(SLIDING).by_law(SLIDING.law)[name]
    check(SLIDING, f"law.{name}", value, 1e-4 * value, derivative)


@pytest.mark.parametrize(
    ("name", "field_name"),
    [
        ("friction_coefficient", "friction_coefficient"),
        ("stiffness", "contact_stiffness"),
        ("tangential_ratio", "tangential_ratio"),
    ],
)
def test_gradient_by_the_contact_law(name: str, field_name: str) -> None:
    value = getattr(SLIDING.contact, name)
    derivative = getattr(adjoint(SLIDING), field_name)
    check(SLIDING, f"contact.{name}", value, 1e-4 * value, derivative)


def test_gradient_by_the_radius_of_a_sphere() -> None:
    check(SLIDING, "indenter.0", 0.004, 4e-8, float(adjoint(SLIDING).indenter_parameters[0]))


@pytest.mark.parametrize("index", range(6))
def test_gradient_by_a_common_motion_of_all_poses(index: int) -> None:
    step = 1e-7 if index < 3 else 1e-5
    check(SLIDING, f"twist.{index}", 0.0, step, float(adjoint(SLIDING).indenter_twist[index]))


@pytest.mark.parametrize("index", range(6))
def test_gradient_by_an_offset_in_the_indenters_frame(index: int) -> None:
    # From a pose in the air: without one the way to the first pose in the gel comes along the
    # indenter's axis, and turns with it.
    path = ((0.0, 0.0005, 0.0005), *SLIDING.path)
    twist = (0.0, 0.0, 0.0, 0.04, -0.02, 0.03)
    case = replace(SLIDING, indenter=BLUNT_CONE, path=path, twist=twist)
    step = 1e-8 if index < 3 else 1e-6
    derivative = float(adjoint(case).indenter_offset[index])
    if index == 5:
        # A body of revolution may turn about its axis; friction alone feels it, very little.
        assert abs(derivative) < 1.0
    else:
        check(case, f"offset.{index}", 0.0, step, derivative)


@pytest.mark.parametrize("index", [0, 2])
def test_gradient_by_the_parameters_of_a_cone(index: int) -> None:
    case = replace(SLIDING, indenter=BLUNT_CONE, path=PRESS)
    value = case.indenter.parameters[index]
    derivative = float(adjoint(case).indenter_parameters[index])
    check(case, f"indenter.{index}", value, 1e-5 * value, derivative)


@pytest.mark.parametrize(("name", "value"), [("outer_radius_m", RADIUS), ("core_radius_m", CORE)])
def test_gradient_by_the_domes_radii(name: str, value: float) -> None:
    check(SLIDING, f"body.{name}", value, 1e-6 * value, adjoint(SLIDING).geometry[name])


@pytest.mark.parametrize("name", ["size_x_m", "thickness_m"])
def test_gradient_by_the_pads_lengths(name: str) -> None:
    case = replace(SLIDING, body=PAD, path=PRESS)
    value = PAD.size_m[0 if name == "size_x_m" else 2]
    check(case, f"body.{name}", value, 1e-6 * value, adjoint(case).geometry[name])


@pytest.mark.parametrize("name", ["c10_pa", "c20_pa", "c30_pa", "bulk_modulus_pa"])
def test_gradient_by_yeohs_constants(name: str) -> None:
    law = Yeoh(5.0e4, 8.0e3, 4.0e3, 1.0e6)
    case = replace(SLIDING, law=law, path=PRESS)
    value = getattr(law, name)
    step = (1e-2 if name == "c30_pa" else 1e-3) * value
    check(case, f"law.{name}", value, step, adjoint(case).by_law(law)[name])


def test_gradient_by_the_second_invariants_constant() -> None:
    law = MooneyRivlin(3.0e4, 2.0e4, 1.0e6)
    case = replace(SLIDING, law=law, path=PRESS)
    check(case, "law.c01_pa", law.c01_pa, 1e-4 * law.c01_pa, adjoint(case).by_law(law)["c01_pa"])


STICKING = replace(SLIDING, contact=ContactSpecification(friction_coefficient=5.0))
SLIPPING = replace(SLIDING, contact=ContactSpecification(friction_coefficient=0.05))


def test_a_sticking_contact_does_not_depend_on_the_coefficient() -> None:
    case = replace(STICKING, path=((0.0, 0.0, -0.0005), (0.0, 0.0, -0.0008), (2e-5, 0.0, -0.0008)))
    gradient = adjoint(case)
    assert gradient.friction_coefficient == 0.0
    check(case, "contact.tangential_ratio", 0.25, 1e-4, gradient.tangential_ratio)
    check(case, "twist.0", 0.0, 1e-7, float(gradient.indenter_twist[0]))


def test_a_slipping_contact_depends_on_the_coefficient() -> None:
    check(
        SLIPPING,
        "contact.friction_coefficient",
        0.05,
        1e-5,
        adjoint(SLIPPING).friction_coefficient,
    )
    check(
        SLIPPING,
        "law.poisson_ratio",
        0.45,
        1e-5,
        adjoint(SLIPPING).by_law(SLIPPING.law)["poisson_ratio"],
    )


def test_slipping_markers_are_at_coulombs_limit_of_the_present_pressure() -> None:
    gel, recorder, _ = recorded(SLIPPING)
    substep = recorder.trajectories[0].substeps[-1]
    record = substep.contact
    assert record is not None
    contact = MarkerContact(
        gel.contact,
        gel.skin.rest_area_m2[record.marker],
        substep.skin_position_m[record.marker],
        record.pose,
        record.memory_m,
    )
    normal_n = contact.pressure_pa * gel.skin.rest_area_m2[record.marker]
    size = np.linalg.norm(contact.force_n, axis=1)
    tangential_n = np.sqrt(np.maximum(size**2 - normal_n**2, 0.0))
    assert len(normal_n) >= 5
    assert np.max(tangential_n / normal_n) == pytest.approx(0.05, rel=1e-9)
    assert np.all(tangential_n <= 0.05 * normal_n * (1.0 + 1e-9))


RELAXING = replace(SLIDING, prony=PronySeries((0.2, 0.15), (0.05, 0.5)), path=HOLD)


@pytest.mark.parametrize("index", [0, 1])
def test_gradient_by_the_prony_series_through_a_hold(index: int) -> None:
    gradient, prony = adjoint(RELAXING), RELAXING.prony
    for name, derivative in (
        ("shares", gradient.prony_shares),
        ("times_s", gradient.prony_times_s),
    ):
        value = getattr(prony, name)[index]
        check(RELAXING, f"prony.{name}.{index}", value, 1e-4 * value, float(derivative[index]))


def test_gradient_by_poissons_ratio_through_relaxation() -> None:
    derivative = adjoint(RELAXING).by_law(RELAXING.law)["poisson_ratio"]
    check(RELAXING, "law.poisson_ratio", 0.45, 1e-5, derivative)


DYNAMIC = replace(SLIDING, solver=replace(SLIDING.solver, dynamic=True), dt_s=0.004)


@pytest.mark.parametrize("name", ["density_kg_m3", "law.youngs_modulus_pa", "body.outer_radius_m"])
def test_gradient_through_dynamic_steps(name: str) -> None:
    gradient = adjoint(DYNAMIC)
    value, derivative, share = {
        "density_kg_m3": (1070.0, gradient.density_kg_m3, 1e-2),
        "law.youngs_modulus_pa": (3e5, gradient.by_law(DYNAMIC.law)["youngs_modulus_pa"], 1e-4),
        "body.outer_radius_m": (RADIUS, gradient.geometry["outer_radius_m"], 1e-6),
    }[name]
    check(DYNAMIC, name, value, share * value, derivative)


@pytest.mark.parametrize("index", [0, 1, 3])
def test_gradient_with_a_marker_on_the_indenters_axis(index: int) -> None:
    case = replace(SLIDING, path=((0.0, 0.0, -0.0006), (0.0, 0.0, -0.0009)), orientation=LEVEL)
    step = 1e-7 if index < 3 else 1e-5
    check(case, f"twist.{index}", 0.0, step, float(adjoint(case).indenter_twist[index]))


def test_gradient_after_the_indenter_has_left_and_come_back() -> None:
    away = (0.0, 0.0, 0.003)
    case = replace(SLIDING, path=(*SLIDE, away, *PRESS))
    check(case, "contact.friction_coefficient", 0.4, 4e-5, adjoint(case).friction_coefficient)
    check(case, "body.outer_radius_m", RADIUS, 1e-8, adjoint(case).geometry["outer_radius_m"])


def test_gradient_with_a_refined_contact(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DOTSIM_ROS_CACHE", str(tmp_path_factory.mktemp("cache")))
    case = replace(SLIDING, solver=replace(SLIDING.solver, refined=True))
    gradient = adjoint(case)
    check(case, "law.youngs_modulus_pa", 3e5, 3e3, gradient.by_law(case.law)["youngs_modulus_pa"])
    check(case, "contact.friction_coefficient", 0.4, 2e-3, gradient.friction_coefficient)
    check(case, "indenter.0", 0.004, 1e-6, float(gradient.indenter_parameters[0]))
    check(case, "twist.2", 0.0, 2e-7, float(gradient.indenter_twist[2]))
    gel, recorder, _ = recorded(case)
    complete = trajectory_gradient(
        gel, recorder.trajectories[0], weights(case), by_poisson=poisson_rate(gel)
    )
    derivative = complete.by_law(case.law)["poisson_ratio"]
    # The tables are single precision: over half of this step their last digits are worth 0.2 %.
    check(case, "law.poisson_ratio", 0.45, 2.4e-3, derivative)
    assert derivative != pytest.approx(gradient.by_law(case.law)["poisson_ratio"], rel=TOLERANCE)


SHIPPED = load_sensor("densetact2")


@pytest.mark.parametrize("indenter", ["sphere_4mm", "box_edge", "cone"])
def test_gradient_at_the_settings_of_the_shipped_sensor(indenter: str) -> None:
    """All parameters move at once, each by about its share of the loss: one pair of solutions."""
    material, contact = material_of(SHIPPED.material), SHIPPED.contact
    assert isinstance(material.law, NeoHookean)
    case = Case(
        law=material.law,
        contact=contact,
        indenter=load_indenter(indenter),
        path=SLIDE,
        solver=SHIPPED.solver,
        dome_skin_spacing_m=SHIPPED.gel.skin_spacing_m,
    )
    gradient = adjoint(case)
    by_law = gradient.by_law(case.law)
    steps = {
        "law.youngs_modulus_pa": (3.0e2, by_law["youngs_modulus_pa"]),
        "contact.friction_coefficient": (1.0e-3, gradient.friction_coefficient),
        "contact.stiffness": (1.0, gradient.contact_stiffness),
        "contact.tangential_ratio": (3.0e-3, gradient.tangential_ratio),
    }
    for index, value in enumerate(gradient.indenter_twist):
        steps[f"twist.{index}"] = (5.0e-7 if index < 3 else 3.0e-5, float(value))
    moved = {1.0: case, -1.0: case}
    expected = 0.0
    for name, (step, derivative) in steps.items():
        expected += abs(step * derivative)
        for sign, there in moved.items():
            owner, attribute = name.split(".")
            value = getattr(case, owner)
            base = value[int(attribute)] if attribute.isdigit() else getattr(value, attribute)
            signed = sign * step * np.sign(derivative)
            moved[sign] = changed(there, name, base + signed)
    found = 0.5 * (loss(moved[1.0]) - loss(moved[-1.0]))
    assert found == pytest.approx(expected, rel=TOLERANCE)


def test_twists_of_the_substeps_add_up() -> None:
    gradient, recorder = adjoint(SLIDING), recorded(SLIDING)[1]
    assert gradient.substep_twist.shape == (len(recorder.trajectories[0].substeps), 6)
    np.testing.assert_allclose(gradient.substep_twist.sum(axis=0), gradient.indenter_twist)


def test_a_reshaped_body_is_its_reference_moved() -> None:
    same = discretize(ReshapedDome(RADIUS, CORE, DOME), DOME_SKIN.rest_position_m, 4.8e-3)
    plain = discretize(DOME, DOME_SKIN.rest_position_m, 4.8e-3)
    np.testing.assert_allclose(same.particle_position_m, plain.particle_position_m, atol=1e-15)
    thicker = ReshapedDome(1.1 * RADIUS, 1.2 * CORE, DOME)
    moved_skin = DOME_SKIN.rest_position_m * 1.1
    np.testing.assert_allclose(
        thicker.from_reference(DOME_SKIN.rest_position_m)[0], moved_skin, atol=1e-15
    )
    volume = discretize(thicker, moved_skin, 2.4e-3).particle_volume_m3.sum()
    expected = 2.0 / 3.0 * np.pi * ((1.1 * RADIUS) ** 3 - (1.2 * CORE) ** 3)
    assert volume == pytest.approx(expected, rel=2e-3)


def test_what_does_not_fit_is_refused() -> None:
    gel, recorder, _ = recorded(SLIDING)
    with pytest.raises(ValueError, match="2 loss gradients for 3 recorded steps"):
        trajectory_gradient(gel, recorder.trajectories[0], [None, None])
    wrong = LossGradient(np.zeros((3, 3)))
    with pytest.raises(ValueError, match=r"step 0: skin has shape \(3, 3\)"):
        trajectory_gradient(gel, recorder.trajectories[0], [wrong, None, None])
    with pytest.raises(ValueError, match="both zero or both positive"):
        ReshapedDome(RADIUS, 0.0, DOME)
