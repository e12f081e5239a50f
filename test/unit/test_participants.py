# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The file of those who take part in simulated time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from dotsim_ros.io.files import parameter_path
from dotsim_ros.nodes.simulated_time.participants import (
    Participant,
    Publication,
    participants_of,
    read_participants,
)

EXAMPLE = """
participants:
  tactile_sim: {}
  xarm_sim:
  my_controller:
    reads: [image_raw, ee_pose]
    publishes:
      cmd_vel: {for_each: image_raw}
      state: {every_s: 0.1}
"""


def test_a_file_names_whom_time_waits_for(tmp_path: Path) -> None:
    path = tmp_path / "participants.yaml"
    path.write_text(EXAMPLE)
    found = read_participants(path)
    assert list(found) == ["tactile_sim", "xarm_sim", "my_controller"]
    assert found["tactile_sim"] == found["xarm_sim"] == Participant()
    assert found["tactile_sim"].answers
    assert found["my_controller"] == Participant(
        ("image_raw", "ee_pose"),
        {"cmd_vel": Publication(for_each="image_raw"), "state": Publication(every_s=0.1)},
    )
    assert not found["my_controller"].answers


def test_the_shipped_file_names_the_closed_loop() -> None:
    found = read_participants(parameter_path("participants.yaml"))
    assert set(found) == {"tactile_sim", "xarm_sim", "tactile_policy"}
    assert all(participant.answers for participant in found.values())


BAD = {
    "no entry participants": ("nodes: {}", "expected one entry, participants"),
    "a second entry": ("participants: {a: {}}\nperiod_s: 1", "expected one entry, participants"),
    "a list": ("participants: [a]", "names no node: time would wait for nobody"),
    "nothing": ("participants:", "names no node: time would wait for nobody"),
    "a number as name": ("participants: {1: {}}", "'1' is no text and so no name"),
    "a slash as name": ("participants: {/: {}}", "expected the name of a node"),
    "an unknown key": ("participants: {a: {writes: []}}", "expected reads and publishes"),
    "a text": ("participants: {a: yes please}", "expected reads and publishes"),
    "one topic, no list": ("participants: {a: {reads: b}}", "a: reads is 'b', expected a list"),
    "a list of topics": ("participants: {a: {publishes: [b]}}", "expected topics by name"),
    "reads only": ("participants: {a: {reads: [b]}}", "a publishes nothing that time could wait"),
    "both": (
        "participants: {a: {publishes: {b: {for_each: c, every_s: 1}}}}",
        "a: b is .*expected {for_each: TOPIC} or {every_s: SECONDS}",
    ),
    "neither": ("participants: {a: {publishes: {b: {}}}}", "expected {for_each: TOPIC}"),
    "no topic": ("participants: {a: {publishes: {b: {for_each: ''}}}}", "expected {for_each"),
    "a microsecond": ("participants: {a: {publishes: {b: {every_s: 1e-6}}}}", "0.001 at least"),
    "no number": ("participants: {a: {publishes: {b: {every_s: .nan}}}}", "expected {for_each"),
    "a truth": ("participants: {a: {publishes: {b: {every_s: true}}}}", "expected {for_each"),
    "half a list": ("participants: [a", "participants.yaml"),
}


@pytest.mark.fault("simulated time", "a wrong file of participants")
@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_refused_with_the_entry(
    tmp_path: Path, name: str, answered: Callable[..., None]
) -> None:
    content, reason = BAD[name]
    path = tmp_path / "participants.yaml"
    path.write_text(content)
    with pytest.raises(ValueError, match=reason) as error:
        read_participants(path)
    assert "participants.yaml" in str(error.value)
    answered(error.value, what=f"a file of participants: {name}")


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"nowhere\.yaml"):
        read_participants(tmp_path / "nowhere.yaml")


def test_a_name_may_have_a_namespace() -> None:
    assert list(participants_of({"/left/tactile_sim": {}})) == ["/left/tactile_sim"]
