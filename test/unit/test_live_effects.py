# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects between what a live sensor is told and what it measures: real gel, no ROS."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dotsim_ros.effects.effect import Active, specification_with_effects
from dotsim_ros.effects.library import load_effects
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose, Wrench
from dotsim_ros.nodes.common.ingest import Fault
from dotsim_ros.nodes.tactile_sim.live_effects import wrench_with_force
from dotsim_ros.nodes.tactile_sim.motion import MotionOrder
from dotsim_ros.nodes.tactile_sim.session import SensorSession
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import MaterialSpecification, load_sensor

APEX_M = 0.01575
STEP_NS = 40_000_000
LIBRARY = load_effects()
OWN = load_sensor("densetact2")


@pytest.fixture(scope="module")
def sensor() -> TactileSensor:
    return TactileSensor(OWN, indenter=load_indenter("sphere_4mm"))


def active(name: str, **values: float) -> Active:
    """Return an effect at work."""
    return Active(LIBRARY[name], LIBRARY[name].checked(values))


def session_of(sensor: TactileSensor, *effects: Active) -> SensorSession:
    """Return a session from rest."""
    sensor.reset()
    return SensorSession(sensor, first_dt_s=0.04, effects=effects)


def pressed(depth_mm: float) -> Pose:
    """Return a pose above the apex."""
    return Pose(np.array([0.0, 0.0, APEX_M - 1e-3 * depth_mm]))


def forces_n(session: SensorSession, *depth_mm: float) -> list[float]:
    """Return the normal force at each depth, 0.04 s apart."""
    moments = [
        session.follow(MotionOrder(pressed(depth), (k + 1) * STEP_NS, None))
        for k, depth in enumerate(depth_mm)
    ]
    return [float(moment.gel.wrench.force_n[2]) for moment in moments]


def test_effects_on_the_gel_change_the_specification() -> None:
    assert specification_with_effects(OWN, [active("force_scale")]) is OWN
    effects = [
        active("coulomb_slip", friction_ratio=0.5),
        active("thickness_error", thickness_share=0.1),
        active("viscoelastic_relaxation", share=0.3, time_s=2.0),
    ]
    changed = specification_with_effects(OWN, effects)
    friction = changed.contact.friction_coefficient
    assert friction == pytest.approx(0.5 * OWN.contact.friction_coefficient)
    thickness_m = OWN.gel.outer_radius_m - OWN.gel.core_radius_m
    assert changed.gel.core_radius_m == pytest.approx(OWN.gel.outer_radius_m - 1.1 * thickness_m)
    assert (changed.material.prony_shares, changed.material.prony_times_s) == ((0.3,), (2.0,))
    assert (changed.camera, changed.solver) == (OWN.camera, OWN.solver)
    material = MaterialSpecification(
        law="mooney_rivlin", c10_pa=4e4, c01_pa=1e4, bulk_modulus_pa=2e6
    )
    with pytest.raises(ValueError, match="expected neo_hookean or yeoh"):
        specification_with_effects(replace(OWN, material=material), effects)


def test_a_scaled_force_keeps_its_line_of_action_and_one_out_of_nothing_acts_at_the_tip() -> None:
    wrench = Wrench(np.array([0.0, 0.5, 2.0]), np.array([0.01, -0.02, 0.003]))
    scaled = wrench_with_force(wrench, 1.1 * wrench.force_n, np.array([0.0, 0.0, 0.014]))
    assert scaled.torque_nm == pytest.approx(1.1 * wrench.torque_nm)
    pulled = wrench_with_force(Wrench(), np.array([0.0, 0.0, -0.1]), np.array([2e-3, 0.0, 0.016]))
    assert pulled.force_n.tolist() == [0.0, 0.0, -0.1]
    assert pulled.torque_nm == pytest.approx([0.0, 2e-4, 0.0])


def test_no_effect_changes_no_bit(sensor: TactileSensor) -> None:
    depths = (0.4, 0.8, 0.8)
    plain = forces_n(session_of(sensor), *depths)
    absent = active("force_scale", scale=1.0), active("latency", latency_s=0.0)
    assert forces_n(session_of(sensor, *absent), *depths) == plain


def test_latency_goes_on_under_a_held_indenter_until_it_is_there(sensor: TactileSensor) -> None:
    straight = forces_n(session_of(sensor), 0.4, 0.8)
    session = session_of(sensor, active("latency", latency_s=0.04))
    late = forces_n(session, 0.4, 0.8)
    # The gel comes to the same depth from another state, within its tolerance.
    assert late == pytest.approx([straight[0], straight[0]], rel=0.02)
    assert session.advance().gel.wrench.force_n[2] == pytest.approx(straight[1], rel=0.02)
    assert session.moment.pose is not None
    assert session.moment.pose.position_m == pytest.approx(pressed(0.8).position_m)


def test_a_base_that_gives_way_settles_between_force_and_depth(sensor: TactileSensor) -> None:
    compliance = 5e-5
    session = session_of(sensor, active("base_compliance", compliance_m_n=compliance))
    forces_n(session, 0.5, 1.0)
    for _ in range(12):
        moment = session.advance()
    assert moment.pose is not None
    lost_m = moment.pose.position_m - pressed(1.0).position_m
    assert lost_m == pytest.approx(compliance * moment.gel.wrench.force_n, abs=1e-7)


def test_time_of_the_session_goes_on_over_a_new_start_and_not_over_a_reset(
    sensor: TactileSensor,
) -> None:
    straight = forces_n(session_of(sensor), 0.5, 0.5)
    session = session_of(sensor, active("force_drift", share_per_s=5e-3))
    # 0.04 s for the first frame, then 0.04 s each.
    drifted = [(1.0 + 4e-2 * (k + 1) * 5e-3) * straight[k] for k in (0, 1)]
    assert forces_n(session, 0.5, 0.5) == pytest.approx(drifted, rel=1e-9)
    again = session.follow(MotionOrder(pressed(0.5), STEP_NS, Fault.JUMP))
    third = (1.0 + 12e-2 * 5e-3) * straight[0]
    assert again.gel.wrench.force_n[2] == pytest.approx(third, rel=1e-9)
    session.reset()
    assert forces_n(session, 0.5) == pytest.approx(drifted[:1], rel=1e-9)


def test_a_new_start_forgets_what_was_pressed(sensor: TactileSensor) -> None:
    session = session_of(sensor, active("permanent_set", share=0.1))
    rest_m = sensor.skin.rest_position_m
    forces_n(session, 0.5, 1.0)
    left = (
        session.follow(MotionOrder(pressed(-1.0), 10 * STEP_NS, None)).gel.skin_position_m - rest_m
    )
    assert left[:, 2].min() == pytest.approx(-0.1e-3, rel=0.1)
    fresh = session.follow(MotionOrder(pressed(-1.0), STEP_NS, Fault.JUMP))
    assert np.array_equal(fresh.gel.skin_position_m, rest_m)


def test_an_effect_on_the_image_leaves_the_rest_alone(sensor: TactileSensor) -> None:
    motion = MotionOrder(pressed(0.8), STEP_NS, None)
    plain = session_of(sensor).follow(motion).render()
    red = session_of(sensor, active("led_imbalance_red", loss_share=0.2)).follow(motion).render()
    assert np.array_equal(red.image[..., 1:], plain.image[..., 1:])
    assert np.array_equal(red.image[..., 0], np.rint(0.8 * plain.image[..., 0]))
    assert np.array_equal(red.depth_m, plain.depth_m, equal_nan=True)
    assert np.array_equal(red.wrench.force_n, plain.wrench.force_n)
    assert red.timings_s["effects"] > 0.0


def test_motion_blur_needs_a_motion(sensor: TactileSensor) -> None:
    def images(session: SensorSession) -> list[np.ndarray]:
        # The first frame comes from nowhere, the second one drags the skin.
        poses = [Pose(np.array([x, 0.0, APEX_M - 1e-3])) for x in (0.0, 1e-3)]
        moments = [
            session.follow(MotionOrder(pose, (k + 1) * STEP_NS, None))
            for k, pose in enumerate(poses)
        ]
        return [moment.render().image.astype(float) for moment in moments]

    sharp = images(session_of(sensor))
    blurred = images(session_of(sensor, active("motion_blur", exposure_s=0.03)))
    change = [np.abs(b - s).max() for b, s in zip(blurred, sharp, strict=True)]
    assert change[0] == 0.0
    assert change[1] > 5.0


def test_the_motion_of_the_image_is_that_of_the_points_it_shows(sensor: TactileSensor) -> None:
    before_m = sensor.skin.rest_position_m
    after_m = before_m + np.array([2e-4, -1e-4, 0.0])
    motion_px = sensor.image_motion_px(before_m, after_m)
    height, width = motion_px.shape[:2]
    y, x = height // 2 + 30, width // 2 - 40
    frame = sensor.see(replace(sensor.press(None, 0.04), skin_position_m=after_m), None)
    shown_m = frame.material_point_m[y, x].astype(float)
    expected = sensor.camera.project(np.add(shown_m, [2e-4, -1e-4, 0.0])) - sensor.camera.project(
        shown_m
    )
    assert motion_px[y, x] == pytest.approx(expected, abs=0.05)
    assert np.linalg.norm(expected) > 1.0
    unseen = np.isnan(frame.depth_m)
    assert unseen.any()
    assert np.all(motion_px[unseen] == 0.0)
