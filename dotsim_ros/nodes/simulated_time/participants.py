# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Who takes part in simulated time, as a parameter file lists it. Needs no ROS.

example:
  participants:
    tactile_sim: {}
    xarm_sim: {}
    my_controller:
      reads: [image_raw, ee_pose]
      publishes:
        cmd_vel: {for_each: image_raw}
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dotsim_ros.io.documents import is_number, read_yaml, value_text

SHORTEST_PERIOD_S = 1e-3
KEYS = ("reads", "publishes")


@dataclass(frozen=True)
class Publication:
    """When a node that knows nothing of steps publishes on a topic; one of both is given.

    Attributes:
        for_each: once for each message of this topic.
        every_s: once in this simulated time, stamped with it.
    """

    for_each: str = ""
    every_s: float = 0.0


@dataclass(frozen=True)
class Participant:
    """A node that time waits for.

    Attributes:
        reads: topics that a node that knows nothing of steps reads.
        publishes: what it publishes; nothing: a node that answers each step itself.
    """

    reads: tuple[str, ...] = ()
    publishes: Mapping[str, Publication] = field(default_factory=dict)

    @property
    def answers(self) -> bool:
        """Return whether the node answers each step itself."""
        return not self.publishes


def read_participants(path: str | Path) -> dict[str, Participant]:
    """Return the participants of a file, by the name of the node.

    Raises:
        OSError: it cannot be read.
        ValueError: it is no such file; names the entry.
    """
    content = read_yaml(Path(path))
    if not isinstance(content, dict) or list(content) != ["participants"]:
        raise ValueError(f"{path}: expected one entry, participants, with the nodes by name")
    try:
        return participants_of(content["participants"])
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def participants_of(nodes: Any) -> dict[str, Participant]:
    """Return participants of what a file holds; errors as `read_participants`."""
    if not isinstance(nodes, dict) or not nodes:
        raise ValueError("participants names no node: time would wait for nobody")
    return {_name(name): _participant(str(name), entry or {}) for name, entry in nodes.items()}


def _name(name: Any) -> str:
    if not isinstance(name, str) or not name.strip("/"):
        raise ValueError(f"participants names {value_text(name)}, expected the name of a node")
    return name


def _participant(name: str, entry: Any) -> Participant:
    if not isinstance(entry, dict) or set(entry) - set(KEYS):
        raise ValueError(
            f"{name} is {value_text(entry)}, expected reads and publishes, or {{}} for a node that "
            "answers each step itself (stepped: true)"
        )
    reads, publishes = entry.get("reads", []), entry.get("publishes", {})
    if not isinstance(reads, list) or not all(isinstance(topic, str) for topic in reads):
        raise ValueError(f"{name}: reads is {value_text(reads)}, expected a list of topics")
    if not isinstance(publishes, dict):
        raise ValueError(f"{name}: publishes is {value_text(publishes)}, expected topics by name")
    if reads and not publishes:
        raise ValueError(
            f"{name} publishes nothing that time could wait for: name a topic under publishes, or "
            "leave the node out"
        )
    return Participant(
        tuple(reads),
        {str(topic): _publication(f"{name}: {topic}", each) for topic, each in publishes.items()},
    )


def _publication(where: str, entry: Any) -> Publication:
    wanted = "expected {for_each: TOPIC} or {every_s: SECONDS}"
    if not isinstance(entry, dict) or len(entry) != 1:
        raise ValueError(f"{where} is {value_text(entry)}, {wanted}")
    if isinstance(entry.get("for_each"), str) and entry["for_each"]:
        return Publication(for_each=entry["for_each"])
    every_s: Any = entry.get("every_s")
    if is_number(every_s) and every_s >= SHORTEST_PERIOD_S:
        return Publication(every_s=float(every_s))
    raise ValueError(f"{where} is {value_text(entry)}, {wanted}, {SHORTEST_PERIOD_S:g} at least")
