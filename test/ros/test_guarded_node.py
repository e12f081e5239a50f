# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A node whose callbacks fail goes on, says so, and answers."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
import rclpy
from harness import spin_in_background
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from std_msgs.msg import String
from std_srvs.srv import Trigger

from dotsim_ros.nodes.common.node import WorkingNode
from msg_adapters import Level


class Fragile(WorkingNode):
    """Fails at every message and every call but those that say "well"."""

    def __init__(self, context: rclpy.Context) -> None:
        override = "qos_overrides./first.publisher.reliability:=best_effort"
        super().__init__("fragile", context=context, cli_args=["--ros-args", "-p", override])
        self.heard: list[str] = []
        self.create_subscription(String, "words", self._on_words, 10)
        self.create_service(Trigger, "work", self._on_work)
        self.words = self.create_publisher(String, "words", 10)

    def _on_words(self, message: String) -> None:
        if message.data != "well":
            raise KeyError(message.data)
        self.heard.append(message.data)

    def _on_work(self, _request: Trigger.Request, _response: Trigger.Response) -> Trigger.Response:
        raise ValueError("there is nothing to do")


@pytest.fixture
def fragile() -> Iterator[Fragile]:
    context = rclpy.Context()
    rclpy.init(context=context)
    node = Fragile(context)
    thread = spin_in_background(node)
    yield node
    rclpy.try_shutdown(context=context)
    thread.join(10.0)
    node.destroy_node()


def wait(is_reached) -> None:
    end_s = time.monotonic() + 20.0
    while not is_reached():
        assert time.monotonic() < end_s
        time.sleep(0.01)


@pytest.mark.fault("messages", "a message makes a node's callback fail in a way nobody foresaw")
def test_a_message_that_breaks_a_callback_is_counted_and_the_next_one_heard(
    fragile: Fragile, answered
) -> None:
    assert fragile.failures.statuses("fragile") == []
    wait(lambda: fragile.words.get_subscription_count() > 0)
    for word in ("ill", "ill", "well"):
        fragile.words.publish(String(data=word))
    wait(lambda: fragile.heard)
    (status,) = fragile.failures.statuses("fragile")
    assert (status.name, status.level) == ("fragile: callbacks", Level.WARN)
    assert status.values["failures"] == "2"
    answered(status.message)


def test_a_parameter_that_the_node_does_not_have_is_refused_with_the_nearest_name(
    fragile: Fragile,
) -> None:
    fragile.declare_parameter("rate_hz", 1.0)
    client = fragile.create_client(SetParameters, "fragile/set_parameters")
    asked = [Parameter(name, value=2.0).to_parameter_msg() for name in ("ratehz", "rate_hz", "foo")]
    future = client.call_async(SetParameters.Request(parameters=asked))
    wait(future.done)
    assert [result.reason for result in future.result().results] == [
        "the node has no parameter 'ratehz': is it rate_hz?",
        "",
        "the node has no parameter 'foo'",
    ]
    assert fragile.get_parameter("rate_hz").value == 2.0


def test_a_call_that_breaks_a_callback_is_answered_with_the_reason(fragile: Fragile) -> None:
    client = fragile.create_client(Trigger, "work")
    future = client.call_async(Trigger.Request())
    wait(future.done)
    answer = future.result()
    assert not answer.success
    assert answer.message == "there is nothing to do"


def test_overriding_one_topic_leaves_the_others_as_they_were(fragile: Fragile) -> None:
    shared = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
    publishers = [
        fragile.create_publisher(
            String,
            topic,
            shared,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        for topic in ("first", "second")
    ]
    found = [publisher.qos_profile.reliability for publisher in publishers]
    assert found == [ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE]


@pytest.mark.fault("messages", "a publisher that offers less than a node's input asks for")
def test_an_input_takes_what_its_publishers_offer(fragile: Fragile, answered) -> None:
    heard: list[str] = []
    asked = QoSProfile(
        depth=10,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )
    fragile.create_subscription(String, "latched", lambda m: heard.append(m.data), asked)
    offered = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    weak = fragile.create_publisher(String, "latched", offered)
    # Each lack is seen by itself: the subscription is opened again twice.
    wait(weak.get_subscription_count)
    strong = fragile.create_publisher(
        String, "latched", QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
    )
    wait(strong.get_subscription_count)

    def all_heard() -> bool:
        # One of best effort may be lost.
        weak.publish(String(data="weak"))
        return "weak" in heard

    wait(all_heard)
    strong.publish(String(data="strong"))
    wait(lambda: "strong" in heard)
    assert fragile.count_subscribers("latched") == 1
    assert fragile.failures.statuses("fragile") == []

    # What cannot be asked for less is reported, with what cures it.
    lossless = QoSProfile(
        history=HistoryPolicy.KEEP_ALL, deadline=rclpy.duration.Duration(seconds=1)
    )
    fragile.create_subscription(String, "hurried", lambda m: heard.append(m.data), lossless)
    slow = fragile.create_publisher(String, "hurried", 10)
    wait(lambda: fragile.failures.statuses("fragile"))
    (status,) = fragile.failures.statuses("fragile")
    assert "nothing comes on hurried: a publisher offers another deadline" in status.message
    assert "qos_overrides./hurried.subscription.deadline" in status.message
    assert not slow.get_subscription_count()
    answered(status.message)


def test_a_time_that_no_stamp_holds_is_none(fragile: Fragile) -> None:
    now_ns = fragile.time_ns()
    assert abs(now_ns - time.time_ns()) < 10**9
    fragile.get_clock()._set_ros_time_is_active(True)
    assert fragile.time_ns() == 0
    for seconds, expected in ((5, 5 * 10**9), (2**31 - 1, 0)):
        fragile.get_clock().set_ros_time_override(
            rclpy.time.Time(seconds=seconds, clock_type=rclpy.clock.ClockType.ROS_TIME)
        )
        assert fragile.time_ns() == expected
