# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The mechanical effects: nothing at `none`, a closed form elsewhere, and no memory across runs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim
from scipy.spatial.transform import Rotation

from dotsim_ros.data.presses import Press
from dotsim_ros.data.recording import Recording, phases_of
from dotsim_ros.effects.builtin.friction_and_contact import ClingingContact
from dotsim_ros.effects.builtin.time import contact_radius_m
from dotsim_ros.effects.effect import (
    Active,
    GelTerm,
    Response,
    gel_with,
    motion_filters,
    response_filters,
)
from dotsim_ros.effects.library import load_effects
from dotsim_ros.gel.values import GelValues
from dotsim_ros.geometry.indenter import cone, flat_punch, sphere
from dotsim_ros.geometry.pose import Pose

APEX_M = 15.75e-3
LIBRARY = load_effects()
MECHANICAL = sorted(name for name, effect in LIBRARY.items() if effect.image is None)
VALUES = GelValues(c20_ratio=0.1)


def recording_of(
    depth_mm: list[float], x_mm: list[float] | None = None, *, session_s: float = 0.0
) -> Recording:
    """Return a recording of a sphere that is 0.1 s at each depth, above x."""
    x_mm = x_mm or [0.0] * len(depth_mm)
    poses = [
        Pose(np.array([1e-3 * x, 0.0, APEX_M - 1e-3 * depth]))
        for x, depth in zip(x_mm, depth_mm, strict=True)
    ]
    stamp_s = 1.0 + 0.1 * np.arange(len(poses))
    depth_m = 1e-3 * np.array(depth_mm)
    press = Press("press", "sphere", poses, stamp_s)
    return Recording(press, sphere(4e-3), session_s, depth_m, phases_of(poses, stamp_s, depth_m))


LOAD = recording_of([-0.5, 0.5, 1.0, 1.5, 2.0])
HELD = recording_of([-0.5, 1.0, 2.0, 2.0, 2.0])
RELEASED = recording_of([-0.5, 1.0, 2.0, 1.0, 0.3, -0.5])
SLID = recording_of([-0.5, 1.0, 2.0, 2.0, 2.0], [0.0, 0.0, 0.0, 0.5, 1.0])
# Frames 1 s apart show where a motion ends, not how.
SLOW = replace(HELD, press=replace(HELD.press, stamp_s=10.0 * HELD.press.stamp_s))
TURNED = replace(
    LOAD,
    press=replace(
        LOAD.press,
        poses=[Pose(p.position_m, np.array([0.0, 0.0, 0.6, 0.8])) for p in LOAD.press.poses],
    ),
)
OUTSIDE = recording_of([-1.0, -0.5, -0.7])


def response_of(
    depth_m: float, force_n: float, *, session_s: float = 0.0, moved_m: float = 0.0
) -> Response:
    """Return a response whose force is along z, with one marker of three moved along -z."""
    rest = np.array([[0.0, 0.0, APEX_M], [1e-3, 0.0, APEX_M], [0.0, 1e-3, APEX_M]])
    skin = rest.copy()
    skin[0, 2] -= moved_m
    return Response(
        stamp_s=session_s,
        session_s=session_s,
        pose=Pose(np.array([0.0, 0.0, APEX_M - depth_m])),
        depth_m=depth_m,
        rest_position_m=rest,
        skin_position_m=skin,
        force_n=np.array([0.0, 0.0, force_n]),
    )


def response_filter(name: str, **values: float):
    """Return a fresh filter of an effect."""
    effect = LIBRARY[name]
    assert effect.response is not None
    return effect.response(effect.checked(values))


def motion_filter(name: str, **values: float):
    """Return a fresh filter of an effect."""
    effect = LIBRARY[name]
    assert effect.motion is not None
    return effect.motion(effect.checked(values))


def gel_of(name: str, recording: Recording | None = None, **values: float) -> GelTerm:
    """Return what an effect makes of the gel."""
    effect = LIBRARY[name]
    return gel_with([Active(effect, effect.checked(values))], GelTerm(VALUES), recording)


@pytest.mark.parametrize("name", sorted(LIBRARY))
def test_parameters_are_valid(name: str) -> None:
    effect = LIBRARY[name]
    size = effect.parameters[0]
    assert size.none is not None, "the first parameter is the size"
    assert size.none not in size.probes
    for p in effect.parameters:
        assert p.low < p.high
        assert p.probes
        assert all(p.low <= probe <= p.high for probe in p.probes)
        assert p.none is None or p.low <= p.none <= p.high


def run_through(*effects: Active) -> np.ndarray:
    """Return what fresh filters make of the frames of a press: pose, force and skin of each."""
    moved, answered = motion_filters(effects), response_filters(effects)
    frames = []
    for stamp_s, pose, depth_m in zip(
        RELEASED.press.stamp_s, RELEASED.press.poses, RELEASED.depth_m.tolist(), strict=True
    ):
        pressed_m = max(0.0, depth_m)
        given = response_of(depth_m, 1e3 * pressed_m, session_s=50.0, moved_m=pressed_m)
        given = replace(given, force_n=np.add(given.force_n, [0.1, -0.2, 0.0]))
        acts, answer = moved(float(stamp_s), pose, np.array([0.1, 0.0, 3.0])), answered(given)
        parts = (acts.position_m, acts.quaternion_xyzw, answer.force_n, answer.skin_position_m)
        frames.append(np.concatenate([np.ravel(part) for part in parts]))
    return np.stack(frames)


@pytest.mark.parametrize("name", MECHANICAL)
def test_an_effect_of_no_size_changes_nothing_and_none_remembers_the_trajectory_before(
    name: str,
) -> None:
    effect = LIBRARY[name]
    nothing = {p.name: p.none for p in effect.parameters if p.none is not None}
    absent = Active(effect, effect.checked(nothing))
    assert gel_with([absent], GelTerm(VALUES), RELEASED) == GelTerm(VALUES)
    np.testing.assert_array_equal(run_through(absent), run_through())
    present = Active(effect, effect.checked({}))
    np.testing.assert_array_equal(run_through(present), run_through(present))
    assert effect.gel is not None or not np.array_equal(run_through(present), run_through())


@pytest.mark.parametrize(
    ("name", "size", "field", "expected"),
    [
        ("hyperelastic_stiffening", {"c20_ratio": 0.3}, "c20_ratio", 0.4),
        ("compressibility", {"log_compressibility_shift": math.log(2.0)}, "poisson_ratio", 0.46),
        ("compressibility", {"log_compressibility_shift": -9.0}, "poisson_ratio", 0.4999),
        ("thickness_error", {"thickness_share": 0.1}, "thickness_m", 1.1 * 9.75e-3),
        ("coulomb_slip", {"friction_ratio": 0.5}, "friction", 0.2),
    ],
)
def test_an_effect_on_the_gel_changes_one_value(
    name: str, size: dict[str, float], field: str, expected: float
) -> None:
    found = gel_of(name, **size).values
    assert getattr(found, field) == pytest.approx(expected)
    assert replace(found, **{field: getattr(VALUES, field)}) == VALUES


@pytest.mark.parametrize(
    ("name", "size", "moved_m"),
    [
        ("base_compliance", {"compliance_m_n": 5e-5}, [2.5e-5, 0.0, 1e-4]),
        ("pose_offset_x", {"x_m": 3e-4}, [3e-4, 0.0, 0.0]),
        ("pose_offset_y", {"y_m": 3e-4}, [0.0, 3e-4, 0.0]),
        ("pose_offset", {"z_m": 3e-4}, [0.0, 0.0, 3e-4]),
        # 2 mm of the tip a radian and newton along x: 0.1 m from where it turns, squared, by 0.2.
        ("mount_rotation", {"compliance_rad_nm": 0.02, "lever_m": 0.1}, [1e-4, 0.0, 5e-8]),
    ],
)
def test_an_effect_on_the_pose_moves_it(
    name: str, size: dict[str, float], moved_m: list[float]
) -> None:
    told = Pose(np.array([1e-3, 0.0, 14e-3]))
    acts = motion_filter(name, **size)(0.0, told, np.array([0.5, 0.0, 2.0]))
    assert acts.position_m - told.position_m == pytest.approx(moved_m)


def test_lost_bond_is_a_patch_that_slips_and_slips_more_where_it_did_already() -> None:
    values = gel_of("lost_bond", slip_share=0.4, x_rad=0.1, y_rad=0.2, radius_rad=0.5).values
    assert (values.bond_slip_share, values.loose_patch_rad) == (0.4, (0.1, 0.2, 0.5))
    effect = LIBRARY["lost_bond"]
    active = Active(effect, effect.checked({"slip_share": 0.5}))
    again = gel_with([active], GelTerm(values), None).values
    assert again.bond_slip_share == pytest.approx(0.7)
    assert again.loose_patch_rad == (0.1, 0.2, 0.5)
    # Nothing slips more than freely: the range ends there by nature.
    assert effect.parameters[0].end_at(1.0) is None


def test_relaxation_adds_a_term_and_two_stay_below_the_whole_stress() -> None:
    term = gel_of("viscoelastic_relaxation", share=0.5, time_s=3.0)
    assert (term.prony_shares, term.prony_times_s) == ((0.5,), (3.0,))
    fluid = LIBRARY["poroelastic_relaxation"]
    both = gel_with([Active(fluid, {"share": 0.5, "diffusivity_m2_s": 4e-6})], term, None)
    assert both.prony_shares == (0.5, 0.25)
    assert both.prony_times_s == pytest.approx((3.0, 1.0))


def test_poroelastic_time_grows_with_the_contact() -> None:
    deep, shallow = recording_of([-0.5, 2.0]), recording_of([-0.5, 0.5])
    times = [
        gel_of("poroelastic_relaxation", r, share=0.2, diffusivity_m2_s=1e-6).prony_times_s[0]
        for r in (deep, shallow)
    ]
    assert times[0] == pytest.approx(2e-3 * (8e-3 - 1e-3) * 0.5 / 1e-6, rel=0.02)
    assert times[0] / times[1] == pytest.approx(4.0, rel=0.1)


def test_contact_radius_is_that_of_hertz() -> None:
    assert contact_radius_m(sphere(4e-3), 0.2e-3) == pytest.approx(np.sqrt(4e-3 * 0.2e-3), rel=0.03)
    assert contact_radius_m(flat_punch(2e-3, 10e-3), 1e-3) == pytest.approx(2e-3, rel=0.01)
    # Sneddon 1965: 2/pi of the depth times the tangent; the cross-section half-way has 1/2.
    steep = contact_radius_m(cone(np.pi / 4, 10e-3), 2e-3)
    assert steep == pytest.approx(1e-3, rel=0.03)


def test_mullins_softens_below_the_largest_force_alone() -> None:
    softened = response_filter("mullins_softening", share=0.2, width=0.5)
    assert softened(response_of(2e-3, 4.0)).force_n[2] == 4.0
    below = softened(response_of(1e-3, 2.0)).force_n[2]
    assert below == pytest.approx(2.0 * (1.0 - 0.2 * math.erf((1.0 - 0.5 ** (5 / 3)) / 0.5)))
    assert softened(response_of(2e-3, 4.0)).force_n[2] == 4.0
    assert softened(response_of(3e-3, 6.0)).force_n[2] == 6.0


def test_permanent_set_leaves_a_share_once_the_skin_is_free() -> None:
    kept = response_filter("permanent_set", share=0.05)
    rest_m = response_of(0.0, 0.0).rest_position_m
    pressed = response_of(2e-3, 1.0, moved_m=2e-3)
    assert np.array_equal(kept(pressed).skin_position_m, pressed.skin_position_m)
    half = kept(response_of(1e-3, 1.0, moved_m=1e-3)).skin_position_m - rest_m
    assert half[0, 2] == pytest.approx(-1e-3 - 0.05 * 0.5 * 2e-3)
    idle = kept(response_of(-1e-3, 0.0)).skin_position_m - rest_m
    assert idle[:, 2] == pytest.approx([-0.05 * 2e-3, 0.0, 0.0])


def test_adhesion_ends_at_the_pull_off_of_the_theory() -> None:
    radius_m, work, modulus_pa = 3e-3, 0.2, 4e5
    clinging = response_filter("adhesion", work_j_m2=work, radius_m=radius_m)

    def hertz_n(depth_m: float) -> float:
        return 4 / 3 * modulus_pa * math.sqrt(radius_m) * max(0.0, depth_m) ** 1.5

    depths_m = np.concatenate([np.linspace(0.0, 1e-3, 20), np.linspace(1e-3, -0.3e-3, 4000)])
    forces_n = np.array(
        [clinging(response_of(float(d), hertz_n(float(d)))).force_n[2] for d in depths_m]
    )
    # Loading is that of Hertz; the pull is 3/2 pi w R (Johnson, Kendall, Roberts 1971).
    assert forces_n[:20] == pytest.approx([hertz_n(d) for d in depths_m[:20]])
    assert forces_n.min() == pytest.approx(-1.5 * np.pi * work * radius_m, rel=1e-3)
    # Broken off at the least depth of the curve, -3 a^2 / R, a^3 = pi w R^2 / (8 E).
    contact_m = np.cbrt(np.pi * work * radius_m**2 / (8.0 * modulus_pa))
    assert depths_m[forces_n < 0.0].min() == pytest.approx(-3 * contact_m**2 / radius_m, abs=1e-6)
    assert np.all(forces_n[20:] <= [hertz_n(d) + 1e-12 for d in depths_m[20:]])
    assert np.abs(np.diff(forces_n[20:-1000])).max() < 0.01, "the force falls without a jump"
    assert forces_n[-1] == 0.0


def test_adhesion_breaks_off_a_contact_that_is_too_narrow_to_recede() -> None:
    contact = ClingingContact(modulus_pa=4e5, radius_m=3e-3, work_j_m2=0.2, deepest_m=1e-6)
    assert contact.widest_m < contact.narrowest_m
    assert contact.force_n(-1e-3) is None


def test_latency_gives_the_pose_of_a_while_ago() -> None:
    delayed = motion_filter("latency", latency_s=0.05)
    # At 5 mm/s, stamped unevenly; before the first pose there is none.
    stamps = (1.0, 1.02, 1.07, 1.2, 1.21, 1.4)
    x_m = [
        delayed(t, Pose(np.array([5e-3 * t, 0.0, 0.0])), np.zeros(3)).position_m[0] for t in stamps
    ]
    expected = [5e-3 * max(1.0, t - 0.05) for t in stamps]
    assert x_m == pytest.approx(expected)


def test_backlash_steps_by_the_width_at_a_reversal() -> None:
    dragged = motion_filter("backlash", width_m=0.1e-3)
    x_mm = [0.0, 0.5, 1.0, 0.95, 0.5, 0.0]
    found = [
        1e3 * dragged(0.0, Pose(np.array([1e-3 * x, 0.0, 0.0])), np.zeros(3)).position_m[0]
        for x in x_mm
    ]
    assert found == pytest.approx([0.0, 0.45, 0.95, 0.95, 0.55, 0.05])


def test_a_mount_that_turns_tilts_the_indenter_and_bears_a_force_along_its_axis() -> None:
    turned = motion_filter("mount_rotation", compliance_rad_nm=0.02, lever_m=0.1)
    told = Pose(np.array([1e-3, 0.0, 14e-3]))
    assert turned(0.0, told, np.array([0.0, 0.0, 5.0])) is told
    axis = turned(0.0, told, np.array([0.0, 1.0, 5.0])).rotation()[:, 2]
    assert axis == pytest.approx([0.0, -math.sin(2e-3), math.cos(2e-3)])


def test_an_error_of_the_tool_turns_with_it() -> None:
    quarter = Pose(np.zeros(3), Rotation.from_euler("z", 90, degrees=True).as_quat())
    shifted = motion_filter("tool_offset_x", x_m=3e-4)(0.0, quarter, np.zeros(3))
    assert shifted.position_m == pytest.approx([0.0, 3e-4, 0.0])
    tilted = motion_filter("tool_tilt_x", x_rad=0.05)(0.0, quarter, np.zeros(3))
    assert tilted.rotation()[:, 2] == pytest.approx([math.sin(0.05), 0.0, math.cos(0.05)])
    assert np.array_equal(tilted.position_m, quarter.position_m)


@pytest.mark.parametrize("damping", [0.3, 5.0])
def test_a_controller_follows_as_the_differential_equation_does(damping: float) -> None:
    # 20 mm/s for 0.3 s, a stop; and about z at 1 rad/s.
    stamp_s = np.concatenate([[0.0, 0.3], np.arange(0.31, 0.8, 0.02)])
    share = np.minimum(stamp_s, 0.3)
    led = motion_filter("controller_lag", lag_s=0.08, damping=damping)
    found = []
    for stamp, done in zip(stamp_s, share, strict=True):
        turn = Rotation.from_rotvec([0.0, 0.0, done]).as_quat()
        found.append(led(float(stamp), Pose(np.array([0.02 * done, 0.0, 0.0]), turn), np.zeros(3)))
    fine_s = np.linspace(0.0, 0.8, 80001)
    system = ([1.0], [(0.04 / damping) ** 2, 0.08, 1.0])
    _, reached, _ = lsim(system, 0.02 * np.minimum(fine_s, 0.3), fine_s)
    expected = np.interp(stamp_s, fine_s, reached)
    assert [pose.position_m[0] for pose in found] == pytest.approx(expected, abs=1e-9)
    angle = [Rotation.from_quat(pose.quaternion_xyzw).magnitude() for pose in found]
    assert angle == pytest.approx(expected / 0.02, abs=1e-3)
    # Past the end of the motion, or like a lag of first order.
    if damping < 1.0:
        assert max(expected) > 0.006 + 1e-4
    else:
        first = 0.006 - 0.02 * 0.08 * np.exp((0.3 - stamp_s[1:]) / 0.08)
        assert expected[1:] == pytest.approx(first, abs=0.02 * 0.08 * 0.04)


def test_a_stage_creeps_to_its_compliance_with_one_time_constant() -> None:
    crept = motion_filter("stage_creep", compliance_m_n=4e-5, time_s=2.0)
    still = Pose(np.array([0.0, 0.0, 14e-3]))
    loads_n = [(0.0, 0.0), (1e-6, 5.0), (1.0, 5.0), (5.0, 5.0), (5.000001, 0.0), (7.0, 0.0)]
    found_m = [crept(t, still, np.array([0.0, 0.0, f])).position_m[2] - 14e-3 for t, f in loads_n]
    end_m = 2e-4 * (1.0 - math.exp(-2.5))
    expected = [0.0, 0.0, 2e-4 * (1.0 - math.exp(-0.5)), end_m, end_m, end_m * math.exp(-1.0)]
    assert found_m == pytest.approx(expected, abs=1e-9)


def test_force_effects_have_their_closed_forms() -> None:
    given = response_of(1e-3, 2.0, session_s=40.0)
    assert response_filter("force_scale", scale=1.1)(given).force_n[2] == pytest.approx(2.2)
    mixed = response_filter("force_crosstalk_y", share=-0.1)(given)
    assert mixed.force_n == pytest.approx([0.0, -0.2, 2.0])
    idle = response_filter("force_bias_x", bias_n=0.3)(response_of(-1e-3, 0.0))
    assert idle.force_n == pytest.approx([0.3, 0.0, 0.0])
    drifted = response_filter("force_drift", share_per_s=1e-3)(given)
    assert drifted.force_n[2] == pytest.approx(2.0 * 1.04)
    warmed = response_filter("thermal_drift", stiffness_change=-0.1, time_s=20.0)(given)
    assert warmed.force_n[2] == pytest.approx(2.0 * (1.0 - 0.1 * (1.0 - math.exp(-2.0))))
    assert np.array_equal(warmed.skin_position_m, given.skin_position_m)


@pytest.mark.parametrize(
    ("name", "by", "not_by"),
    [
        ("viscoelastic_relaxation", HELD, LOAD),
        ("viscoelastic_relaxation", RELEASED, LOAD),
        ("poroelastic_relaxation", HELD, LOAD),
        ("mullins_softening", RELEASED, HELD),
        ("permanent_set", RELEASED, HELD),
        ("adhesion", RELEASED, SLID),
        ("backlash", RELEASED, LOAD),
        ("coulomb_slip", SLID, HELD),
        ("hyperelastic_stiffening", LOAD, recording_of([-0.5, 0.3, 0.8])),
        ("thickness_error", LOAD, recording_of([-0.5, 0.3, 0.8])),
        ("force_drift", replace(LOAD, session_s=20.0), LOAD),
        ("thermal_drift", replace(LOAD, session_s=20.0), LOAD),
        ("latency", LOAD, OUTSIDE),
        ("controller_lag", HELD, SLOW),
        ("stage_creep", HELD, LOAD),
        ("mount_rotation", SLID, HELD),
        ("tool_offset_x", TURNED, LOAD),
        ("tool_tilt_y", replace(LOAD, indenter=cone(0.5, 10e-3)), LOAD),
    ],
)
def test_a_recording_excites_what_it_can_show(name: str, by: Recording, not_by: Recording) -> None:
    assert LIBRARY[name].excited_by(by)
    assert not LIBRARY[name].excited_by(not_by)
    assert not LIBRARY[name].excited_by(replace(OUTSIDE, session_s=100.0))
