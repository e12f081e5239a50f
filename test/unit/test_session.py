# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A sensor under a stream of motions, without ROS: real gel, real frames."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dotsim_ros.effects.effect import FORCE, Active, Effect, EffectError, EffectParameter
from dotsim_ros.effects.library import load_effects
from dotsim_ros.gel.explicit.gel import DivergenceError
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.nodes.common.ingest import Fault, RefusedInputError
from dotsim_ros.nodes.tactile_sim.health import FAULT_MEMORY_S, FrameCounter, gel_report
from dotsim_ros.nodes.tactile_sim.motion import MotionOrder
from dotsim_ros.nodes.tactile_sim.session import SensorSession
from dotsim_ros.sensor import GelFailureError, TactileSensor
from dotsim_ros.specification import load_sensor
from msg_adapters import Level

APEX_M = 0.01575


@pytest.fixture(scope="module")
def sensor():
    return TactileSensor(load_sensor("densetact2"), indenter=load_indenter("sphere_4mm"))


@pytest.fixture(params=[np.linalg.LinAlgError("not positive definite"), DivergenceError("blew up")])
def failing_gel(sensor, request):
    """Let every solution of the gel fail half-way, as a hopeless state does."""
    sensor.reset()

    def fail(*_):
        raise request.param

    sensor._gel.gel.observer = fail
    yield sensor._gel.gel
    sensor._gel.gel.observer = None
    sensor.reset()


def pressed(depth_mm):
    return Pose(np.array([0.0, 0.0, APEX_M - 1e-3 * depth_mm]))


def motion(depth_mm, stamp_ns):
    return MotionOrder(pressed(depth_mm), stamp_ns, None)


def test_a_gel_that_cannot_be_solved_is_reset_and_says_so(sensor, failing_gel):
    fresh = sensor.step(None, 0.04)
    with pytest.raises(GelFailureError, match="press again from outside"):
        sensor.step(pressed(0.5), 0.04)
    failing_gel.observer = None
    again = sensor.step(None, 0.04)
    assert again.time_s == 0.04
    assert np.array_equal(again.skin_position_m, fresh.skin_position_m)


def test_a_session_goes_on_after_a_failed_gel_as_a_fresh_one(sensor, failing_gel):
    failing_gel.observer, fail = None, failing_gel.observer
    session = SensorSession(sensor, first_dt_s=0.04)
    expected = session.follow(motion(0.5, 1)).render()
    session.reset()
    before = session.moment
    failing_gel.observer = fail
    with pytest.raises(RefusedInputError) as refusal:
        session.follow(motion(0.5, 2))
    assert refusal.value.fault is Fault.FAILURE
    assert session.moment is before
    failing_gel.observer = None
    frame = session.follow(motion(0.5, 3)).render()
    assert np.array_equal(frame.wrench.force_n, expected.wrench.force_n)
    assert np.array_equal(frame.image, expected.image)


def test_a_frame_that_has_not_converged_is_counted_and_warned_of_for_a_while(sensor):
    sensor.reset()
    gel = sensor.press(None, 0.04)
    counter = FrameCounter()
    counter.note(0.0, {}, converged=True)

    def state(now_s, **changes):
        level, _, values = gel_report(replace(gel, **changes), (), counter, now_s)
        return level, values["unconverged"]

    assert state(0.0) == (Level.OK, "0")
    counter.note(1.0, {}, converged=False)
    counter.note(1.04, {}, converged=True)
    assert state(1.1) == (Level.WARN, "1")
    assert state(2.0 + FAULT_MEMORY_S) == (Level.OK, "1")
    assert state(2.0 + FAULT_MEMORY_S, converged=False) == (Level.WARN, "1")


def test_a_deep_press_takes_several_limited_frames_and_arrives(sensor):
    sensor.reset()
    session = SensorSession(sensor, first_dt_s=0.04, limit_m=0.0012)
    assert session.follow(motion(-5.0, 1)).pose.position_m[2] == APEX_M + 5.0e-3
    assert session.follow(motion(-0.5, 2)).pose.position_m[2] == APEX_M + 0.5e-3
    frames = [session.follow(motion(2.5, 3))]
    while frames[-1].pose.position_m[2] != APEX_M - 2.5e-3 and len(frames) < 10:
        frames.append(session.advance())
    heights_m = [frame.pose.position_m[2] for frame in frames]
    # The first 0.5 mm are free.
    assert heights_m[0] == pytest.approx(APEX_M - 1.2e-3, abs=0.06e-3)
    assert -np.diff(heights_m) == pytest.approx([1.2e-3, 0.1e-3], abs=0.06e-3)
    assert heights_m[-1] == APEX_M - 2.5e-3
    assert session.behind == 2
    assert session.advance() is frames[-1]


def test_the_newest_pose_is_pursued_from_where_the_indenter_is(sensor):
    sensor.reset()
    session = SensorSession(sensor, first_dt_s=0.04, limit_m=0.0012)
    first = session.follow(motion(2.5, 1))
    assert first.pose.position_m[2] > APEX_M - 2.5e-3
    back = session.follow(motion(1.0, 2))
    assert back.pose.position_m[2] == APEX_M - 1.0e-3
    assert 0.0 < back.gel.wrench.force_n[2] < first.gel.wrench.force_n[2]


def beside(x_mm, depth_mm, stamp_ns):
    place_m = np.array([1e-3 * x_mm, 0.0, 0.0])
    tip_m = np.sqrt((APEX_M + 0.004) ** 2 - place_m[0] ** 2) - 0.004 - 1e-3 * depth_mm
    return MotionOrder(Pose(np.array([place_m[0], 0.0, tip_m])), stamp_ns, None)


def test_a_lagging_indenter_leaves_the_gel_with_its_path_and_presses_as_a_fresh_one(sensor):
    there = [beside(5.0, depth_mm, 10) for depth_mm in (-1.0, 0.4, 0.8)]
    sensor.reset()
    fresh = SensorSession(sensor, first_dt_s=0.04, limit_m=0.0006)
    for motion_there in there:
        fresh.order(motion_there)
    expected = [fresh.advance(), fresh.advance()]
    assert fresh.behind == 1
    sensor.reset()
    session = SensorSession(sensor, first_dt_s=0.04, limit_m=0.0006)
    session.follow(beside(-5.0, -1.0, 1))
    session.follow(beside(-5.0, 2.0, 2))
    assert session.take_largest_lag_m() == pytest.approx(1.4e-3, abs=0.1e-3)
    assert session.moment.gel.wrench.force_n[2] > 0.0
    for number, x_mm in enumerate((-5.0, 0.0, 5.0)):
        session.order(beside(x_mm, -1.0, 3 + number))
    for motion_there in there[1:]:
        session.order(motion_there)
    for moment in expected:
        found = session.advance()
        assert np.array_equal(found.pose.position_m, moment.pose.position_m)
        assert np.array_equal(found.gel.skin_position_m, moment.gel.skin_position_m)
    # It was so far behind when this was asked for last.
    assert session.take_largest_lag_m() == pytest.approx(1.4e-3, abs=0.1e-3)
    assert session.take_largest_lag_m() == 0.0


def test_a_limited_press_that_would_be_refused_does_not_begin(sensor):
    sensor.reset()
    session = SensorSession(sensor, first_dt_s=0.04, limit_m=0.0012)
    with pytest.raises(RefusedInputError, match="press less deep") as refusal:
        session.follow(motion(20.0, 1))
    assert refusal.value.fault is Fault.GEL
    assert not session.is_touched()
    assert session.advance() is session.moment


@pytest.mark.fault("effects and overlays", "an effect of one's own that fails at a press")
@pytest.mark.parametrize(
    ("hooks", "reason"),
    [
        ({"response": lambda values: lambda r: r.no_force}, "its hook response fails with Attrib"),
        ({"motion": lambda values: lambda *_: None}, "its hook motion gives None, expected a Pose"),
        (
            {"image": lambda values: lambda image: image.pixels[:1]},
            r"the effect own gives the image of shape \(1, .*expected finite numbers of shape",
        ),
    ],
)
def test_a_broken_effect_is_seen_before_the_first_frame(sensor, hooks, reason, answered):
    size = EffectParameter("size", "", 0.0, 0.0, 1.0, (0.5,))
    effect = Effect("own", "Own", (size,), (FORCE,), "any", lambda recording: True, **hooks)
    session = SensorSession(sensor, first_dt_s=0.04, effects=[Active(effect, {"size": 0.5})])
    with pytest.raises(EffectError, match=reason) as refused:
        session.warm_up()
    answered(refused.value, what=f"an effect whose hook {next(iter(hooks))} fails at a press")
    sensor.reset()


def test_a_moment_is_rendered_only_when_it_is_asked_for_and_once(sensor):
    sensor.reset()
    moment = SensorSession(sensor, first_dt_s=0.04).follow(motion(0.5, 1))
    assert set(moment.timings_s) == {"contact", "solve"}
    frame = moment.render()
    assert set(moment.timings_s) == {"contact", "solve", "depth", "image"}
    assert moment.render() is frame
    sensor.reset()
    expected = sensor.step(pressed(0.5), 0.04)
    assert np.array_equal(frame.image, expected.image)


def test_a_gel_that_relaxes_goes_on_under_a_held_indenter():
    specification = load_sensor("densetact2")
    relaxing = replace(
        specification,
        material=replace(specification.material, prony_shares=(0.4,), prony_times_s=(0.2,)),
        solver=replace(specification.solver, refined=False),
    )
    sensor = TactileSensor(relaxing, indenter=load_indenter("sphere_4mm"))
    session = SensorSession(sensor, first_dt_s=0.04, limit_m=np.inf)
    at_once = session.follow(motion(0.8, 40_000_000)).gel.wrench.force_n[2]
    held = [session.advance().gel.wrench.force_n[2] for _ in range(25)]
    assert np.all(np.diff([at_once, *held]) < 0.0)
    # Five times its time later, three fifths of the shape-changing stress are left.
    assert held[-1] < 0.75 * at_once


BEGINNINGS = {
    "a calibration": lambda session: session.relax(),
    "a stop": lambda session: session.restart(),
    "another indenter": lambda session: session.change_indenter(load_indenter("sphere_4mm")),
}


@pytest.mark.parametrize("how", BEGINNINGS)
def test_only_a_reset_begins_a_session_anew(sensor, how):
    drift = load_effects()["force_drift"]
    effects = [Active(drift, drift.checked({"share_per_s": 0.1}))]
    sensor.reset()
    session = SensorSession(sensor, first_dt_s=0.04, effects=effects)
    # The force at 0.04 s from the start of the session, then at 0.12 s.
    first = session.follow(motion(0.5, 40_000_000)).gel.wrench.force_n[2]
    session.follow(motion(-1.0, 80_000_000))
    BEGINNINGS[how](session)
    again = session.follow(motion(0.5, 120_000_000)).gel.wrench.force_n[2]
    assert again / first == pytest.approx(1.012 / 1.004, rel=1e-6)
    session.reset()
    fresh = session.follow(motion(0.5, 160_000_000)).gel.wrench.force_n[2]
    assert fresh == pytest.approx(first, rel=1e-9)


def test_a_gel_comes_to_rest_beside_an_indenter_that_stays_where_it_is_led(sensor):
    sensor.reset()
    session = SensorSession(sensor, first_dt_s=0.04, limit_m=0.0012)
    session.follow(motion(-2.0, 40_000_000))
    rest = session.relax()
    assert rest.pose.position_m[2] == APEX_M + 2.0e-3
    assert np.array_equal(rest.gel.skin_position_m, sensor.skin.rest_position_m)
    # It goes on from there, not as one that comes from afar would.
    assert session.follow(motion(2.0, 80_000_000)).pose.position_m[2] > APEX_M - 2.0e-3
    assert session.advance().pose.position_m[2] == APEX_M - 2.0e-3


class Timed:
    """A gel that remembers, and keeps the time steps that it is given."""

    remembers = True

    def __init__(self):
        self.steps_s = []

    def press(self, _pose, step_s):
        self.steps_s.append(step_s)
        wrench = SimpleNamespace(force_n=np.zeros(3))
        return SimpleNamespace(wrench=wrench, skin_position_m=np.zeros((1, 3)))

    def reset(self):
        pass


def test_a_gel_that_remembers_is_given_the_time_that_has_passed():
    timed = Timed()
    session = SensorSession(timed, first_dt_s=0.04)
    session.follow(motion(0.5, 1_000_000_000))
    for step_s in (0.12, 0.04):
        session.advance(step_s)
    session.follow(motion(0.5, 1_200_000_000))
    # Of the 0.2 s between the two poses 0.16 s are over already.
    assert timed.steps_s[-3:] == pytest.approx([0.12, 0.04, 0.04])
    session.first_dt_s = 0.1
    session.advance()
    assert timed.steps_s[-1] == 0.1
