"""What the stepper and its participants tell each other, over the wire and back."""

from __future__ import annotations

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message, serialize_message

import msg_adapters
from dotsim_ros.nodes.simulated_time.protocol import (
    Answer,
    Kind,
    Sent,
    Step,
    decode_answer,
    decode_step,
    encode_answer,
    encode_step,
)
from msg_adapters import Level, Status


def on_the_wire(message: DiagnosticArray) -> DiagnosticArray:
    return deserialize_message(serialize_message(message), DiagnosticArray)


@pytest.mark.parametrize(
    "step",
    [
        Step(1_000_000_000, Kind.CALL),
        Step(2_147_000_000_123_456_789, Kind.STEP),
        Step(1, Kind.STEP, {"/a": Sent("life of a", 3), "/b/c": Sent("", 0)}),
    ],
)
def test_a_step_comes_back_as_it_was(step: Step) -> None:
    assert decode_step(on_the_wire(encode_step(step))) == step


@pytest.mark.parametrize(
    "answer",
    [
        Answer(1_010_000_000, Kind.DONE, "/left/node", "life"),
        Answer(1_010_000_000, Kind.DONE, "/left/node", "life", {"/a": 7}),
        Answer(1, Kind.PRESENT, "/node", "life", {"/a": 7}, {"/a": 2, "/b": 0}, {"/c": 1}),
    ],
)
def test_an_answer_comes_back_as_it_was(answer: Answer) -> None:
    assert decode_answer(on_the_wire(encode_answer(answer))) == answer


@pytest.mark.parametrize(
    "statuses",
    [
        [],
        [Status("a", Level.OK, "step", "", {}), Status("b", Level.OK, "step", "", {})],
        [Status("a", Level.OK, "jump", "", {})],
        [Status("a", Level.OK, "step", "", {"/topic": "life many"})],
    ],
)
def test_other_messages_are_refused(statuses: list[Status]) -> None:
    message = msg_adapters.encode_diagnostics(statuses, stamp_ns=1)
    with pytest.raises(ValueError, match=r"."):
        decode_step(message)
    with pytest.raises(ValueError, match=r"."):
        decode_answer(message)
