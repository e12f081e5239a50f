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
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, WrenchStamped
from harness import Executable, measured_until
from hostile import lines_of
from policy_rig import (
    FOLLOWED,
    MODULE,
    Command,
    Rig,
    idle_crop,
    policy_and_rig,
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


@pytest.fixture(scope="module")
def shared(network: Path) -> Iterator[tuple[Executable, Rig]]:
    """A node at 25 commands a second that reads the force; faults are mended by `start`."""
    given = {"force_limit_n": 2.0, "retreat_m": 0.2}
    with policy_and_rig(network, code=BAD_POLICY, **given) as (executable, rig):
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
        time.sleep(2.0)
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

    rig.wait(is_steady, "2 s in which images are rarely late and the rates are kept")
    np.testing.assert_allclose(np.median(moving, axis=0)[:3], FOLLOWED[:3], atol=5e-5)


def test_disabled_it_goes_on_with_zeros(rig: Rig) -> None:
    def stop() -> float:
        rig.start()
        begun_s = time.time()
        assert rig.enable(False).success
        return rig.rest_s(begun_s) - begun_s

    measured_until(stop, below=SLACK_S, never=1.0)
    stopped_s = time.time()
    rig.wait(lambda: len(rig.after(stopped_s)) > 5, "more commands")
    assert not any(command.moves() for command in rig.after(stopped_s))
    rig.wait(lambda: rig.state().values["state"] == "disabled", "the state to be told")


IDLE = idle_crop()
FAULTS: dict[str, tuple[dict[str, Any], str, str, str]] = {
    "images cut": ({"has_images": False}, "stopped", "image_stale", "ms ago"),
    "poses cut": ({"has_poses": False}, "stopped", "pose_stale", "ms ago"),
    "NaN": ({"crop": with_white_spot(IDLE)}, "latched", "not_finite", "nan"),
    "another sensor": ({"crop": 255 - IDLE}, "latched", "wrong_sensor", "another"),
    "another shape": (
        {"crop": np.zeros((120, 200, 3), dtype=np.uint8)},
        "latched",
        "wrong_sensor",
        "160x120",
    ),
    "policy fails": (
        {"crop": with_first_pixel(IDLE, 1)},
        "latched",
        "policy_failed",
        "no memory is left",
    ),
    # The image before is the last one that is answered in time, a little after it came.
    "policy overloaded": (
        {"crop": with_first_pixel(IDLE, 255)},
        "stopped",
        "policy_late",
        "does not keep up",
    ),
    "clock ahead": ({"image_lag_s": -1.0}, "latched", "clock_jump", "image: the stamp"),
    "clock back": ({"image_lag_s": 1.0}, "latched", "clock_jump", "image: the stamp"),
    "frame changed": (
        {"image_frame": "other_optical_frame"},
        "latched",
        "wrong_sensor",
        "other_optical_frame",
    ),
}
"""What of the rig is spoilt; the state, the reason and a part of its words."""


def spoil(rig: Rig, changes: dict[str, Any]) -> float:
    """Bring a fault about; return when the first message was sent that shows it, or the last
    before it."""
    for name, value in changes.items():
        setattr(rig, name, value)
    if "has_images" not in changes and "has_poses" not in changes:
        return rig.next_image_s()
    time.sleep(0.05)
    return rig.last_image_s if "has_images" in changes else rig.last_pose_s


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_at_a_random_moment_stops_the_arm_in_time(rig: Rig, name: str) -> None:
    generator = np.random.default_rng(list(FAULTS).index(name))
    changes, state, reason, words = FAULTS[name]

    def stop() -> float:
        rig.start()
        time.sleep(generator.uniform(0.0, 0.1))
        since_s = spoil(rig, changes)
        return rig.rest_s(since_s) - since_s

    count = max(1, int(os.environ.get("DOTSIM_FAULTS", "0")) // len(FAULTS))
    times_s = [
        time_s
        for _ in range(count)
        for time_s in measured_until(stop, below=STOP_S + SLACK_S, never=1.0)
    ]
    in_time = sum(time_s <= STOP_S for time_s in times_s)
    print(f"{in_time} of {len(times_s)} within 80 ms, the slowest {1e3 * max(times_s):.0f} ms")
    assert words in rig.wait_for_reason(state, reason).message
    assert all(np.isfinite(command.twist).all() for command in rig.commands)
    rig._mend()
    if state == "stopped":
        rig.wait(lambda: rig.newest().moves(), "the motion to go on")
    else:
        time.sleep(0.3)
        assert not rig.newest().moves()


def test_misses_of_an_overloaded_policy_are_told(shared: tuple[Executable, Rig]) -> None:
    executable, rig = shared
    rig.start()
    rig.crop = with_first_pixel(rig.idle, 255)
    executable.wait_for_line("inference: a deadline was missed by")
    rig.wait(lambda: int(rig.state("inference").values["deadline_misses_over_40_ms"]) > 2, "misses")


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
    # The same force with a stamp that is right retreats at once, along the tool.
    rig.force_n = 100.0
    rig.wait_for_reason("retreating", "force_limit")
    back = [0.0, 0.0, -0.01, 0.0, 0.0, 0.0]
    rig.wait(lambda: np.allclose(rig.newest().twist, back, rtol=0.0, atol=1e-9), "the retreat")
    rig.force_n = 0.5
    rig.wait(lambda: rig.newest().twist[2] > 0.0, "the motion to go on")


def test_limits_of_speed_acceleration_and_place_are_those_of_the_parameters(network: Path) -> None:
    limits = {"maximum_linear_m_s": 0.002, "maximum_linear_m_s2": 0.1, "retreat_m_s": 0.001}
    box = {"workspace_m": "[0.006, 0.006, 0.006]"}
    with policy_and_rig(network, command_rate_hz=100.0, **limits, **box) as (_, rig):
        rig.start()
        start_m = rig.tool.position_m
        full_speed = pytest.approx(0.002)
        rig.wait(lambda: np.linalg.norm(rig.newest().twist[:3]) == full_speed, "the full speed")
        rig.wait_for_reason("latched", "workspace")
        rig.rest_s(time.time())
        assert (np.abs(rig.tool.position_m - start_m) < 0.003 + 0.002).all()
        speeds_m_s = [np.linalg.norm(command.twist[:3]) for command in rig.commands]
        assert max(speeds_m_s) == full_speed
        moved = [command for command in rig.commands if command.moves()]
        for before, after in itertools.pairwise(moved):
            step_m_s = np.linalg.norm(after.twist[:3] - before.twist[:3])
            # A stamp is that of the message, which may come a little after the command's time.
            assert step_m_s <= 0.1 * (after.stamp_s - before.stamp_s + 0.005)


def test_another_use_of_the_node(network: Path) -> None:
    """Compressed images, no force, interpolated commands along the base, stops that are latched,
    and an end by two signals."""
    parameters = {
        "compressed": True,
        "has_forces": False,
        "force_limit_n": 0.0,
        "command_rate_hz": 100.0,
        "command_frame": "link_base",
        "resume_when_fresh": False,
    }
    with policy_and_rig(network, **parameters) as (executable, rig):
        executable.wait_for_line("force_limit_n is 0: nothing limits the force; set it for")
        rig.calibrate()
        assert "nothing limits the force" in rig.state("input").message

        def is_running() -> bool:
            # What a busy machine sends late latches it, too.
            rig.enable()
            return rig.state().values.get("state") == "running"

        commands: list[Command] = []

        def is_steady() -> bool:
            rig.wait(is_running, "a steady motion")
            begun_s = time.time()
            time.sleep(1.0)
            commands[:] = [each for each in rig.after(begun_s) if each.moves()]
            return len(commands) > 2 and 50.0 < rate_hz([c.stamp_s for c in commands]) < 104.0

        rig.wait(is_steady, "a second of commands at their rate")
        assert {command.frame_id for command in commands} == {"link_base"}
        # The tool looks down: its +z is the base's -z.
        np.testing.assert_allclose(
            np.median([command.twist[:3] for command in commands], axis=0),
            (FOLLOWED[0], 0.0, -FOLLOWED[2]),
            atol=2e-4,
        )

        def cut_for() -> str:
            rig.wait(is_running, "a steady motion")
            rig.has_images = False
            rig.wait(lambda: rig.state().values["state"] == "latched", "the stop")
            rig.has_images = True
            return rig.state().values["reason"]

        rig.wait(lambda: cut_for() == "image_stale", "images to be missed")
        time.sleep(0.5)
        assert not rig.newest().moves()
        assert executable.interrupt(2) == 0, executable.log
        assert "Traceback" not in executable.log


def test_the_order_of_the_colours_is_that_of_the_encoding(rig: Rig) -> None:
    rig.start()
    distance = float(rig.state("inference").values["image_distance"])
    rig.encoding = "bgr8"
    time.sleep(0.5)
    # Read wrongly, the colours would differ from those of the idle image.
    assert float(rig.state("inference").values["image_distance"]) == distance
    rig.wait(lambda: rig.state().values["state"] == "running", "a steady motion")


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
    answer = rig.call(Trigger, "tactile_policy/calibrate_idle")
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


def test_the_limits_do_not_change_while_it_runs(rig: Rig) -> None:
    assert not rig.set_parameters_of("tactile_policy", maximum_linear_m_s=0.04).successful


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


def test_no_limit_was_exceeded_in_any_of_this_and_stamps_run_on(rig: Rig) -> None:
    # Alone it looks at this motion, after the others at theirs, too.
    drive(rig)
    twists = np.array([command.twist for command in rig.commands])
    assert np.linalg.norm(twists[:, :3], axis=1).max() <= 0.05
    assert np.linalg.norm(twists[:, 3:], axis=1).max() <= 0.4
    stamps_s = [command.stamp_s for command in rig.commands]
    assert all(later > earlier for earlier, later in itertools.pairwise(stamps_s))
