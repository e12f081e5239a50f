# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a node is sent that it must refuse: values of parameters of every type, and messages."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from copy import deepcopy
from typing import Any

import psutil
from harness import Executable, Watcher
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
)
from sensor_msgs.msg import Image
from std_msgs.msg import Header

import msg_adapters

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
    kinds = ParameterType
    values: dict[int, tuple[str, Iterable[Any]]] = {
        kinds.PARAMETER_STRING: ("string_value", TEXTS),
        kinds.PARAMETER_DOUBLE: ("double_value", NUMBERS),
        kinds.PARAMETER_INTEGER: ("integer_value", WHOLE_NUMBERS),
        kinds.PARAMETER_DOUBLE_ARRAY: (
            "double_array_value",
            ([], [1e308] * 3, [math.nan] * 4, [math.nan] * 7, [0.5], [0.1] * 20_000),
        ),
        kinds.PARAMETER_INTEGER_ARRAY: (
            "integer_array_value",
            ([], [-1, -1], [16384, 16384], [1, 0], [2**62] * 4, [5, 5, 5, 0], [7] * 20_000),
        ),
        kinds.PARAMETER_STRING_ARRAY: ("string_array_value", ([], [""], ["bad name=x"], [LONG])),
        kinds.PARAMETER_BYTE_ARRAY: ("byte_array_value", ([b"\xff"],)),
        kinds.PARAMETER_BOOL_ARRAY: ("bool_array_value", ([True],)),
    }
    found = [
        ParameterValue(type=kind, **{field: value})
        for kind, (field, given) in values.items()
        for value in given
    ]
    # No value, and a type that ROS does not know.
    return [*found, ParameterValue(type=kinds.PARAMETER_NOT_SET), ParameterValue(type=99)]


class Attacker(Watcher):
    """A program that sends a node what it must refuse, and asks it whether it is well.

    Args:
        namespace, name: of the node.
        process: its number.
    """

    def __init__(self, namespace: str, name: str, process: int) -> None:
        super().__init__("attacker", namespace)
        self._name = name
        self._process = psutil.Process(process)

    def ask(self, kind: type, service: str, **fields: Any) -> Any:
        """Call a service of the node and return its response, which must come in time."""
        return self.call(kind, f"{self._name}/{service}", patience_s=ANSWER_S, **fields)

    def names(self) -> list[str]:
        """Return the names of the node's parameters."""
        return list(self.ask(ListParameters, "list_parameters").result.names)

    def value(self, name: str) -> ParameterValue:
        """Return the value of a parameter; that of no type where there is none of the name."""
        found = self.ask(GetParameters, "get_parameters", names=[name]).values
        return found[0] if found else ParameterValue()

    def set(self, name: str, values: list[ParameterValue]) -> list[Any]:
        """Try to set a parameter to one value after the other; return the results."""
        parameters = [Parameter(name=name, value=value) for value in values]
        return list(self.ask(SetParameters, "set_parameters", parameters=parameters).results)

    def is_well(self) -> bool:
        """Ask something harmless."""
        found = self.ask(DescribeParameters, "describe_parameters", names=["use_sim_time"])
        return bool(found.descriptors)

    def memory_bytes(self) -> int:
        """Return what the node holds in memory."""
        return int(self._process.memory_info().rss)

    def send(self, kind: type, topic: str, messages: list[Any], *, readers: int = 1) -> None:
        """Publish messages once all readers listen, and wait until the node has had them all."""
        publisher = self.node.create_publisher(kind, topic, 100)
        self.wait(lambda: publisher.get_subscription_count() >= readers, f"readers of {topic}")
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


def spoilt(good: Any) -> list[Any]:
    """Return copies of a stamped message, each later than the one before: one of the vectors is
    spoilt, or is zero; then copies whose header is wrong."""
    found = []
    for value in (*EXTREMES, 0.0):
        for number in range(len(_vectors(good))):
            found.append(deepcopy(good))
            stamp_ns = msg_adapters.message_stamp_ns(good) + len(found)
            found[-1].header.stamp = msg_adapters.encode_stamp(stamp_ns)
            vector = _vectors(found[-1])[number]
            for name in vector.get_fields_and_field_types():
                setattr(vector, name, value)
    for wrong in headers(good.header.frame_id):
        found.append(deepcopy(good))
        found[-1].header = wrong
    return found


def _vectors(message: Any) -> list[Any]:
    """Return the parts of a message that hold nothing but numbers."""
    kinds = message.get_fields_and_field_types()
    if set(kinds.values()) == {"double"}:
        return [message]
    parts = (getattr(message, name) for name, kind in kinds.items() if "geometry_msgs" in kind)
    return [vector for part in parts for vector in _vectors(part)]


def images() -> list[Image]:
    """Return images of now that none is."""
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
    found = [Image(encoding=e, height=h, width=w, step=s, data=d) for e, h, w, s, d in shapes]
    for number, image in enumerate(found):
        image.header.stamp = msg_adapters.encode_stamp(time.time_ns() + number)
    return found


def lines_of(executable: Executable, text: str) -> list[str]:
    """Return what a node has logged in lines that hold a text, without time and name."""
    return [
        line.partition("]: ")[2].strip() for line in executable.log.splitlines() if text in line
    ]
