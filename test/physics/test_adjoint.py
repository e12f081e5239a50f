# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The adjoint of the implicit gel against central finite differences, parameter by parameter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

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
    reference = body.reference if isinstance(body, ReshapedDome | ReshapedPad) else body
    if isinstance(body, Dome):
        lengths = {"outer_radius_m": body.outer_radius_m, "core_radius_m": body.core_radius_m}
        return ReshapedDome(**lengths | {name: value}, reference=reference)
    assert isinstance(body, Pad)
    size = list(body.size_m)
    size[("size_x_m", "size_y_m", "thickness_m").index(name)] = value
    return ReshapedPad((size[0], size[1], size[2]), reference)


def value_of(case: Case, name: str) -> float:
    if name.startswith("body."):
        lengths = {"outer_radius_m": RADIUS, "core_radius_m": CORE}
        lengths |= zip(("size_x_m", "size_y_m", "thickness_m"), PAD.size_m, strict=True)
        return lengths[name.removeprefix("body.")]
    value: Any = case
    for part in name.replace("indenter.", "indenter.parameters.").split("."):
        value = value[int(part)] if part.isdigit() else getattr(value, part)
    return float(value)


def derivative_of(gradient: Gradient, case: Case, name: str) -> float:
    owner, _, attribute = name.partition(".")
    match owner:
        case "law":
            return float(gradient.by_law(case.law)[attribute])
        case "body":
            return float(gradient.geometry[attribute])
        case "contact" if attribute == "stiffness":
            return float(gradient.contact_stiffness)
        case "contact":
            return float(getattr(gradient, attribute))
        case "prony":
            attribute, _, index = attribute.partition(".")
            return float(getattr(gradient, f"prony_{attribute}")[int(index)])
        case "indenter":
            return float(gradient.indenter_parameters[int(attribute)])
        case "twist" | "offset":
            return float(getattr(gradient, f"indenter_{owner}")[int(attribute)])
    return float(getattr(gradient, name))


def check(case: Case, steps: Mapping[str, float]) -> None:
    """Compare the derivatives by several parameters with one central difference.

    All move at once, each by its step at most, such that each changes the loss by the same amount
    in the same direction: one derivative that is wrong by a share makes the sum wrong by that share
    over their number.
    """
    gradient = adjoint(case)
    derivatives = {name: derivative_of(gradient, case, name) for name in steps}
    change = min(abs(derivatives[name]) * step for name, step in steps.items())
    assert change > 0.0
    ahead = behind = case
    for name, derivative in derivatives.items():
        value, step = value_of(case, name), change / derivative
        ahead = changed(ahead, name, value + step)
        behind = changed(behind, name, value - step)
    found = 0.5 * (loss(ahead) - loss(behind))
    assert found == pytest.approx(change * len(steps), rel=TOLERANCE / len(steps) ** 0.5)


SLIDING = Case()
STICKING = replace(
    SLIDING,
    contact=ContactSpecification(friction_coefficient=5.0),
    path=((0.0, 0.0, -0.0005), (0.0, 0.0, -0.0008), (2e-5, 0.0, -0.0008)),
)
SLIPPING = replace(SLIDING, contact=ContactSpecification(friction_coefficient=0.05))
TWIST = {f"twist.{index}": 1e-7 if index < 3 else 1e-5 for index in range(6)}
CASES: dict[str, tuple[Case, dict[str, float]]] = {
    "material, contact and lengths": (
        SLIDING,
        {
            "law.youngs_modulus_pa": 30.0,
            "law.poisson_ratio": 4.5e-5,
            "contact.friction_coefficient": 4e-5,
            "contact.stiffness": 1e-2,
            "contact.tangential_ratio": 2.5e-5,
            "indenter.0": 4e-8,
            "body.outer_radius_m": 1.6e-8,
            "body.core_radius_m": 6e-9,
        },
    ),
    "a common motion of all poses": (SLIDING, TWIST),
    # From a pose in the air: without one the way to the first pose in the gel comes along the
    # indenter's axis, and turns with it. A cone may turn about its own axis.
    "an offset in the indenter's frame": (
        replace(
            SLIDING,
            indenter=BLUNT_CONE,
            path=((0.0, 0.0005, 0.0005), *SLIDE),
            twist=(0.0, 0.0, 0.0, 0.04, -0.02, 0.03),
        ),
        {f"offset.{index}": 1e-8 if index < 3 else 1e-6 for index in range(5)},
    ),
    "a cone": (
        replace(SLIDING, indenter=BLUNT_CONE, path=PRESS),
        {"indenter.0": 1.2e-5, "indenter.2": 5e-9},
    ),
    "a pad": (
        replace(SLIDING, body=PAD, path=PRESS),
        {"body.size_x_m": 1.5e-8, "body.thickness_m": 1e-8},
    ),
    "yeoh": (
        replace(SLIDING, law=Yeoh(5.0e4, 8.0e3, 4.0e3, 1.0e6), path=PRESS),
        {
            "law.c10_pa": 50.0,
            "law.c20_pa": 8.0,
            "law.c30_pa": 40.0,
            "law.bulk_modulus_pa": 1e3,
        },
    ),
    "mooney-rivlin": (
        replace(SLIDING, law=MooneyRivlin(3.0e4, 2.0e4, 1.0e6), path=PRESS),
        {"law.c10_pa": 3.0, "law.c01_pa": 2.0},
    ),
    "sticking": (STICKING, {"contact.tangential_ratio": 1e-4, "twist.0": 1e-7}),
    "slipping": (SLIPPING, {"contact.friction_coefficient": 1e-5, "law.poisson_ratio": 1e-5}),
    "relaxation through a hold": (
        replace(SLIDING, prony=PronySeries((0.2, 0.15), (0.05, 0.5)), path=HOLD),
        {
            "prony.shares.0": 2e-5,
            "prony.shares.1": 1.5e-5,
            "prony.times_s.0": 5e-6,
            "prony.times_s.1": 5e-5,
            "law.poisson_ratio": 1e-5,
        },
    ),
    "dynamic steps": (
        replace(SLIDING, solver=replace(SLIDING.solver, dynamic=True), dt_s=0.004),
        {"density_kg_m3": 10.0, "law.youngs_modulus_pa": 30.0, "body.outer_radius_m": 1.6e-8},
    ),
    "a marker on the indenter's axis": (
        replace(SLIDING, path=((0.0, 0.0, -0.0006), (0.0, 0.0, -0.0009)), orientation=LEVEL),
        {"twist.0": 1e-7, "twist.1": 1e-7, "twist.3": 1e-5},
    ),
    "the indenter has left and come back": (
        replace(SLIDING, path=(*PRESS, (0.0, 0.0, 0.003), *PRESS)),
        {"contact.friction_coefficient": 4e-5, "body.outer_radius_m": 1e-8},
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_gradient(name: str) -> None:
    check(*CASES[name])


def test_what_plays_no_part_has_no_derivative() -> None:
    """A contact that sticks has no limit of friction, and a cone may turn about its own axis."""
    assert adjoint(STICKING).friction_coefficient == 0.0
    cone_case = CASES["an offset in the indenter's frame"][0]
    # Friction alone feels that turn, very little.
    assert abs(adjoint(cone_case).indenter_offset[5]) < 1.0


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


def test_the_tables_of_a_refined_contact_have_their_part_in_the_derivative_by_poissons_ratio(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DOTSIM_ROS_CACHE", str(tmp_path))
    case = replace(SLIDING, path=PRESS, solver=replace(SLIDING.solver, refined=True))
    # Tables in single precision leave a noise in the loss, so that the steps are long.
    check(case, {"indenter.0": 4e-6, "twist.2": 8e-7})
    gel, recorder, gradient = recorded(case)
    complete = trajectory_gradient(
        gel, recorder.trajectories[0], weights(case), by_poisson=poisson_rate(gel)
    )
    derivative = complete.by_law(case.law)["poisson_ratio"]
    # The tables are single precision: over half of this step their last digits are worth 0.2 %.
    expected = difference(case, "law.poisson_ratio", 0.45, 2.4e-3)
    assert derivative == pytest.approx(expected, rel=TOLERANCE)
    assert derivative != pytest.approx(gradient.by_law(case.law)["poisson_ratio"], rel=TOLERANCE)


SHIPPED = load_sensor("densetact2")


def test_gradient_at_the_settings_of_the_shipped_sensor_whose_contact_is_refined() -> None:
    assert SHIPPED.solver.refined
    material = material_of(SHIPPED.material)
    assert isinstance(material.law, NeoHookean)
    case = Case(
        law=material.law,
        contact=SHIPPED.contact,
        indenter=load_indenter("box_edge"),
        solver=SHIPPED.solver,
        dome_skin_spacing_m=SHIPPED.gel.skin_spacing_m,
    )
    check(
        case,
        {
            "law.youngs_modulus_pa": 3.0e2,
            "contact.friction_coefficient": 1.0e-3,
            "contact.stiffness": 1.0,
            "contact.tangential_ratio": 3.0e-3,
        }
        | {f"twist.{index}": 5.0e-7 if index < 3 else 3.0e-5 for index in range(6)},
    )


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
