# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`tactile_policy` over DDS: its rates, its services, and every fault that must stop the arm."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, WrenchStamped
from harness import Executable
from hostile import lines_of
from policy_rig import (
    FOLLOWED,
    MODULE,
    Command,
    Rig,
    policy_and_rig,
    stopping_times_s,
    with_white_spot,
    write_network,
)
from std_srvs.srv import Trigger

from msg_adapters import Level

STOP_S = 0.08
SLACK_S = 0.15
"""What a busy machine that runs the tests may add."""


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_network(tmp_path_factory.mktemp("policy") / "steady")


@pytest.fixture(scope="module")
def shared(network: Path) -> Iterator[tuple[Executable, Rig]]:
    """A node at 25 commands a second that reads the force; faults are mended by `start`."""
    with policy_and_rig(network, force_limit_n=2.0, retreat_m=0.2) as (executable, rig):
        yield executable, rig


@pytest.fixture
def rig(shared: tuple[Executable, Rig]) -> Rig:
    return shared[1]


def may_have_priority() -> bool:
    code = "import os; os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(2))"
    tried = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    return tried.returncode == 0


def rate_hz(stamps: list[float]) -> float:
    return (len(stamps) - 1) / (stamps[-1] - stamps[0])


def drive(rig: Rig) -> None:
    """Let the arm move for a while."""
    begun_s = rig.newest().stamp_s
    rig.start()
    rig.wait(lambda: sum(each.moves() for each in rig.after(begun_s)) > 20, "a motion of 0.8 s")


def test_it_is_off_at_start_and_cannot_start_without_an_idle_image(rig: Rig) -> None:
    rig.wait(lambda: len(rig.commands) > 20, "commands")
    assert not any(command.moves() for command in rig.commands)
    answer = rig.enable()
    assert not answer.success
    assert "no idle image" in answer.message
    assert "no idle image" in rig.state("inference").message


def test_it_prints_the_calls_that_enable_it(shared: tuple[Executable, Rig]) -> None:
    executable, rig = shared
    executable.wait_for_line("/set_enabled")
    name = f"{rig.node.get_namespace()}/tactile_policy"
    calls = [line.partition("]: ")[2] for line in executable.log.splitlines() if "ros2 " in line]
    assert calls == [
        f"ros2 service call {name}/calibrate_idle std_srvs/srv/Trigger",
        f'ros2 service call {name}/set_enabled std_srvs/srv/SetBool "{{data: true}}"',
    ]
    services = dict(rig.node.get_service_names_and_types())
    assert {call.split()[3]: [call.split()[4]] for call in calls}.items() <= services.items()


def test_enabled_it_follows_the_network_at_25_hz_and_controls_at_100(rig: Rig) -> None:
    rig.start()
    moving: list[np.ndarray] = []

    def is_steady() -> bool:
        begun_s = time.time()
        time.sleep(4.0)
        commands = rig.after(begun_s)
        assert {command.frame_id for command in commands} == {"link_tcp"}
        moving[:] = [command.twist for command in commands if command.moves()]
        # Above, it is the rate that must hold; below, a machine that runs other tests may be slow.
        inference = rig.state("inference").values
        return (
            18.0 < rate_hz([command.stamp_s for command in commands]) < 26.0
            and len(moving) > 0.8 * len(commands)
            and 50.0 < float(rig.state().values["control_rate_hz"]) < 104.0
            and 18.0 < float(inference["rate_hz"]) < 26.0
            and float(inference["image_age_at_command_p50_p99_ms"].split(",")[0]) < 60.0
        )

    rig.wait(is_steady, "4 s in which images are rarely late and the rates are kept")
    np.testing.assert_allclose(np.median(moving, axis=0)[:3], FOLLOWED[:3], atol=5e-5)


def test_disabled_it_goes_on_with_zeros(rig: Rig) -> None:
    def stop() -> float:
        rig.start()
        begun_s = time.time()
        assert rig.enable(False).success
        return rig.rest_s(begun_s) - begun_s

    stopping_times_s(stop, limit_s=SLACK_S)
    stopped_s = time.time()
    rig.wait(lambda: len(rig.after(stopped_s)) > 5, "more commands")
    assert not any(command.moves() for command in rig.after(stopped_s))
    rig.wait(lambda: rig.state().values["state"] == "disabled", "the state to be told")


@pytest.mark.parametrize(("stream", "reason"), [("images", "image_stale"), ("poses", "pose_stale")])
def test_a_cut_stream_stops_the_arm_in_time_and_resumes(rig: Rig, stream: str, reason: str) -> None:
    def stop() -> float:
        rig.start()
        setattr(rig, f"has_{stream}", False)
        time.sleep(0.05)
        last_s = rig.last_image_s if stream == "images" else rig.last_pose_s
        return rig.rest_s(last_s) - last_s

    stopping_times_s(stop, limit_s=STOP_S + SLACK_S)
    state = rig.wait_for_reason("stopped", reason)
    assert "ms ago" in state.message
    setattr(rig, f"has_{stream}", True)
    rig.wait(lambda: rig.newest().moves(), "the motion to go on")


def test_a_nan_of_the_network_is_never_commanded_and_latched(rig: Rig) -> None:
    def stop() -> float:
        rig.start()
        begun_s = time.time()
        rig.crop = with_white_spot(rig.idle)
        return rig.rest_s(begun_s) - begun_s

    stopping_times_s(stop, limit_s=STOP_S + SLACK_S)
    assert "nan" in rig.wait_for_reason("latched", "not_finite").message
    assert all(np.isfinite(command.twist).all() for command in rig.commands)
    rig.crop = rig.idle
    time.sleep(0.5)
    assert not rig.newest().moves()
    rig.wait(lambda: rig.enable().success, "the start")
    rig.wait(lambda: rig.newest().moves(), "the motion to go on")


def test_images_of_another_sensor_are_latched(rig: Rig) -> None:
    def stop() -> float:
        rig.start()
        begun_s = time.time()
        rig.crop = 255 - rig.idle
        return rig.rest_s(begun_s) - begun_s

    stopping_times_s(stop, limit_s=STOP_S + SLACK_S)
    assert "another sensor" in rig.wait_for_reason("latched", "wrong_sensor").message


def test_images_of_another_frame_are_latched(rig: Rig) -> None:
    rig.start()
    rig.image_frame = "other_optical_frame"
    assert "other_optical_frame" in rig.wait_for_reason("latched", "wrong_sensor").message


@pytest.mark.parametrize("lag_s", [-1.0, 1.0])
def test_a_jump_of_the_clock_is_latched(rig: Rig, lag_s: float) -> None:
    def stop() -> float:
        rig.start()
        begun_s = time.time()
        rig.image_lag_s = lag_s
        return rig.rest_s(begun_s) - begun_s

    stopping_times_s(stop, limit_s=STOP_S + SLACK_S)
    assert "image: the stamp" in rig.wait_for_reason("latched", "clock_jump").message


@pytest.mark.parametrize(
    ("stream", "reason"),
    [("image", "image_delayed"), ("pose", "pose_delayed"), ("wrench", "force_stale")],
)
def test_old_messages_are_told_from_cut_ones(rig: Rig, stream: str, reason: str) -> None:
    named = stream.replace("wrench", "force")

    def stop() -> float:
        rig.start()
        # Stamps that go back a little would be a jump of the clock: nothing comes meanwhile.
        setattr(rig, f"has_{named}s", False)
        time.sleep(0.02)
        last_s = getattr(rig, f"last_{stream}_s")
        return rig.rest_s(last_s) - last_s

    stopping_times_s(stop, limit_s=STOP_S + SLACK_S)
    assert "ms ago" in rig.wait_for_reason("stopped", f"{named}_stale").message
    rig.wait(lambda: time.time() - getattr(rig, f"last_{stream}_s") > 0.4, "the silence")
    setattr(rig, f"{named}_lag_s", 0.35)
    setattr(rig, f"has_{named}s", True)
    rig.wait(
        lambda: float(rig.state("input").values[f"{named}_delay_ms"]) > 300.0, "the old messages"
    )
    rig.rest_s(time.time())
    state = rig.wait_for_reason("stopped", reason)
    # Forces have one reason for both, and its words are those with which it last began.
    is_begun_before = named == "force" and "ms ago" in state.message
    assert is_begun_before or "after the time of its stamp" in state.message


def test_a_force_above_the_limit_retreats_along_the_tool(rig: Rig) -> None:
    rig.start()
    rig.force_n = 3.0
    rig.wait_for_reason("retreating", "force_limit")
    back = [0.0, 0.0, -0.01, 0.0, 0.0, 0.0]
    rig.wait(lambda: np.allclose(rig.newest().twist, back, rtol=0.0, atol=1e-9), "the retreat")
    rig.force_n = 0.5
    rig.wait(lambda: rig.newest().twist[2] > 0.0, "the motion to go on")


@pytest.mark.fault("messages", "no force on the topic `wrench`, and `force_limit_n` as it is")
def test_without_a_parameter_the_force_is_limited_and_must_come(
    network: Path, answered: Callable[..., None]
) -> None:
    with policy_and_rig(network, has_forces=False, retreat_m=0.01) as (_, rig):
        rig.calibrate()
        answer = rig.enable()
        assert not answer.success
        answered(answer.message)
        state = rig.state("input")
        assert state.level == Level.WARN
        assert "set force_limit_n to 0" in state.message
        rig.start()
        rig.force_n = 9.0
        rig.wait_for_reason("retreating", "force_limit")
        assert "after a retreat of" in rig.wait_for_reason("latched", "retreat_failed").message
        rig.rest_s(time.time())


def test_a_sensor_without_force_is_said_to_be_one(network: Path) -> None:
    with policy_and_rig(network, has_forces=False, force_limit_n=0.0) as (executable, rig):
        executable.wait_for_line("force_limit_n is 0: nothing limits the force; set it for")
        rig.calibrate()
        rig.wait(lambda: rig.enable().success, "the start")
        rig.wait(lambda: rig.newest().moves(), "a motion")
        assert "nothing limits the force" in rig.state("input").message


@pytest.mark.fault("messages", "a pose at 10 m and 100 N, both with stamp zero, as the arm moves")
def test_messages_that_are_refused_neither_stop_nor_move_the_arm(
    rig: Rig, shared: tuple[Executable, Rig], answered: Callable[..., None]
) -> None:
    rig.start()
    stops = rig.state().values["stops"]
    far = PoseStamped()
    far.header.frame_id, far.pose.position.x, far.pose.orientation.w = "link_base", 10.0, 1.0
    strong = WrenchStamped()
    strong.header.frame_id, strong.wrench.force.z = "tool", 100.0
    refused = int(rig.state("input").values["refused"])

    def are_refused() -> bool:
        # A busy node loses some.
        rig.poses.publish(far)
        rig.wrenches.publish(strong)
        time.sleep(0.02)
        return int(rig.state("input").values["refused"]) >= refused + 40

    rig.wait(are_refused, "the refusals")
    values = rig.state().values
    # A busy machine may stop the arm for a moment, but not for these.
    assert values["state"] != "latched"
    assert values["stops"].count("force_limit") == stops.count("force_limit")
    shared[0].wait_for_line("its stamp is 0")
    answered(lines_of(shared[0], "its stamp is 0")[0].partition(": ")[2])
    # The same force with a stamp that is right retreats at once.
    rig.force_n = 100.0
    rig.wait_for_reason("retreating", "force_limit")
    rig.force_n = 0.0


def test_no_limit_was_exceeded_in_any_of_this(rig: Rig) -> None:
    # Alone it looks at this motion, after the others at theirs, too.
    drive(rig)
    twists = np.array([command.twist for command in rig.commands])
    assert np.linalg.norm(twists[:, :3], axis=1).max() <= 0.05
    assert np.linalg.norm(twists[:, 3:], axis=1).max() <= 0.4


def test_speed_and_acceleration_are_those_of_the_parameters(network: Path) -> None:
    limits = {"maximum_linear_m_s": 0.002, "maximum_linear_m_s2": 0.1, "retreat_m_s": 0.001}
    with policy_and_rig(network, command_rate_hz=100.0, **limits) as (_, rig):
        rig.start()
        full_speed = pytest.approx(0.002)
        rig.wait(lambda: np.linalg.norm(rig.newest().twist[:3]) == full_speed, "the full speed")
        rig.enable(False)
        rig.rest_s(time.time())
        speeds_m_s = [np.linalg.norm(command.twist[:3]) for command in rig.commands]
        assert max(speeds_m_s) == full_speed
        moved = [command for command in rig.commands if command.moves()]
        for before, after in itertools.pairwise(moved):
            step_m_s = np.linalg.norm(after.twist[:3] - before.twist[:3])
            # A stamp is that of the message, which may come a little after the command's time.
            assert step_m_s <= 0.1 * (after.stamp_s - before.stamp_s + 0.005)


def test_it_stops_inside_of_the_workspace(network: Path) -> None:
    with policy_and_rig(network, workspace_m="[0.01, 0.01, 0.01]") as (_, rig):
        rig.start()
        start_m = rig.tool.position_m
        rig.wait_for_reason("latched", "workspace")
        assert (np.abs(rig.tool.position_m - start_m) < 0.005 + 0.002).all()
        assert not rig.newest().moves()


def test_interpolated_commands_come_at_100_hz_along_the_base(network: Path) -> None:
    parameters = {"command_rate_hz": 100.0, "command_frame": "link_base"}
    with policy_and_rig(network, **parameters) as (_, rig):
        rig.start()
        commands: list[Command] = []

        def is_steady() -> bool:
            begun_s = time.time()
            time.sleep(1.5)
            commands[:] = rig.after(begun_s)
            return 50.0 < rate_hz([command.stamp_s for command in commands]) < 104.0

        rig.wait(is_steady, "1.5 s of commands at their rate")
        assert {command.frame_id for command in commands} == {"link_base"}
        # The tool looks down: its +z is the base's -z.
        np.testing.assert_allclose(
            np.median([command.twist[:3] for command in commands], axis=0),
            (FOLLOWED[0], 0.0, -FOLLOWED[2]),
            atol=2e-4,
        )


def test_the_order_of_the_colours_is_that_of_the_encoding(rig: Rig) -> None:
    rig.start()
    distance = float(rig.state("inference").values["image_distance"])
    rig.encoding = "bgr8"
    time.sleep(0.5)
    # Read wrongly, the colours would differ from those of the idle image.
    assert float(rig.state("inference").values["image_distance"]) == distance
    rig.wait(lambda: rig.state().values["state"] == "running", "a steady motion")
    rig.encoding = "rgb8"


def test_compressed_images_do_as_well(network: Path) -> None:
    with policy_and_rig(network, compressed=True) as (_, rig):
        rig.start()
        followed = pytest.approx(FOLLOWED[0], abs=1e-4)
        rig.wait(lambda: rig.newest().twist[0] == followed, "the network's speed")


def test_without_resuming_a_cut_stream_needs_somebody(network: Path) -> None:
    with policy_and_rig(network, resume_when_fresh=False) as (_, rig):
        rig.calibrate()

        def is_running() -> bool:
            # What a busy machine sends late latches it, too.
            rig.enable()
            return rig.state().values.get("state") == "running"

        def cut_for() -> str:
            rig.wait(is_running, "a steady motion")
            rig.has_images = False
            rig.wait(lambda: rig.state().values["state"] == "latched", "the stop")
            rig.has_images = True
            return rig.state().values["reason"]

        rig.wait(lambda: cut_for() == "image_stale", "images to be missed")
        time.sleep(0.5)
        assert not rig.newest().moves()


BAD_POLICY = """
import time
from dotsim_ros.nodes.tactile_policy import node as tactile_policy
from dotsim_ros.nodes.common.spin import run_node
from dotsim_ros.control.policy.network import load_policy

def load_bad(folder, path):
    policy = load_policy(folder, path)
    ask = type(policy).__call__

    class Bad(type(policy)):
        def __call__(self, image, idle):
            # A crop whose first pixel is white stands for an overload, one of 1 for a runtime that
            # fails; at its start the node shows a black one.
            if image[0, 0].min() == 255:
                time.sleep(0.3)
            if (image[0, 0] == 1).all():
                raise RuntimeError("no memory is left")
            return ask(self, image, idle)

    policy.__class__ = Bad
    return policy

raise SystemExit(run_node(lambda: tactile_policy.TactilePolicy(load_bad)))
"""


def with_first_pixel(crop: np.ndarray, value: int) -> np.ndarray:
    """Return a crop by which `BAD_POLICY` knows what to do."""
    marked = crop.copy()
    marked[0, 0] = value
    return marked


def test_a_policy_that_does_not_keep_up_or_fails_stops_the_arm_and_is_told(network: Path) -> None:
    with policy_and_rig(network, code=BAD_POLICY) as (executable, rig):

        def stop(value: int) -> float:
            rig.start()
            begun_s = time.time()
            rig.crop = with_first_pixel(rig.idle, value)
            return rig.rest_s(begun_s) - begun_s

        # The last command in time may answer an image that came before.
        stopping_times_s(lambda: stop(255), limit_s=0.04 + 0.04 + STOP_S + SLACK_S)
        rig.wait_for_reason("stopped", "policy_late")
        executable.wait_for_line("inference: a deadline was missed by")
        rig.wait(
            lambda: int(rig.state("inference").values["deadline_misses_over_40_ms"]) > 2, "misses"
        )
        rig.crop = rig.idle
        rig.wait(lambda: rig.newest().moves(), "the motion to go on")
        stopping_times_s(lambda: stop(1), limit_s=STOP_S + SLACK_S)
        assert "no memory is left" in rig.wait_for_reason("latched", "policy_failed").message
        rig.crop = rig.idle
        assert not rig.newest().moves()


def cut_images(rig: Rig) -> float:
    rig.has_images = False
    time.sleep(0.05)
    return rig.last_image_s


def cut_poses(rig: Rig) -> float:
    rig.has_poses = False
    time.sleep(0.02)
    return rig.last_pose_s


def show(crop: Callable[[Rig], np.ndarray]) -> Callable[[Rig], float]:
    def spoil(rig: Rig) -> float:
        rig.crop = crop(rig)
        return rig.next_image_s()

    return spoil


def overload(rig: Rig) -> float:
    rig.crop = with_first_pixel(rig.idle, 255)
    # The image before is the last one that is answered in time, a little after it came.
    return rig.next_image_s()


def jump(lag_s: float) -> Callable[[Rig], float]:
    def spoil(rig: Rig) -> float:
        rig.image_lag_s = lag_s
        return rig.next_image_s()

    return spoil


def change_frame(rig: Rig) -> float:
    rig.image_frame = "other_optical_frame"
    return rig.next_image_s()


FAULTS: dict[str, Callable[[Rig], float]] = {
    "images cut": cut_images,
    "poses cut": cut_poses,
    "NaN": show(lambda rig: with_white_spot(rig.idle)),
    "another sensor": show(lambda rig: 255 - rig.idle),
    "policy overloaded": overload,
    "clock ahead": jump(-1.0),
    "clock back": jump(1.0),
    "frame changed": change_frame,
}
"""Inject a fault; return when the first message was sent that shows it, or the last before it."""


def test_many_faults_at_random_moments_all_stop_the_arm(network: Path) -> None:
    generator = np.random.default_rng(7)
    took_s: dict[str, list[float]] = {name: [] for name in FAULTS}
    names = list(itertools.islice(itertools.cycle(FAULTS), int(os.environ.get("DOTSIM_FAULTS", 8))))
    generator.shuffle(names)
    with policy_and_rig(network, code=BAD_POLICY) as (_, rig):

        def stop(fault: Callable[[Rig], float]) -> float:
            rig.start()
            time.sleep(generator.uniform(0.0, 0.1))
            since_s = fault(rig)
            return rig.rest_s(since_s) - since_s

        for name in names:
            stop_this = partial(stop, FAULTS[name])
            took_s[name] += stopping_times_s(stop_this, limit_s=STOP_S + SLACK_S)
    for name, times_s in took_s.items():
        in_time = sum(time_s <= STOP_S for time_s in times_s)
        worst_ms = 1e3 * max(times_s, default=0.0)
        print(f"{name}: {in_time} of {len(times_s)} within 80 ms, the slowest {worst_ms:.0f} ms")
    assert sum(map(len, took_s.values())) >= len(names)


SENSOR = """
import time, rclpy
from policy_rig import idle_crop
from sensor_msgs.msg import Image
import msg_adapters
rclpy.init()
node = rclpy.create_node("sensor")
images = node.create_publisher(Image, "image_raw", 5)
print("ready:", flush=True)
while True:
    images.publish(msg_adapters.encode_image(
        idle_crop(), encoding="rgb8", stamp_ns=time.time_ns(), frame_id="sensor"))
    time.sleep(0.04)
"""


def test_a_sensor_that_is_killed_stops_the_arm(
    network: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = str(Path(__file__).parent)
    monkeypatch.setenv("PYTHONPATH", f"{folder}:{Path(__file__).parents[2]}")
    with policy_and_rig(network) as (_, rig):
        # The rig's own sensor is off.
        rig.has_images = False
        rig.node.destroy_publisher(rig.images)
        namespace = rig.node.get_namespace()

        def stop() -> float:
            sensor = Executable("", code=SENSOR, arguments=("-r", f"__ns:={namespace}"))
            try:
                sensor.wait_for_line("ready:")
                rig.enable(False)
                rig.calibrate()
                rig.wait(lambda: rig.enable().success, "the start")
                rig.wait(lambda: rig.newest().moves(), "a motion")
                time.sleep(0.5)
                killed_s = time.time()
                sensor.process.kill()
                return rig.rest_s(killed_s) - killed_s
            finally:
                sensor.end()

        stopping_times_s(stop, limit_s=STOP_S + SLACK_S)
        rig.wait_for_reason("stopped", "image_stale")


def test_two_senders_on_a_topic_are_no_start(rig: Rig) -> None:
    rig.start()
    second = rig.node.create_publisher(PoseStamped, "ee_pose", 5)

    def is_refused() -> bool:
        # It may start before it knows of the second one.
        rig.enable(False)
        return "2 publishers" in rig.enable().message

    rig.wait(is_refused, "the refusal")
    rig.node.destroy_publisher(second)
    rig.wait(lambda: rig.enable().success, "the start")


def test_the_idle_image_is_not_taken_while_the_arm_moves(rig: Rig) -> None:
    rig.start()
    answer = rig.call(Trigger, "calibrate_idle")
    assert not answer.success
    assert "disable first" in answer.message
    assert "enabled already" in rig.enable().message


def test_poses_in_another_frame_are_refused_and_the_arm_stops(
    shared: tuple[Executable, Rig],
) -> None:
    executable, rig = shared
    rig.start()
    rig.pose_frame = "world"
    rig.wait_for_reason("stopped", "pose_stale")
    executable.wait_for_line("its frame is 'world', expected 'link_base'")
    assert int(rig.state("input").values["refused"]) > 0


def test_images_of_another_shape_are_latched(rig: Rig) -> None:
    rig.start()
    rig.crop = np.zeros((120, 200, 3), dtype=np.uint8)
    assert "160x120" in rig.wait_for_reason("latched", "wrong_sensor").message


@pytest.mark.parametrize("count", [1, 2])
def test_sigint_ends_it_with_status_0(network: Path, count: int) -> None:
    with policy_and_rig(network) as (executable, rig):
        rig.start()
        assert executable.interrupt(count) == 0, executable.log
        assert "Traceback" not in executable.log


def test_the_limits_do_not_change_while_it_runs(rig: Rig) -> None:
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    changed = Parameter("maximum_linear_m_s", value=0.04).to_parameter_msg()
    (result,) = rig.call(SetParameters, "set_parameters", parameters=[changed]).results
    assert not result.successful


def test_its_threads_have_the_priority_that_is_asked_for_or_it_is_refused(network: Path) -> None:
    node = Executable(MODULE, {"policy": network, "realtime_priority": 2})
    try:
        if not may_have_priority():
            assert node.exit_status() == 2
            assert "realtime_priority 2 is not allowed" in node.log
            return
        node.wait_for_line("ready:")
        threads = [int(path.name) for path in Path(f"/proc/{node.process.pid}/task").iterdir()]
        assert {os.sched_getparam(thread).sched_priority for thread in threads} == {2}
    finally:
        node.end()


def test_stamps_of_commands_run_on(rig: Rig) -> None:
    drive(rig)
    stamps_s = [command.stamp_s for command in rig.commands]
    assert all(later > earlier for earlier, later in itertools.pairwise(stamps_s))
