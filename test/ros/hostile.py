# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a node is sent that it must refuse: values of parameters of every type, and messages."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import psutil
import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from harness import Executable, spin_in_background
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
)
from sensor_msgs.msg import Image
from std_msgs.msg import Header

ANSWER_S = 20.0
"""The longest that a node may take to answer, on a busy machine."""
GROWTH_BYTES = 150e6
LONG = "x" * 20_000
BOMB = "{a: &a [x, x, x, x, x, x, x, x, x], b: &b [*a, *a, *a, *a, *a, *a, *a, *a, *a], c: &c [*b, \
*b, *b, *b, *b, *b, *b, *b, *b], d: &d [*c, *c, *c, *c, *c, *c, *c, *c, *c], e: &e [*d, *d, *d, \
*d, *d, *d, *d, *d, *d], f: &f [*e, *e, *e, *e, *e, *e, *e, *e, *e], kind: [*f, *f, *f, *f, *f]}"
TEXTS = (
    "",
    " ",
    "\0",
    "\n",
    "../../../../etc/passwd",
    "/no/such/file.stl",
    "/",
    "/dev/zero",
    "/etc/passwd",
    "/dev/zero.yaml",
    "{",
    "{}",
    "{kind: [1]}",
    "{kind: {a: 1}}",
    "{kind: null}",
    "{kind: sphere, radius_m: [1]}",
    "{kind: sphere, radius_m: .nan}",
    "{kind: sphere, radius_m: 1e999}",
    "{kind: sphere, radius: 1}",
    "{kind: box, size_m: [1, [2], 3]}",
    "{kind: mesh, path: /etc}",
    "{kind: mesh, path: [1]}",
    "{kind: mesh, path: /dev/zero}",
    "{? [1]: 2, kind: sphere}",
    "{1: 2}",
    "{kind: !!python/object/apply:os.getpid []}",
    "{kind: sphere, kind: sphere}",
    "{" + "[" * 3000,
    "{kind: " + "[" * 3000 + "]" * 3000 + "}",
    BOMB,
    LONG,
    "{" + LONG,
    "\N{BLACK STAR}" * 1000,
    "null",
    "nan",
)
"""None is the name of a choice, a frame, or a file that any parameter could take."""
NUMBERS = (math.nan, math.inf, -math.inf, 1e308, -1e308, 1e7, -11.0)
WHOLE_NUMBERS = (2**63 - 1, -(2**63), -2, 1_000_000)


def hostile_values() -> list[ParameterValue]:
    """Return values of every type that no parameter of ours takes."""
    values = [ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=t) for t in TEXTS]
    values += [
        ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=number)
        for number in NUMBERS
    ]
    values += [
        ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=number)
        for number in WHOLE_NUMBERS
    ]
    for numbers in ([], [1e308] * 3, [math.nan] * 4, [math.nan] * 7, [0.5], [0.1] * 20_000):
        values.append(
            ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=numbers)
        )
    for whole in ([], [-1, -1], [16384, 16384], [1, 0], [2**62] * 4, [5, 5, 5, 0], [7] * 20_000):
        values.append(
            ParameterValue(type=ParameterType.PARAMETER_INTEGER_ARRAY, integer_array_value=whole)
        )
    for texts in ([], [""], ["bad name=x"], [LONG]):
        values.append(
            ParameterValue(type=ParameterType.PARAMETER_STRING_ARRAY, string_array_value=texts)
        )
    values.append(
        ParameterValue(type=ParameterType.PARAMETER_BYTE_ARRAY, byte_array_value=[b"\xff"])
    )
    values.append(ParameterValue(type=ParameterType.PARAMETER_BOOL_ARRAY, bool_array_value=[True]))
    values.append(ParameterValue(type=ParameterType.PARAMETER_NOT_SET))
    # A type that ROS does not know.
    values.append(ParameterValue(type=99))
    return values


class Attacker:
    """A program that sends a node what it must refuse, and asks it whether it is well.

    Args:
        namespace: of the node.
        name: of the node.
        process: its number.
    """

    def __init__(self, namespace: str, name: str, process: int) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node("attacker", context=self._context, namespace=namespace)
        self._name = name
        self._process = psutil.Process(process)
        self._thread = spin_in_background(self.node)
        self._clients: dict[str, Any] = {}

    def close(self) -> None:
        """Leave the graph."""
        rclpy.try_shutdown(context=self._context)
        self._thread.join(10.0)
        self.node.destroy_node()

    def call(self, kind: type, service: str, request: Any) -> Any:
        """Call a service of the node and return its response, which must come in time."""
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, f"{self._name}/{service}")
            assert self._clients[service].wait_for_service(60.0), service
        future = self._clients[service].call_async(request)
        end_s = time.monotonic() + ANSWER_S
        while not future.done():
            assert time.monotonic() < end_s, f"{self._name} does not answer {service}"
            time.sleep(0.002)
        return future.result()

    def names(self) -> list[str]:
        """Return the names of the node's parameters."""
        found = self.call(ListParameters, "list_parameters", ListParameters.Request())
        return list(found.result.names)

    def value(self, name: str) -> ParameterValue:
        """Return the value of a parameter; that of no type where there is none of the name."""
        request = GetParameters.Request(names=[name])
        found = self.call(GetParameters, "get_parameters", request).values
        return found[0] if found else ParameterValue()

    def set(self, name: str, values: list[ParameterValue]) -> list[Any]:
        """Try to set a parameter to one value after the other; return the results."""
        parameters = [Parameter(name=name, value=value) for value in values]
        request = SetParameters.Request(parameters=parameters)
        return list(self.call(SetParameters, "set_parameters", request).results)

    def is_well(self) -> bool:
        """Ask something harmless."""
        request = DescribeParameters.Request(names=["use_sim_time"])
        return bool(self.call(DescribeParameters, "describe_parameters", request).descriptors)

    def memory_bytes(self) -> int:
        """Return what the node holds in memory."""
        return int(self._process.memory_info().rss)

    def send(self, kind: type, topic: str, messages: list[Any], *, readers: int = 1) -> None:
        """Publish messages once all readers listen, and wait until the node has had them all."""
        publisher = self.node.create_publisher(kind, topic, 100)
        end_s = time.monotonic() + ANSWER_S
        while publisher.get_subscription_count() < readers:
            assert time.monotonic() < end_s, f"nobody listens to {topic}"
            time.sleep(0.01)
        for message in messages:
            publisher.publish(message)
            # Where only the newest is kept, each must be heard.
            time.sleep(0.02)
        self.is_well()
        self.node.destroy_publisher(publisher)


def try_every_parameter(attacker: Attacker) -> dict[str, list[str]]:
    """Send every parameter of a node every hostile value; return the reasons, by parameter.

    Asserts that each is refused with one line, that the node then answers, and that it has not
    grown.
    """
    before = attacker.memory_bytes()
    reasons: dict[str, list[str]] = {}
    names = attacker.names()
    # Of those of a topic's policies, which are all alike and read-only, one.
    policies = [name for name in names if name.startswith("qos_overrides.")]
    for name in [*(set(names) - set(policies[1:])), "", "no_such_parameter"]:
        # What a parameter is already may be said again: a file that is loaded names all of them.
        present = attacker.value(name)
        values = [value for value in hostile_values() if not _is_same(value, present)]
        results = attacker.set(name, values)
        assert len(results) == len(values), name
        taken = [value for value, result in zip(values, results, strict=True) if result.successful]
        assert not taken, f"{name!r} takes {str(taken)[:300]}"
        reasons[name] = [result.reason for result in results]
        for reason in reasons[name]:
            assert reason, name
            assert "\n" not in reason, reason
            assert len(reason) < 1000, reason[:300]
    assert attacker.is_well()
    assert attacker.memory_bytes() - before < GROWTH_BYTES
    return reasons


def _is_same(value: ParameterValue, present: ParameterValue) -> bool:
    """Whether a text arrives as the one that is there: what follows a zero byte is left out."""
    text = ParameterType.PARAMETER_STRING
    arriving = value.string_value.partition("\0")[0]
    return value.type == present.type == text and arriving == present.string_value


def header(frame_id: str = "", *, sec: int = 1, nanosec: int = 0) -> Header:
    """Return a header, valid or not."""
    found = Header(frame_id=frame_id)
    found.stamp.sec, found.stamp.nanosec = sec, nanosec
    return found


def headers(frame_id: str) -> list[Header]:
    """Return headers that are wrong, or whose times make no sense."""
    return [
        header("", sec=10),
        header("nowhere", sec=10),
        header(LONG, sec=10),
        header(frame_id, sec=0),
        header(frame_id, sec=-1),
        header(frame_id, sec=-(2**31)),
        header(frame_id, sec=10, nanosec=2**32 - 1),
        header(frame_id, sec=2**31 - 1, nanosec=999_999_999),
    ]


EXTREMES = (math.nan, math.inf, -math.inf, 1e308, -1e308, 1e12)


def _vectors(message: Any, path: str) -> Iterator[Any]:
    """Yield copies of a message with one vector spoilt in each way."""
    for extreme in EXTREMES:
        made = message()
        vector = made
        for name in path.split("."):
            vector = getattr(vector, name)
        vector.x = vector.y = vector.z = extreme
        yield made


def poses(frame_id: str, *, stamp: Callable[[], Header]) -> list[PoseStamped]:
    """Return poses that none is; `stamp` gives a header that would do."""

    def good() -> PoseStamped:
        message = PoseStamped(header=stamp())
        message.pose.orientation.w = 1.0
        return message

    found = [*_vectors(good, "pose.position"), *_vectors(good, "pose.orientation")]
    found.append(PoseStamped(header=stamp()))
    found[-1].pose.orientation.w = 0.0
    for wrong in headers(frame_id):
        found.append(good())
        found[-1].header = wrong
        found[-1].pose.position.x = 10.0
    return found


def twists(frame_id: str) -> list[TwistStamped]:
    """Return velocities that none is."""

    def good() -> TwistStamped:
        return TwistStamped(header=header(frame_id))

    found = [*_vectors(good, "twist.linear"), *_vectors(good, "twist.angular")]
    found += [TwistStamped(header=wrong) for wrong in headers(frame_id)]
    return found


def wrenches(frame_id: str) -> list[WrenchStamped]:
    """Return wrenches that none is, or whose times make no sense."""

    def good() -> WrenchStamped:
        return WrenchStamped(header=header(frame_id))

    found = [*_vectors(good, "wrench.force"), *_vectors(good, "wrench.torque")]
    for wrong in headers(frame_id):
        found.append(WrenchStamped(header=wrong))
        found[-1].wrench.force.z = 100.0
    return found


def images(*, stamp: Callable[[], Header]) -> list[Image]:
    """Return images that none is."""
    pixels = bytes(120 * 160 * 3)
    shapes = [
        ("rgb8", 0, 0, 0, b""),
        ("rgb8", 120, 160, 480, pixels[:-1]),
        ("rgb8", 2**32 - 1, 2**32 - 1, 2**32 - 1, b"x"),
        ("rgb8", 120, 160, 479, pixels),
        ("", 120, 160, 480, pixels),
        (LONG, 120, 160, 480, pixels),
        ("32FC1", 120, 160, 640, bytes(120 * 640)),
        ("mono8", 1, 1, 1, b"x"),
        ("bgr8", 1, 57_600, 3 * 57_600, pixels + pixels + pixels),
    ]
    return [
        Image(header=stamp(), encoding=e, height=h, width=w, step=s, data=data)
        for e, h, w, s, data in shapes
    ]


def lines_of(executable: Executable, text: str) -> list[str]:
    """Return what a node has logged in lines that hold a text, without time and name."""
    return [
        line.partition("]: ")[2].strip() for line in executable.log.splitlines() if text in line
    ]
