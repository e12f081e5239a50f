# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The contact of a few markers on a linear gel, and the indenter's answers that it is made of."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from dotsim_ros.gel.implicit.contact import Contact, ContactHistory, Lag, fresh_history
from dotsim_ros.gel.implicit.contact_problem import (
    Answers,
    ContactSolution,
    Guess,
    by_component,
    by_marker,
    compliance_root,
    linear_contact,
    solve_contact,
)
from dotsim_ros.geometry.indenter import Indenter, box_edge, sphere, torus
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.specification import ContactSpecification

Array = NDArray[np.float64]
RADIUS_M = 4.0e-3
AREA_M2 = 0.2e-6
YOUNGS_PA = 3.0e5
TOLERANCE_M = 1.0e-7
NEGLIGIBLE_M_N = 1.0e-9


def contact_of(
    friction: float, count: int, *, indenter: Indenter | None = None, tangential_ratio: float = 0.5
) -> Contact:
    return Contact(
        sphere(RADIUS_M) if indenter is None else indenter,
        np.full(count, AREA_M2),
        YOUNGS_PA,
        ContactSpecification(friction_coefficient=friction, tangential_ratio=tangential_ratio),
    )


def flat_markers(count: int = 5, spacing_m: float = 0.5e-3) -> Array:
    """Return (count^2, 3) markers on the plane z = 0."""
    line = spacing_m * (np.arange(count) - 0.5 * (count - 1))
    x, y = np.meshgrid(line, line)
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)


def half_space_compliance(position_m: Array) -> NDArray[np.float32]:
    """Return (3 A, 3 A) by component, falling with the distance as that of a soft half space."""
    gap = np.linalg.norm(position_m[:, None] - position_m[None], axis=2)
    scalar = 1.0 / (np.pi * YOUNGS_PA * np.sqrt(gap**2 + (0.4e-3) ** 2))
    return np.kron(np.diag([1.3, 1.3, 1.0]), scalar).astype(np.float32)


def solved(
    contact: Contact,
    markers: Array,
    pose: Pose,
    history: ContactHistory,
    passes: int = 5,
    tolerance_m: float = TOLERANCE_M,
) -> tuple[ContactSolution, NDArray[np.float32]]:
    number = np.arange(len(markers), dtype=np.int32)
    compliance = half_space_compliance(markers)
    none = np.zeros_like(markers)
    solution = solve_contact(
        compliance_root(compliance, NEGLIGIBLE_M_N),
        markers,
        none,
        Answers(
            lambda x, lag: contact.respond(number, x, pose, history, lag),
            lambda x: contact.respond_now(number, x, pose, history),
        ),
        guess=Guess(markers, none),
        passes=passes,
        tolerance_m=tolerance_m,
    )
    return solution, compliance


def pressed(depth_m: float, shift_m: float = 0.0) -> Pose:
    return Pose(np.array([shift_m, 0.0, -depth_m]))


def test_root_of_a_compliance_has_few_columns_and_leaves_little_out() -> None:
    # Markers closer together than what moves them can bend.
    markers = flat_markers(11, 0.2e-3)
    gap = np.linalg.norm(markers[:, None] - markers[None], axis=2)
    smooth = 2.0e-3 * np.exp(-0.5 * (gap / 0.5e-3) ** 2)
    compliance = np.kron(np.diag([1.3, 1.3, 1.0]), smooth).astype(np.float32)
    negligible = 1e-2 * float(compliance.diagonal().max())
    root = compliance_root(compliance, negligible)
    assert root.shape[:2] == (len(markers), 3)
    assert root.shape[2] < 0.4 * len(compliance)
    by_rows = root.transpose(1, 0, 2).reshape(len(compliance), -1)
    left = compliance - by_rows @ by_rows.T
    assert 0.0 < left.diagonal().max() <= negligible
    # Of a positive matrix no entry is larger than the diagonal.
    assert np.abs(left).max() <= 1.01 * negligible


def test_a_compliance_that_is_indefinite_by_a_hair_has_a_root() -> None:
    compliance = half_space_compliance(flat_markers())
    value, vector = np.linalg.eigh(compliance.astype(np.float64))
    value[0] = -1e-6 * value[-1]
    indefinite = (vector * value @ vector.T).astype(np.float32)
    root = compliance_root(indefinite, 1e-5 * float(value[-1]))
    by_rows = root.transpose(1, 0, 2).reshape(len(compliance), -1)
    assert np.abs(indefinite - by_rows @ by_rows.T).max() < 1e-4 * value[-1]


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("depth_m", [0.02e-3, 0.6e-3])
def test_forces_are_those_that_the_indenter_answers_with(friction: float, depth_m: float) -> None:
    markers = flat_markers()
    contact = contact_of(friction, len(markers))
    history = fresh_history(markers, pressed(-1.0e-6))
    pose = pressed(depth_m, 0.3e-3)
    solution, compliance = solved(contact, markers, pose, history)
    position = markers + by_marker(compliance @ by_component(solution.force_n))
    number = np.arange(len(markers), dtype=np.int32)
    expected = contact.respond_now(number, position, pose, history).force_n
    assert solution.is_solved
    assert np.abs(solution.force_n).max() > 0.0
    moved = compliance @ by_component(solution.force_n - expected)
    assert np.abs(moved).max() < 1.5 * TOLERANCE_M


def test_what_cannot_be_solved_says_so_and_is_close() -> None:
    markers = flat_markers()
    contact = contact_of(0.4, len(markers))
    history = fresh_history(markers, pressed(-1.0e-6))
    pose = pressed(0.2e-3, 0.3e-3)
    known, _ = solved(contact, markers, pose, history)
    # Single precision cannot tell so little apart.
    rough, _ = solved(contact, markers, pose, history, tolerance_m=1.0e-15)
    assert not rough.is_solved
    assert np.abs(rough.force_n - known.force_n).max() < 1e-3 * np.abs(known.force_n).max()


def test_one_marker_takes_the_force_of_two_springs_in_series() -> None:
    marker = np.zeros((1, 3))
    contact = contact_of(0.0, 1)
    depth = 0.3e-3
    solution, compliance = solved(
        contact, marker, pressed(depth), fresh_history(marker, pressed(0.0))
    )
    law = contact.law
    stiffness = law.stiffness * AREA_M2
    # The linear law begins half the smoothing after the onset.
    expected = (depth + law.onset - 0.5 * law.smoothing) / (1.0 / stiffness + compliance[2, 2])
    assert solution.force_n[0] == pytest.approx([0.0, 0.0, -expected], rel=1e-4)


def test_friction_stays_within_coulombs_limit_and_reaches_it() -> None:
    markers = flat_markers()
    contact = contact_of(0.3, len(markers))
    rest = fresh_history(markers, pressed(0.0))
    first, _ = solved(contact, markers, pressed(0.3e-3), rest)
    history = ContactHistory(
        first.response.local_position_m,
        first.response.slip_m,
        first.response.pressure_pa,
        first.response.distance_m,
    )
    slid, _ = solved(contact, markers, pressed(0.3e-3, 1.0e-3), history)
    normal = np.einsum("ai,ai->a", slid.force_n, slid.response.normal)
    along = np.linalg.norm(slid.force_n - normal[:, None] * slid.response.normal, axis=1)
    assert np.all(along <= 0.3 * np.abs(normal) * (1.0 + 1e-3) + 1e-9)
    held = normal > 0.05 * normal.max()
    assert along[held] == pytest.approx(0.3 * normal[held], rel=1e-3)
    # Dragged along with the indenter, and by nothing but friction.
    assert slid.force_n[:, 0].sum() > 0.25 * np.abs(slid.force_n[:, 2]).sum()


def test_markers_that_do_not_touch_take_no_force() -> None:
    markers = flat_markers(9)
    contact = contact_of(0.4, len(markers))
    solution, _ = solved(contact, markers, pressed(0.1e-3), fresh_history(markers, pressed(0.0)))
    touching = solution.response.pressure_pa > 0.0
    assert 0 < touching.sum() < len(markers)
    assert np.abs(solution.force_n[~touching]).max() < 1e-6 * np.abs(solution.force_n).max()


def test_normal_of_a_lag_counts_by_its_direction_alone() -> None:
    # A mesh's distance, interpolated on a grid, has a gradient that is not of unit length.
    markers = flat_markers(12, 0.35e-3)
    contact = contact_of(0.3, len(markers))
    pose = Pose(np.array([0.0, 0.0, -0.1e-3]))
    number = np.arange(len(markers), dtype=np.int32)
    history = fresh_history(markers + np.array([2.0e-6, 0.0, 1.0e-6]), pose)
    first = contact.respond_now(number, markers, pose, history)
    expected, longer = (
        contact.respond(number, markers, pose, history, Lag(first.pressure_pa, normal))
        for normal in (first.normal, 1.05 * first.normal)
    )
    assert np.count_nonzero(expected.pressure_pa) > 0
    assert longer.force_n == pytest.approx(expected.force_n, rel=1e-9, abs=1e-15)
    smallest = np.linalg.eigvalsh(longer.stiffness)[:, 0]
    assert np.all(smallest >= -1e-9 * np.abs(longer.stiffness).max())


@pytest.mark.parametrize(
    "indenter",
    [sphere(RADIUS_M), torus(3.0e-3, 1.0e-3), box_edge((12e-3, 8e-3, 8e-3), 0.5e-3)],
    ids=["sphere", "torus", "box_edge"],
)
@pytest.mark.parametrize("slip_m", [2.0e-6, 60.0e-6], ids=["sticks", "slips"])
def test_stiffness_is_the_derivative_of_the_forces(indenter: Indenter, slip_m: float) -> None:
    random = np.random.default_rng(5)
    markers = flat_markers(12, 0.35e-3)
    contact = contact_of(0.3, len(markers), indenter=indenter)
    pose = Pose(np.array([0.0, 0.0, -0.1e-3]))
    number = np.arange(len(markers), dtype=np.int32)
    history = fresh_history(markers + slip_m * random.normal(size=markers.shape), pose)
    response = contact.respond_now(number, markers, pose, history)
    # Beyond the smooth onset, so that a difference does not straddle it.
    checked = np.flatnonzero(response.distance_m < contact.law.onset - 2.0 * contact.law.smoothing)
    assert len(checked) > 0
    step = 1.0e-9
    for axis in range(3):
        moved = np.zeros(3)
        moved[axis] = step
        ahead = contact.respond_now(number, markers + moved, pose, history).force_n
        behind = contact.respond_now(number, markers - moved, pose, history).force_n
        expected = -(ahead - behind)[checked] / (2.0 * step)
        size = np.abs(response.stiffness[checked]).max(axis=(1, 2))[:, None]
        assert np.abs(response.stiffness[checked][:, :, axis] - expected).max() < (
            1e-4 * size.max()
        )


def test_linear_contact_is_one_step_of_newtons_method() -> None:
    markers = flat_markers()
    contact = contact_of(0.0, len(markers))
    pose = pressed(0.1e-3)
    number = np.arange(len(markers), dtype=np.int32)
    history = fresh_history(markers, pose)
    none = np.zeros_like(markers)
    response = contact.respond(number, markers, pose, history, Lag(np.zeros(len(markers)), none))
    compliance = half_space_compliance(markers).astype(np.float64)
    force = linear_contact(compliance, none, none, response)
    # (1 + C H) d = C F, and F - H d is what the linear contact answers with.
    stiffness = np.zeros((3, len(markers), 3, len(markers)))
    for a in range(len(markers)):
        stiffness[:, a, :, a] = response.stiffness[a]
    matrix = stiffness.reshape(3 * len(markers), -1)
    first = by_component(response.force_n)
    moved = np.linalg.solve(np.eye(len(first)) + compliance @ matrix, compliance @ first)
    assert by_component(force) == pytest.approx(first - matrix @ moved, rel=1e-3, abs=1e-6)


def test_a_gel_that_has_diverged_has_no_root() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="has diverged"):
        compliance_root(np.full((6, 6), np.nan, dtype=np.float32), NEGLIGIBLE_M_N)
