# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The real-time clock: a user's program publishes poses and reads every topic."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import psutil
import pytest
from geometry_msgs.msg import TwistStamped
from harness import APEX_M, BASE_FRAME, Client, Executable, TactileFrame, sensor
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image
from std_srvs.srv import SetBool, Trigger

import msg_adapters
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.specification import load_sensor
from msg_adapters import Level

RATE_HZ = 25.0
Session = tuple[Executable, Client]


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    with sensor(input_timeout_s=0.3, diagnostics_period_s=0.1) as both:
        yield both


def is_pressed(frame: TactileFrame) -> bool:
    return bool(frame.force_n()[2] > 0.0)


def is_at_rest(frame: TactileFrame) -> bool:
    return bool(np.all(frame.force_n() == 0.0))


def frames_so_far(client: Client) -> int:
    """Return how many frames the node says to have made by now."""
    return int(client.state_from_now("frames").values["frames"])


def press(client: Client, depth_m: float) -> TactileFrame:
    """Come from afar, so that the press is a motion from rest, and hold."""
    afar_m = [0.0, 0.0, APEX_M + 0.05]
    client.send(afar_m)
    # A sensor at rest sends such frames before it hears of the pose, and would not hear of it at
    # all if the next one came meanwhile: only the newest counts.
    client.next_frame(lambda frame: is_at_rest(frame) and frame.indenter_m() == afar_m)
    pose_m = [0.0, 0.0, APEX_M - depth_m]
    client.send((pose_m[0], pose_m[1], pose_m[2]))
    return client.next_frame(lambda frame: is_pressed(frame) and frame.indenter_m() == pose_m)


def test_every_topic_of_a_frame_has_its_stamp_and_the_right_form(session: Session) -> None:
    client = session[1]
    frame = press(client, 0.001)
    image, depth_m, cloud = frame.image(), frame.depth_m(), frame.cloud()
    assert frame.messages["image_raw"].encoding == "rgb8"
    assert image.shape == (480, 640, 3)
    assert image.std() > 0.0
    assert depth_m.shape == (480, 640)
    seen = depth_m[np.isfinite(depth_m)]
    assert 0.0 < seen.min() < seen.max() < 0.03
    assert cloud.normal is not None
    assert cloud.displacement is not None
    assert np.allclose(np.linalg.norm(cloud.normal, axis=1), 1.0, atol=1e-3)
    assert np.linalg.norm(cloud.displacement, axis=1).max() == pytest.approx(1e-3, rel=0.1)
    for topic in ("points", "wrench"):
        assert frame.messages[topic].header.frame_id == BASE_FRAME
    for topic in ("image_raw", "depth/image", "camera_info"):
        assert frame.messages[topic].header.frame_id == "densetact_optical_frame"
    assert frame.messages["camera_info"].distortion_model == "equidistant"
    assert len(frame.messages["camera_info"].d) == 4
    client.wait(frame.indenter_m, "the indenter's state")
    assert frame.indenter_m() == [0.0, 0.0, APEX_M - 0.001]
    check_depth_is_along_the_axis(depth_m, cloud.position)
    assert client.state("frames").values["profile"] == "realtime"
    assert "profile realtime" in session[0].log


def check_depth_is_along_the_axis(depth_m: np.ndarray, skin_m: np.ndarray) -> None:
    """Assert that the depth is REP 118's: z of the skin in the optical frame, not the range."""
    camera = Camera.from_specification(load_sensor("densetact2").camera)
    optical_m = camera.to_optical(skin_m)
    z_m, range_m = optical_m[:, 2], np.linalg.norm(optical_m, axis=1)
    x, y = np.rint(camera.project_optical(optical_m)).astype(int).T
    is_seen = (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    # Near the axis the two are alike; at its rim a pixel's own width is much of the depth.
    is_aside = is_seen & (z_m < np.cos(np.radians(20.0)) * range_m) & (z_m > 0.1 * range_m)
    assert np.count_nonzero(is_aside) > 1000
    assert (range_m - z_m)[is_aside].min() > 0.0005
    error_m = depth_m[y[is_aside], x[is_aside]] - z_m[is_aside]
    assert np.abs(error_m).max() < 0.0002


def test_no_socket_is_open_to_other_machines_and_none_listens(session: Session) -> None:
    sockets = psutil.Process(session[0].process.pid).net_connections("inet")
    assert {each.laddr.ip for each in sockets} == {"127.0.0.1"}
    assert not [each for each in sockets if each.status == psutil.CONN_LISTEN]


def test_a_silent_input_is_told_and_the_next_press_is_that_of_a_fresh_start(
    session: Session,
) -> None:
    client = session[1]
    first = press(client, 0.001)
    client.wait_for_state("input", lambda state: "no input for" in state.message)
    assert client.next_frame(lambda frame: True).is_same(first)
    assert press(client, 0.001).is_same(first)


@pytest.fixture
def slow_session(session: Session) -> Iterator[Session]:
    """The session at a rate at which no frame starts late."""
    assert session[1].set_parameters(rate_hz=2.0, input_timeout_s=0.6).successful
    yield session
    assert session[1].set_parameters(rate_hz=RATE_HZ, input_timeout_s=0.3).successful


def test_a_fast_motion_lags_is_counted_and_arrives(slow_session: Session) -> None:
    client = slow_session[1]
    start_m, end_m = [0.0, 0.0, APEX_M + 0.0002], [0.0, 0.0, APEX_M - 0.0029]
    client.send((0.0, 0.0, APEX_M + 0.05))
    client.next_frame(is_at_rest)
    client.send(start_m)
    begun = client.next_frame(lambda frame: frame.indenter_m() == start_m)
    late = int(client.state("frames").values["late"])
    client.send(end_m)
    lags = client.wait_for_state("frames", lambda state: "behind its newest pose" in state.message)
    assert (lags.level, float(lags.values["lag_m"]) > 0.001) == (Level.WARN, True)
    arrived = client.next_frame(lambda frame: frame.indenter_m() == end_m)
    between = [
        client.frames[stamp_ns]
        for stamp_ns in sorted(client.frames)
        if begun.stamp_ns < stamp_ns < arrived.stamp_ns
    ]
    heights_m = [frame.indenter_m()[2] for frame in between if frame.indenter_m() is not None]
    on_the_way_m = [height for height in heights_m if height != start_m[2]]
    # 0.2 mm are free, 2.9 mm are not: frames of 0.6 mm, and what is left of the last.
    assert len(on_the_way_m) == 4
    assert np.all(np.diff([start_m[2], *on_the_way_m, end_m[2]]) < 0.0)
    assert np.diff([*on_the_way_m, end_m[2]]).min() > -0.0009
    client.wait_for_state("frames", lambda state: int(state.values["late"]) >= late + 4)
    client.wait(lambda: "behind its newest pose" in slow_session[0].log, "a line of the log")
    held = client.next_frame(lambda frame: True)
    assert held.is_same(arrived)
    assert is_pressed(held)


BALL_M, BESIDE_RAD = 0.004, 0.35


def over_the_dome(angle_rad: float, depth_m: float) -> tuple[float, float, float]:
    """Return where the tip of a ball is that presses so deep, at an angle from the apex."""
    distance_m = APEX_M + BALL_M - depth_m
    return (distance_m * np.sin(angle_rad), 0.0, distance_m * np.cos(angle_rad) - BALL_M)


def depth_m_of(tip_m: list[float]) -> float:
    """Return how deep a ball is in the dome at rest."""
    return APEX_M + BALL_M - float(np.linalg.norm(np.add(tip_m, (0.0, 0.0, BALL_M))))


def test_an_indenter_that_lags_takes_the_commanded_path_and_never_cuts_through_the_gel(
    slow_session: Session,
) -> None:
    client = slow_session[1]
    depths_m = [*np.arange(-1e-3, 2e-3, 0.25e-3), *np.arange(2e-3, -1e-3, -0.25e-3)]
    way = [over_the_dome(-BESIDE_RAD, depth_m) for depth_m in depths_m]
    way += [over_the_dome(angle, -1e-3) for angle in np.arange(-BESIDE_RAD, BESIDE_RAD, 0.05)]
    way += [over_the_dome(BESIDE_RAD, depth_m) for depth_m in depths_m[: len(depths_m) // 2 + 1]]
    client.send((0.0, 0.0, APEX_M + 0.05))
    client.next_frame(is_at_rest)
    client.send(way[0])
    begun = client.next_frame(lambda frame: frame.indenter_m() == list(way[0]))
    for tip_m in way:
        client.send(tip_m)
        time.sleep(0.02)
    arrived = client.next_frame(lambda frame: frame.indenter_m() == list(way[-1]), after=begun)
    shown = [client.frames[each] for each in sorted(client.frames) if each >= begun.stamp_ns]
    deepest_n = float(np.linalg.norm(arrived.force_n()))
    for frame in shown:
        tip_m = frame.indenter_m()
        assert tip_m is not None
        assert np.linalg.norm(np.subtract(way, tip_m), axis=1).min() < 0.5e-3
        assert depth_m_of(tip_m) < 2e-3 + 1e-6
        assert np.linalg.norm(frame.force_n()) < 1.1 * deepest_n
        if abs(np.arctan2(tip_m[0], tip_m[2] + BALL_M)) < 0.9 * BESIDE_RAD:
            assert is_at_rest(frame)


def test_a_velocity_moves_the_indenter_for_as_long_as_time_passes(session: Session) -> None:
    client = session[1]
    twists = client.node.create_publisher(TwistStamped, "indenter/twist", 5)
    message = TwistStamped()
    message.header.frame_id, message.twist.linear.z = BASE_FRAME, 0.005
    client.send((0.0, 0.0, APEX_M + 0.02))
    client.next_frame(is_at_rest)
    # More than a machine renders, so that frames are dropped.
    assert client.set_parameters(rate_hz=240.0).successful
    client.diagnostics.clear()
    client.wait_for_state("input", lambda state: "no input for" in state.message)
    client.frames.clear()
    for _ in range(50):
        twists.publish(message)
        time.sleep(0.02)
    assert client.set_parameters(rate_hz=RATE_HZ).successful
    # Poses are heard again once the velocity has been silent.
    client.wait_for_state("input", lambda state: "no input for" in state.message)
    heights_m = {
        stamp_ns: place[2]
        for stamp_ns, frame in sorted(client.frames.items())
        if (place := frame.indenter_m()) is not None
    }
    ways_m, times_s = np.diff(list(heights_m.values())), 1e-9 * np.diff(list(heights_m))
    # After a longer halt of the machine it moves for as long as an input is good.
    moves = (ways_m > 0.0) & (times_s < 0.3)
    assert moves.sum() > 5
    assert times_s[moves].max() > 2.0 / 240.0
    np.testing.assert_allclose(ways_m[moves][1:], 0.005 * times_s[moves][1:], rtol=1e-3)


def test_ten_thousand_poses_a_second_leave_the_frames_running(session: Session) -> None:
    client = session[1]
    first = press(client, 0.001)
    counted, counted_s = frames_so_far(client), time.monotonic()
    time.sleep(1.0)
    before, begun_s = frames_so_far(client), time.monotonic()
    usual_hz = (before - counted) / (begun_s - counted_s)
    for _ in range(20_000):
        client.send((0.0, 0.0, APEX_M - 0.0005))
    # Counted before anything else: a node that stands still meanwhile goes on afterwards.
    lasted_s = time.monotonic() - begun_s
    count = frames_so_far(client) - before
    # The flood takes more than a core: a fifth to a half of the frames come on two that are busy. A
    # node that stood still would have made those of the moment after it.
    assert count > max(3.0, 0.1 * usual_hz * lasted_s)
    held = client.next_frame(lambda frame: frame.indenter_m() == [0.0, 0.0, APEX_M - 0.0005])
    assert is_pressed(held)
    assert press(client, 0.001).is_same(first)


def test_a_subscriber_that_never_reads_stops_nobody(session: Session) -> None:
    client = session[1]
    first = press(client, 0.001)
    with closing(Client(is_deaf=True)):
        client.wait(lambda: client.node.count_subscribers("image_raw") > 1, "the deaf reader")
        count = int(client.state("frames").values["frames"])
        client.wait_for_state("frames", lambda state: int(state.values["frames"]) > count + 25)
        assert press(client, 0.001).is_same(first)


def test_calibrate_idle_is_refused_in_contact_and_done_without(session: Session) -> None:
    client = session[1]
    press(client, 0.001)
    answer = client.call(Trigger, "/tactile_sim/calibrate_idle")
    assert not answer.success
    assert "lift" in answer.message
    above_m = [0.0, 0.0, APEX_M + 0.00175]
    client.send((above_m[0], above_m[1], above_m[2]))
    client.next_frame(lambda frame: frame.indenter_m() == above_m)
    assert client.call(Trigger, "/tactile_sim/calibrate_idle").success
    # Where the indenter is stays known; the first may be from before.
    first = client.next_frame(lambda frame: True)
    for _ in range(3):
        first = client.next_frame(lambda frame: True, after=first)
        client.wait(first.indenter_m, "the indenter's state")
        assert first.indenter_m() == above_m


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"rate_hz": 1000.0}, "rate_hz"),
        ({"crop_px": [600, 0, 100, 100]}, "reaches beyond"),
        ({"input_timeout_s": 0.03}, "shorter than a frame"),
        ({"clock": "lockstep"}, "read-only"),
        ({"indenter": "no_such_thing"}, "no indenter is named"),
    ],
)
def test_a_bad_parameter_is_refused_with_the_reason(
    session: Session, values: dict[str, object], reason: str
) -> None:
    result = session[1].set_parameters(**values)
    assert not result.successful
    assert reason in result.reason


def test_of_a_call_that_is_refused_nothing_is_in_force(session: Session) -> None:
    client = session[1]
    # Of two reasons to refuse it, one comes from the clock of the node.
    result = client.set_parameters(encoding="bgr8", use_sim_time=True)
    assert (result.successful, "use_sim_time is fixed" in result.reason) == (False, True)
    answered_ns = client.now_ns()
    # Others may still be on their way.
    after = client.next_frame(lambda frame: frame.stamp_ns > answered_ns)
    assert after.messages["image_raw"].encoding == "rgb8"


def test_encoding_crop_and_size_are_parameters(session: Session) -> None:
    client = session[1]
    whole = press(client, 0.001)
    try:
        assert client.set_parameters(
            encoding="bgr8", crop_px=[80, 0, 480, 480], image_size_px=[320, 320]
        ).successful
        small = client.next_frame(lambda frame: frame.messages["image_raw"].encoding == "bgr8")
        assert small.image().shape == (320, 320, 3)
        assert small.depth_m().shape == (320, 320)
        info = msg_adapters.decode_camera_info(small.messages["camera_info"])
        before = msg_adapters.decode_camera_info(whole.messages["camera_info"])
        assert (info.width, info.height) == (320, 320)
        assert info.focal_px == pytest.approx(before.focal_px * 320 / 480)
    finally:
        client.set_parameters(encoding="rgb8", crop_px=[0, 0, 0, 0], image_size_px=[0, 0])


def test_the_indenter_can_be_changed_and_changed_back(session: Session) -> None:
    client = session[1]
    sphere = press(client, 0.001)
    assert client.set_parameters(indenter="{kind: sphere, radius_m: 0.002}").successful
    small = press(client, 0.001)
    assert 0.0 < small.force_n()[2] < sphere.force_n()[2]
    assert client.set_parameters(indenter="sphere_4mm").successful
    assert press(client, 0.001).is_same(sphere)


def test_a_reader_of_another_quality_is_named(session: Session) -> None:
    executable, client = session
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    reader = client.node.create_subscription(Image, "image_raw", lambda _: None, latched)
    executable.wait_for_line("requesting incompatible QoS")
    client.node.destroy_subscription(reader)


def test_a_node_that_has_started_by_itself_can_be_managed_too(session: Session) -> None:
    executable, client = session

    def change(label: str) -> None:
        transition = Transition(label=label)
        assert client.call(ChangeState, "/tactile_sim/change_state", transition=transition).success

    change("deactivate")
    assert client.call(SetBool, "/tactile_sim/set_enabled", data=True).success
    client.wait_for_state("frames", lambda state: "inactive: activate the node" in state.message)
    count = frames_so_far(client)
    assert frames_so_far(client) == count
    change("activate")
    client.next_frame(lambda frame: True)
    assert executable.interrupt() == 0, executable.log
