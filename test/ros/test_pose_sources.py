# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The indenter's pose from other simulators, TF and odometry, and the force that goes back."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped, WrenchStamped
from harness import (
    BASE_FRAME,
    PATIENCE_S,
    Client,
    Executable,
    LockstepPress,
    TactileFrame,
    assert_same,
    running,
)
from message_packages import importable
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from scipy.spatial.transform import Rotation

import msg_adapters

PARAMETERS = {
    "clock": "lockstep",
    "diagnostics_period_s": 0.1,
    "input_timeout_s": 0.5,
    # Where the indenter is depends on no grid; a coarse one is made in a tenth of the time.
    "grid_spacing_m": 0.0048,
}
ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
FAR = (0.0, 0.0, 0.065)
BASE_IN_WORLD_M = (0.5, -0.25, 0.125)
WORLD_IN_GAZEBO = Rotation.from_euler("x", 90.0, degrees=True)
PEG_CENTRE_M, SENSOR_CENTRE_M = (0.0, 0.0, 0.03), (0.01, 0.0, -0.02)
GAZEBO = {
    "world_frame": "gazebo_world",
    "entity_indenter": "'peg::link'",
    "entity_sensor": "'arm::tool'",
    "entity_indenter_centre_m": str(list(PEG_CENTRE_M)),
    "entity_sensor_centre_m": str(list(SENSOR_CENTRE_M)),
}


def transform(
    parent: str,
    child: str,
    position_m: Sequence[float],
    stamp_ns: int,
    quaternion_xyzw: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
) -> TransformStamped:
    """Return a transform as it is given, valid or not."""
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    message.header.stamp = msg_adapters.encode_stamp(stamp_ns)
    translation, rotation = message.transform.translation, message.transform.rotation
    translation.x, translation.y, translation.z = map(float, position_m)
    rotation.x, rotation.y, rotation.z, rotation.w = map(float, quaternion_xyzw)
    return message


class SimulatorPress(LockstepPress):
    """The press, moved by a simulator."""

    client: SourceClient


class SourceClient(Client):
    """A simulator: the same motions, by each source to the same bit.

    Positions are sums of few powers of two, so that frames that are moved by such ones are compared
    without rounding.
    """

    def __init__(self, source: str) -> None:
        super().__init__()
        self.source = source
        if source == "odometry":
            self._poses = self.node.create_publisher(Odometry, "indenter/odometry", ALL)
        elif source == "tf":
            self.tf = msg_adapters.message_class("tf2_msgs/msg/TFMessage")
            self._poses = self.node.create_publisher(self.tf, "/tf", ALL)
            self._static = self.node.create_publisher(self.tf, "/tf_static", LATCHED)

    def send(
        self,
        position_m: Sequence[float],
        *,
        stamp_ns: int | None = None,
        quaternion_xyzw: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        frame_id: str = BASE_FRAME,
        child_frame_id: str = "indenter",
        speed_m_s: float = 0.01,
    ) -> int:
        """See `Client.send`; a velocity where the source has one."""
        assert stamp_ns is not None
        finite = np.isfinite(position_m).all()
        at_m = np.round(np.array(position_m) * 2.0**30) / 2.0**30 if finite else position_m
        if self.source == "topic":
            return super().send(
                at_m, stamp_ns=stamp_ns, quaternion_xyzw=quaternion_xyzw, frame_id=frame_id
            )
        if self.source == "odometry":
            pose = msg_adapters.encode_pose_stamped(
                at_m, quaternion_xyzw, stamp_ns=stamp_ns, frame_id=frame_id
            )
            message = Odometry(header=pose.header, child_frame_id=child_frame_id)
            message.pose.pose = pose.pose
            message.twist.twist.linear.z = -speed_m_s
            self._poses.publish(message)
        else:
            in_world_m = np.array(at_m) + BASE_IN_WORLD_M
            self.send_transforms(
                transform("world", child_frame_id, in_world_m, stamp_ns, quaternion_xyzw)
            )
        return stamp_ns

    def send_transforms(self, *transforms: TransformStamped, static: bool = False) -> None:
        """Publish transforms in one message."""
        (self._static if static else self._poses).publish(self.tf(transforms=list(transforms)))

    def place_base(self, press: SimulatorPress) -> None:
        """By TF, say where the sensor is, and Gazebo's world, and wait until that is known."""
        if self.source != "tf":
            return
        self.send_transforms(
            transform("world", BASE_FRAME, BASE_IN_WORLD_M, 0),
            transform("gazebo_world", "world", (1.0, 2.0, 3.0), 0, WORLD_IN_GAZEBO.as_quat()),
            static=True,
        )
        self.wait(
            lambda: self.frames or not self.send(FAR, stamp_ns=press.next_stamp()), "a first frame"
        )

    def faults(self) -> dict[str, int]:
        """Return how often each fault has been counted."""
        values = self.state_from_now("input").values
        return {name: int(count) for name, count in values.items() if count.isdigit()}


@contextmanager
def simulator(source: str, **parameters: Any) -> Iterator[tuple[Executable, SourceClient]]:
    """Run a sensor that reads a source, and a simulator that has met it."""
    given = {**PARAMETERS, "pose_source": source, **parameters}
    with running(parameters=given) as executable, closing(SourceClient(source)) as client:
        client.meet()
        yield executable, client


@pytest.fixture(scope="module")
def reference() -> list[TactileFrame]:
    with simulator("topic") as (_, client):
        return SimulatorPress(client).run()


@pytest.fixture(scope="module")
def packages() -> Iterator[None]:
    with importable("tf2_msgs"), importable("ros_gz_interfaces"):
        yield


@pytest.fixture(scope="module")
def source(
    request: pytest.FixtureRequest, reference: list[TactileFrame]
) -> Iterator[tuple[Executable, SimulatorPress]]:
    """Run the sensor and a simulator, which by TF does not yet say where the sensor is; one after
    the other, since both have the same names."""
    if request.param == "tf":
        request.getfixturevalue("packages")
    parameters = GAZEBO if request.param == "tf" else {}
    with simulator(request.param, **parameters) as (executable, client):
        yield executable, SimulatorPress(client)


each_source = pytest.mark.parametrize("source", ["tf", "odometry"], indirect=True)
by_tf = pytest.mark.parametrize("source", ["tf"], indirect=True)


def sending(press: SimulatorPress, bad: Sequence[Callable[[int], object]]) -> Callable[[int], None]:
    """Return what sends one bad input after each frame of a press, a little after its stamp."""

    def send(index: int) -> None:
        if index < len(bad):
            bad[index](press.stamp_ns + 1_000_000)

    return send


def test_odometry_moves_the_indenter_on_between_its_messages() -> None:
    # First of all, since the sensor of the fixture `source` would answer in place of this one.
    # At a rate at which a busy machine, too, delivers whole frames.
    parameters = {"clock": "realtime", "input_timeout_s": 20.0, "rate_hz": 10.0}
    with simulator("odometry", **parameters) as (_, client):

        def next_height_m(below_m: float = 1.0) -> float:
            found = client.next_frame(
                lambda frame: (at_m := frame.indenter_m()) is not None and at_m[2] < below_m
            )
            return found.indenter_m()[2]

        # A message may come before node and client have found each other.
        for second in range(round(PATIENCE_S)):
            client.send((0.0, 0.0, 0.05), stamp_ns=(10 + second) * 10**9, speed_m_s=0.001)
            time.sleep(1.0)
            if any(frame.indenter_m() for frame in list(client.frames.values())):
                break
        assert next_height_m(below_m=0.0499) > 0.03
        # Not for ever: a simulator that has stopped must not move it on.
        assert client.set_parameters(input_timeout_s=0.15).successful
        # Frames, and on a busy machine messages, from before the change may still be on their way.
        end_s = time.monotonic() + PATIENCE_S
        before_m = next_height_m()
        while (now_m := next_height_m()) != before_m:
            assert time.monotonic() < end_s, "the indenter moves on"
            before_m = now_m


@by_tf
def test_a_missing_frame_is_named_until_it_comes(source: tuple[Executable, SimulatorPress]) -> None:
    executable, press = source
    client = press.client

    def wait_for(words: str) -> None:
        client.wait_for_state("input", lambda state: words in state.message)

    wait_for("do not place 'indenter' (indenter_frame) in 'densetact_base' (base_frame): no trans")
    client.send((0.0, 0.0, 0.05), stamp_ns=press.next_stamp(), child_frame_id="peg")
    wait_for("there is no frame 'densetact_base'; known are 'peg', 'world'")
    client.send((0.0, 0.0, 0.05), stamp_ns=press.next_stamp())
    client.send_transforms(transform("tool", BASE_FRAME, (0.0, 0.0, 0.0), 0), static=True)
    wait_for("'densetact_base' and 'indenter' are in two trees, below 'tool' and 'world'")
    assert "/tf and /tf_static do not place" in executable.log
    client.place_base(press)
    client.wait_for_state("input", lambda state: "do not place" not in state.message)


@each_source
def test_the_same_motion_gives_the_same_frames_to_the_bit(
    source: tuple[Executable, SimulatorPress], reference: list[TactileFrame]
) -> None:
    _, press = source
    press.client.place_base(press)
    assert_same(press.run(), reference)
    assert reference[3].force_n()[2] > 0.5


@each_source
def test_bad_input_in_the_middle_of_a_press_changes_nothing(
    source: tuple[Executable, SimulatorPress], reference: list[TactileFrame]
) -> None:
    _, press = source
    client = press.client
    client.place_base(press)
    deep, nowhere = (0.0, 0.0, 0.0145), (math.nan, 0.0, 0.0)
    bad: dict[str, list[Callable[[int], object]]] = {
        "odometry": [
            lambda stamp_ns: client.send(deep, stamp_ns=stamp_ns, speed_m_s=1e4),
            lambda stamp_ns: client.send(deep, stamp_ns=stamp_ns, frame_id="odom"),
            lambda stamp_ns: client.send(deep, stamp_ns=stamp_ns, child_frame_id="base_link"),
        ],
        "tf": [
            lambda ns: client.send_transforms(transform("world", "indenter", nowhere, ns)),
            lambda ns: client.send_transforms(transform("indenter", "world", deep, ns)),
            lambda ns: client.send(deep, stamp_ns=ns - 20_000_000),
        ],
    }
    counted, said = {
        "odometry": (
            {"invalid_numbers": 1, "wrong_frame": 2},
            "child_frame_id of the odometry is 'base_link', expected 'indenter'",
        ),
        "tf": (
            {"invalid_numbers": 2, "out_of_order": 1},
            "the transform of 'indenter' is stamped 0.019000 s before its last one",
        ),
    }[client.source]
    before = client.faults()
    assert_same(press.run(sending(press, bad[client.source])), reference)
    client.wait_for_state("input", lambda state: said in state.values["last_fault"])
    after = client.faults()
    assert {fault: after[fault] - before[fault] for fault in counted} == counted


@by_tf
def test_a_jump_and_a_clock_that_goes_back_are_new_starts(
    source: tuple[Executable, SimulatorPress], reference: list[TactileFrame]
) -> None:
    _, press = source
    client = press.client
    client.place_base(press)

    def wait_for(words: str) -> None:
        client.wait_for_state("input", lambda state: words in state.message)

    press.frame_at((0.0, 0.0, 0.0155))
    press.frame_at((0.05, 0.0, 0.0155))
    wait_for("the indenter jumped by 0.0500 m in 0.040 s, more than maximum_jump_m, 0.01 m")
    assert_same(press.run(), reference)
    press.stamp_ns -= 5_000_000_000
    client.frames.clear()
    press.frame_at((0.0, 0.0, 0.0155))
    wait_for("the clock of the poses went back by 4.960 s, more than maximum_step_s, 1 s")
    assert_same(press.run(), reference)


@by_tf
def test_the_force_goes_back_to_the_links(source: tuple[Executable, SimulatorPress]) -> None:
    _, press = source
    client = press.client
    client.place_base(press)
    heard: dict[str, Any] = {}
    for link in ("indenter", "sensor"):
        client.node.create_subscription(
            WrenchStamped,
            f"external_wrench/{link}",
            lambda message, link=link: heard.__setitem__(link, message),
            10,
        )
    entity = msg_adapters.message_class("ros_gz_interfaces/msg/EntityWrench")
    client.node.create_subscription(
        entity, "entity_wrench", lambda message: heard.__setitem__(message.entity.name, message), 10
    )
    client.wait(
        lambda: all(
            client.node.count_publishers(topic) and client.node.count_subscribers(topic)
            for topic in ("external_wrench/indenter", "external_wrench/sensor", "entity_wrench")
        ),
        "the wrenches",
    )
    press.frame_at((0.0, 0.0, 0.06))
    turn = Rotation.from_euler("xyz", [0.2, -0.1, 0.7])
    at_m = np.round(np.array([0.001, 0.0, 0.0148]) * 2.0**30) / 2.0**30
    wanted = {"indenter", "sensor", "peg::link", "arm::tool"}

    def pressed() -> int:
        return client.send(at_m, stamp_ns=press.next_stamp(), quaternion_xyzw=turn.as_quat())

    def all_heard(stamp_ns: int) -> bool:
        newest = list(heard.items())
        stamps_ns = {name: msg_adapters.message_stamp_ns(each) for name, each in newest}
        return stamps_ns == dict.fromkeys(wanted, stamp_ns)

    frame = client.whole_frame(pressed())
    pressed_s = time.monotonic()
    end_s = pressed_s + PATIENCE_S
    while not all_heard(frame.stamp_ns):
        assert time.monotonic() < end_s, f"waited {PATIENCE_S} s for all wrenches of a frame"
        time.sleep(0.01)
        # What the sensor knows of its readers comes on its own way: a frame may go without.
        if time.monotonic() - pressed_s > 1.0:
            frame = client.whole_frame(pressed())
            pressed_s = time.monotonic()
    force_n, torque_nm = msg_adapters.decode_wrench_stamped(frame.messages["wrench"])
    assert np.linalg.norm(force_n) > 0.2

    def expect(name: str, axes: Rotation, sign: float, about_m: np.ndarray) -> None:
        force, torque = msg_adapters.decode_wrench_stamped(heard[name])
        assert force == pytest.approx(sign * axes.apply(force_n), abs=1e-9)
        expected = sign * axes.apply(torque_nm - np.cross(about_m, force_n))
        assert torque == pytest.approx(expected, abs=1e-9)

    none = Rotation.identity()
    expect("indenter", turn.inv(), 1.0, at_m)
    expect("sensor", none, -1.0, np.zeros(3))
    expect("peg::link", WORLD_IN_GAZEBO, 1.0, at_m + turn.apply(PEG_CENTRE_M))
    expect("arm::tool", WORLD_IN_GAZEBO, -1.0, np.array(SENSOR_CENTRE_M))
    frames = {name: heard[name].header.frame_id for name in ("indenter", "sensor", "peg::link")}
    assert frames == {
        "indenter": "indenter",
        "sensor": BASE_FRAME,
        "peg::link": "gazebo_world",
    }
    assert heard["peg::link"].entity.type == heard["peg::link"].entity.LINK
