# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the stepper and its participants tell each other, over the wire and back."""

from __future__ import annotations

import pytest
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import String

from dotsim_ros.nodes.simulated_time.protocol import (
    Answer,
    Kind,
    Sent,
    Step,
    decode_answer,
    decode_step,
    encode,
)


def on_the_wire(message: String) -> String:
    return deserialize_message(serialize_message(message), String)


def test_steps_and_answers_come_back_as_they_were() -> None:
    for step in (
        Step(2_147_000_000_123_456_789, Kind.CALL),
        Step(1, Kind.STEP, {"/a": Sent("life of a", 3), "/b/c": Sent("", 0)}),
    ):
        assert decode_step(on_the_wire(encode(step))) == step
    for answer in (
        Answer(1_010_000_000, Kind.DONE, "/left/node", "life", {"/a": 7}),
        Answer(1, Kind.PRESENT, "/node", "life", {"/a": 7}, {"/a": 2, "/b": 0}, {"/c": 1}, "it"),
    ):
        assert decode_answer(on_the_wire(encode(answer))) == answer


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[]",
        "[1]",
        '[1,"jump","/node","life",{}]',
        '[1,"step",{"/topic":["life","many"]}]',
        '[Infinity,"step",{}]',
        '[1,"done","/node","life",[]]',
        "[" * 100_000,
        "NaN",
    ],
    ids=lambda text: text[:20],
)
def test_other_messages_are_refused(text: str) -> None:
    for decode in (decode_step, decode_answer):
        with pytest.raises(ValueError, match="is no message between a stepper"):
            decode(String(data=text))
