# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The control loop's safety, on simulated time: thousands of ticks with faults thrown in."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dotsim_ros.control.arm.command import ANGULAR, LINEAR
from dotsim_ros.control.safety_layer.arm_control import ArmControl, ControlSettings, Order
from dotsim_ros.control.safety_layer.freshness import HeardMessage, StreamWatch
from dotsim_ros.control.safety_layer.limits import Readings, Reason, SafetyLimits, State
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.twist import TwistFrame, advance
from dotsim_ros.nodes.common.beat import Beat
from dotsim_ros.nodes.tactile_policy.loops import InferenceLoop
from dotsim_ros.nodes.tactile_policy.parameters import TactilePolicyParameters

TICK_S = 0.01
LIMITS = SafetyLimits(force_limit_n=0.0)
WITH_FORCE = SafetyLimits(force_limit_n=2.0, force_release_share=0.75)
SIDEWAYS = np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.0])
EPOCH_NS = 1_700_000_000 * 10**9


def stamp_of(time_s: float) -> int:
    return EPOCH_NS + round(1e9 * time_s)


@dataclass
class Bench:
    """An arm that obeys at once, and streams that can be cut; time is counted in ticks."""

    control: ArmControl
    along_tool: bool = True
    tool: Pose = field(default_factory=lambda: Pose((0.3, 0.0, 0.2), (1.0, 0.0, 0.0, 0.0)))
    command: np.ndarray = field(default_factory=SIDEWAYS.copy)
    force_n: float = 0.0
    has_image: bool = True
    has_pose: bool = True
    has_force: bool = True
    has_policy: bool = True
    image_lag_s: float = 0.0
    pose_lag_s: float = 0.0
    force_lag_s: float = 0.0
    tick: int = 0
    image_s: float = -1.0
    orders: list[Order] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.image = StreamWatch("image", jump_s=0.5)
        self.pose = StreamWatch("pose", jump_s=0.5)
        self.force = StreamWatch("force", jump_s=0.5)

    @property
    def now_s(self) -> float:
        return TICK_S * self.tick

    def hear(self, watch: StreamWatch, lag_s: float = 0.0) -> None:
        heard, why = watch.hear(
            stamp_of(self.now_s - lag_s), arrival_s=self.now_s, clock_ns=stamp_of(self.now_s)
        )
        if heard is HeardMessage.JUMPED:
            self.control.latch(Reason.CLOCK_JUMP, why)

    def readings(self) -> Readings:
        return Readings(
            now_s=self.now_s,
            image=self.image.reading(self.now_s),
            pose=self.pose.reading(self.now_s),
            force=self.force.reading(self.now_s),
            tool=self.tool,
            force_n=self.force_n,
        )

    def step(self, count: int = 1) -> Order:
        for _ in range(count):
            self.tick += 1
            if self.has_pose:
                self.hear(self.pose, self.pose_lag_s)
            if self.tick % 4 == 0:
                if self.has_image:
                    self.hear(self.image, self.image_lag_s)
                    self.image_s = self.now_s
                if self.has_force:
                    self.hear(self.force, self.force_lag_s)
            if self.has_policy and self.now_s - self.image_s == pytest.approx(2 * TICK_S):
                self.control.put(self.command, self.now_s, image_s=self.image_s)
            order = self.control.tick(self.readings())
            self.orders.append(order)
            self.tool = advance(
                self.tool,
                order.twist[LINEAR],
                order.twist[ANGULAR],
                duration_s=TICK_S,
                along=TwistFrame.OWN if self.along_tool else TwistFrame.PARENT,
            )
        return self.orders[-1]

    def start(self) -> None:
        self.step(10)
        self.control.enable(self.readings())
        assert self.step(20).state is State.RUNNING

    def ticks_to_rest(self) -> int:
        for count in range(1, 100):
            if not self.step().twist.any():
                return count
        raise AssertionError("the arm never stops")


def bench(limits: SafetyLimits = LIMITS, **given) -> Bench:
    settings = ControlSettings(**{"command_rate_hz": 100.0, **given})
    return Bench(ArmControl(limits, settings), settings.along_tool)


def test_it_is_off_at_start_and_follows_the_policy_once_enabled():
    rig = bench()
    rig.step(50)
    assert {order.state for order in rig.orders} == {State.DISABLED}
    assert not any(order.twist.any() for order in rig.orders)
    rig.start()
    np.testing.assert_allclose(rig.step().twist, SIDEWAYS)
    rig.control.disable()
    assert rig.ticks_to_rest() <= 2
    assert rig.step().state is State.DISABLED


@pytest.mark.parametrize("missing", ["image", "pose", "force"])
def test_it_cannot_be_enabled_without_its_streams_or_under_force(missing):
    rig = bench(WITH_FORCE)
    setattr(rig, f"has_{missing}", False)
    rig.step(50)
    with pytest.raises(ValueError, match=f"no {missing} has come"):
        rig.control.enable(rig.readings())
    assert rig.control.state is State.DISABLED
    setattr(rig, f"has_{missing}", True)
    rig.force_n = 1.8
    rig.step(50)
    with pytest.raises(ValueError, match=r"1\.80 N already"):
        rig.control.enable(rig.readings())


@pytest.mark.parametrize(
    ("cut", "reason"),
    [
        ("has_image", Reason.IMAGE_STALE),
        ("has_pose", Reason.POSE_STALE),
        ("has_policy", Reason.POLICY_LATE),
        ("has_force", Reason.FORCE_STALE),
    ],
)
@pytest.mark.parametrize(("phase", "speed"), [(0, 0.001), (1, 0.02), (3, 0.05)])
def test_what_goes_silent_stops_the_arm_in_time_and_going_on_resumes(cut, reason, phase, speed):
    limits = replace(WITH_FORCE, workspace_m=(2.0, 2.0, 2.0))
    rig = bench(limits, command_rate_hz=25.0)
    rig.command = speed * SIDEWAYS / 0.02
    rig.start()
    rig.step(phase)
    watch = {"has_pose": rig.pose, "has_force": rig.force}.get(cut, rig.image)
    setattr(rig, cut, False)
    rig.ticks_to_rest()
    if cut == "has_policy":
        # Its last command came at most one cycle before the cut.
        assert rig.now_s <= TICK_S * (30 + phase) + limits.stop_within_s
    else:
        assert watch.reading(rig.now_s).age_s <= limits.stop_within_s
    assert rig.orders[-1].state is State.STOPPED
    assert rig.orders[-1].reason is reason
    assert rig.orders[-1].detail
    assert not rig.step(100).twist.any()
    setattr(rig, cut, True)
    assert rig.step(20).state is State.RUNNING
    assert rig.orders[-1].twist.any()


def test_one_silence_is_one_stop_and_the_policy_is_not_blamed_afterwards():
    rig = bench(replace(LIMITS, workspace_m=(2.0, 2.0, 2.0)))
    rig.command = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    rig.start()
    rig.orders.clear()
    rig.has_image = False
    rig.step(300)
    rig.has_image = True
    rig.step(30)
    seen = [(order.state, order.reason) for order in rig.orders]
    changes = [now for before, now in itertools.pairwise(seen) if now != before]
    assert changes == [(State.STOPPED, Reason.IMAGE_STALE), (State.RUNNING, Reason.NONE)]
    # A steady stream never counts as cut.
    rig.orders.clear()
    rig.step(500)
    assert {order.state for order in rig.orders} == {State.RUNNING}


def test_without_resuming_a_silence_is_latched():
    rig = bench(replace(LIMITS, resume_when_fresh=False))
    rig.start()
    rig.has_image = False
    rig.step(20)
    rig.has_image = True
    order = rig.step(100)
    assert (order.state, order.reason) == (State.LATCHED, Reason.IMAGE_STALE)
    rig.control.enable(rig.readings())
    assert rig.step(10).state is State.RUNNING


@pytest.mark.parametrize(
    ("stream", "reason"),
    [
        ("image", Reason.IMAGE_DELAYED),
        ("pose", Reason.POSE_DELAYED),
        ("force", Reason.FORCE_STALE),
    ],
)
def test_old_messages_stop_it_although_they_come_in_time(stream: str, reason: Reason) -> None:
    rig = bench(WITH_FORCE)
    rig.start()
    # Little by little, as a queue grows: no jump of the stamps.
    for lag_s in np.arange(0.0, 0.32, 0.005):
        setattr(rig, f"{stream}_lag_s", float(lag_s))
        rig.step()
    assert not rig.orders[-1].twist.any()
    assert (rig.orders[-1].state, rig.orders[-1].reason) == (State.STOPPED, reason)
    assert f"the newest {stream} came 0.2" in rig.orders[-1].detail
    assert "after the time of its stamp" in rig.orders[-1].detail


@dataclass
class SpoiltPolicy:
    """Answers what it is told to, or fails with it."""

    distance: Any = 0.5
    command: Any = None

    def image_distance(self, image: np.ndarray, idle: np.ndarray) -> float:
        return answer_of(self.distance)

    def __call__(self, image: np.ndarray, idle: np.ndarray) -> np.ndarray:
        return answer_of(self.command)


def answer_of(answer: Any) -> Any:
    if isinstance(answer, Exception):
        raise answer
    return answer


@pytest.mark.parametrize(
    ("policy", "reason", "words"),
    [
        (SpoiltPolicy(command=RuntimeError("no kernel")), Reason.POLICY_FAILED, "no kernel"),
        (SpoiltPolicy(distance=MemoryError("all gone")), Reason.POLICY_FAILED, "all gone"),
        (SpoiltPolicy(command=ValueError("3 by 2 px")), Reason.WRONG_SENSOR, "3 by 2 px"),
        (SpoiltPolicy(distance=1.1), Reason.WRONG_SENSOR, "1.1 away from those of the training"),
        (SpoiltPolicy(distance=np.nan), Reason.WRONG_SENSOR, "nan away from those of the training"),
        (SpoiltPolicy(command=np.full(6, np.nan)), Reason.NOT_FINITE, "nan"),
        (SpoiltPolicy(command=np.array([0, 0, 0, 0, 0, -np.inf])), Reason.NOT_FINITE, "inf"),
    ],
)
def test_a_policy_that_fails_is_latched_and_its_last_command_is_not_given_any_more(
    policy: SpoiltPolicy, reason: Reason, words: str
) -> None:
    rig = bench()
    rig.start()
    image = SimpleNamespace(pixels=lambda: np.zeros((2, 3, 3), np.uint8), arrival_s=rig.now_s)
    node = SimpleNamespace(
        now_s=lambda: rig.now_s, compute=lambda latency, work, take, broken: take(work())
    )
    loop = InferenceLoop(
        node,  # type: ignore[arg-type]
        TactilePolicyParameters(maximum_image_distance=1.0),
        SimpleNamespace(image_after=lambda last, until_s: image),  # type: ignore[arg-type]
        rig.control,
        Beat(0.04, ticks=4, start_s=rig.now_s, margin_s=0.005),
        policy,  # type: ignore[arg-type]
    )
    loop.idle = np.zeros((2, 3, 3), np.uint8)
    loop.run(rig.now_s)
    assert loop.taken == 0
    rig.ticks_to_rest()
    assert (rig.orders[-1].state, rig.orders[-1].reason) == (State.LATCHED, reason)
    assert words in rig.orders[-1].detail
    assert not rig.step(100).twist.any()


@pytest.mark.parametrize("lag_s", [-0.7, 0.7])
def test_a_clock_that_jumps_is_latched(lag_s):
    rig = bench()
    rig.start()
    rig.image_lag_s = lag_s
    rig.step(5)
    assert (rig.orders[-1].state, rig.orders[-1].reason) == (State.LATCHED, Reason.CLOCK_JUMP)
    rig.image_lag_s = 0.0
    assert not rig.step(100).twist.any()
    rig.control.enable(rig.readings())
    assert rig.step(10).state is State.RUNNING


STREAMS = {
    "two change places, then the stamps run back": [
        (1.0, 1.0, 0.0, HeardMessage.NEW),
        (0.99, 1.02, 0.0, HeardMessage.NOTHING_NEW),
        (0.97, 1.04, 0.0, HeardMessage.JUMPED),
    ],
    "it is held up and catches up": [
        (1.0, 1.0, 0.0, HeardMessage.NEW),
        (1.04, 1.9, 0.0, HeardMessage.NEW),
        (1.9, 1.93, 0.0, HeardMessage.NEW),
    ],
    "the machine's time is set and the stamps follow": [
        (1.0, 1.0, 0.0, HeardMessage.NEW),
        (3.04, 1.04, 2.0, HeardMessage.JUMPED),
        (3.08, 1.08, 2.0, HeardMessage.NEW),
    ],
    "one image is repeated": [
        (1.0, 1.0, 0.0, HeardMessage.NEW),
        (1.0, 1.04, 0.0, HeardMessage.NOTHING_NEW),
    ],
}
"""Stamp, arrival, by how much the machine's time is ahead of the steady clock, and what it is."""


@pytest.mark.parametrize("name", STREAMS)
def test_what_a_message_is_to_its_stream(name):
    watch = StreamWatch("image", jump_s=0.5)
    last_s = 0.0
    for stamp_s, arrival_s, ahead_s, expected in STREAMS[name]:
        clock_ns = stamp_of(arrival_s + ahead_s)
        found, why = watch.hear(stamp_of(stamp_s), arrival_s=arrival_s, clock_ns=clock_ns)
        assert found is expected
        assert bool(why) == (expected is HeardMessage.JUMPED)
        if expected is not HeardMessage.NOTHING_NEW:
            last_s = arrival_s
            delay_s = watch.reading(arrival_s).delay_s
            assert delay_s == pytest.approx(arrival_s + ahead_s - stamp_s)
        assert watch.reading(arrival_s).age_s == pytest.approx(arrival_s - last_s)


def test_a_tick_at_no_later_time_changes_nothing():
    rig = bench()
    rig.start()
    rig.command = np.zeros(6)
    rig.step(2)
    before = rig.control.tick(rig.readings()).twist
    np.testing.assert_array_equal(rig.control.tick(rig.readings()).twist, before)


def test_a_command_for_an_old_image_is_not_taken():
    control = ArmControl(LIMITS, ControlSettings())
    assert control.put(SIDEWAYS, 1.0, image_s=0.95)
    assert not control.put(SIDEWAYS, 1.0, image_s=0.9)


@pytest.mark.parametrize(
    ("frame", "axis", "sign"),
    [("link_tcp", 0, 1.0), ("link_tcp", 2, -1.0), ("link_base", 1, -1.0), ("link_base", 2, 1.0)],
)
def test_it_stops_inside_of_the_workspace(frame, axis, sign):
    rig = bench(command_frame=frame)
    rig.command = np.zeros(6)
    rig.start()
    start_m = rig.tool.position_m
    rig.command[axis] = 0.04 * sign
    for _ in range(400):
        if rig.step().state is State.LATCHED:
            break
    rig.step(20)
    assert (rig.orders[-1].state, rig.orders[-1].reason) == (State.LATCHED, Reason.WORKSPACE)
    assert (np.abs(rig.tool.position_m - start_m) <= LIMITS.half_box_m).all()
    # It used what it was given.
    assert np.abs(rig.tool.position_m - start_m)[axis] > 0.7 * LIMITS.half_box_m[axis]


def test_a_tool_that_is_somewhere_else_or_turns_too_far_is_latched():
    rig = bench(hold_orientation=False)
    rig.command = np.array([0.0, 0.0, 0.0, 0.3, 0.0, 0.0])
    rig.start()
    rig.step(200)
    assert rig.orders[-1].reason is Reason.WORKSPACE
    assert "turned by" in rig.orders[-1].detail
    rig.command = np.zeros(6)
    rig.start()
    rig.tool = Pose((0.5, 0.0, 0.2), rig.tool.quaternion_xyzw)
    assert rig.step().reason is Reason.WORKSPACE


def test_the_orientation_is_held_against_the_policy():
    held, free = bench(), bench(hold_orientation=False)
    for rig in (held, free):
        rig.command = np.array([0.0, 0.0, 0.0, 0.0, 0.05, 0.0])
        rig.start()
        rig.start_turn = rig.tool
        rig.step(300)
    turns = [
        2.0 * np.arccos(abs(rig.tool.quaternion_xyzw @ np.array([1.0, 0.0, 0.0, 0.0])))
        for rig in (held, free)
    ]
    assert turns[0] == pytest.approx(0.05 / 2.0, rel=0.05)
    assert turns[1] > 0.14


def test_a_force_above_the_limit_retreats_until_it_is_released():
    rig = bench(WITH_FORCE)
    rig.start()
    before_m = rig.tool.position_m
    rig.force_n = 2.1
    order = rig.step(10)
    assert (order.state, order.reason) == (State.RETREATING, Reason.FORCE_LIMIT)
    np.testing.assert_allclose(order.twist, [0, 0, -WITH_FORCE.retreat_m_s, 0, 0, 0], atol=1e-12)
    rig.force_n = 1.7
    assert rig.step(10).state is State.RETREATING
    rig.force_n = 1.4
    assert rig.step(10).state is State.RUNNING
    # The tool looks down, so away from the contact is up.
    assert rig.tool.position_m[2] > before_m[2] + 0.001


def test_a_retreat_needs_no_image_and_is_latched_where_it_does_not_help():
    rig = bench(WITH_FORCE)
    rig.start()
    rig.force_n = 3.0
    rig.step(2)
    rig.has_image = False
    assert rig.step(50).state is State.RETREATING
    rig.has_pose = False
    assert rig.step(10).reason is Reason.POSE_STALE
    rig.has_image = rig.has_pose = True
    rig.step(400)
    assert rig.orders[-1].reason is Reason.RETREAT_FAILED
    assert not rig.orders[-1].twist.any()


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"maximum_linear_m_s2": 0.5}, "brakes for 0.100 s"),
        ({"maximum_angular_rad_s2": 4.0}, "brakes for 0.100 s"),
        ({"retreat_m_s": 0.1}, "faster than the arm's"),
    ],
)
def test_limits_that_contradict_are_refused(changes, reason):
    with pytest.raises(ValueError, match=reason):
        replace(LIMITS, **changes)


@pytest.mark.parametrize(
    ("seed", "frame", "rate_hz"),
    [
        (0, "link_tcp", 100.0),
        (1, "link_tcp", 25.0),
        (2, "link_base", 100.0),
        (3, "link_base", 25.0),
    ],
)
def test_no_limit_is_ever_exceeded_whatever_happens(seed, frame, rate_hz):
    generator = np.random.default_rng(seed)
    rig = bench(WITH_FORCE, command_frame=frame, command_rate_hz=rate_hz)
    rig.start()
    home_m = rig.tool.position_m
    for _ in range(100):
        rig.command = generator.normal(0.0, [0.1] * 3 + [1.0] * 3)
        if generator.random() < 0.02:
            rig.command[generator.integers(6)] = generator.choice([np.nan, np.inf])
        rig.has_image, rig.has_pose, rig.has_force, rig.has_policy = generator.random(4) < 0.95
        rig.force_n = float(generator.choice([0.0, 2.5], p=[0.95, 0.05]))
        rig.step(int(generator.integers(1, 12)))
        if rig.control.state is State.LATCHED:
            rig.has_image = rig.has_pose = rig.has_force = True
            rig.force_n, rig.command = 0.0, np.zeros(6)
            rig.step(8)
            home_m = rig.tool.position_m
            rig.control.enable(rig.readings())
        # A retreat alone may leave the box, by its own length.
        room_m = rig.control.limits.half_box_m + rig.control.limits.retreat_m
        assert (np.abs(rig.tool.position_m - home_m) <= room_m).all()
    twists = np.array([order.twist for order in rig.orders])
    steps = np.diff(twists, axis=0)
    assert {State.RUNNING, State.STOPPED, State.LATCHED} <= {order.state for order in rig.orders}
    for half, speed, rate in (
        (LINEAR, LIMITS.tool.linear_m_s, LIMITS.tool.linear_m_s2),
        (ANGULAR, LIMITS.tool.angular_rad_s, LIMITS.tool.angular_rad_s2),
    ):
        assert np.linalg.norm(twists[:, half], axis=1).max() <= speed * (1 + 1e-9)
        assert np.linalg.norm(steps[:, half], axis=1).max() <= rate * TICK_S * (1 + 1e-6)
