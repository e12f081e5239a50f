# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""metadata.yaml of a ROS 2 bag."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from dotsim_ros.io.documents import read_yaml

METADATA = "metadata.yaml"
BAG_VERSION = 9
_ROOT = "rosbag2_bagfile_information"


@dataclass(frozen=True)
class TopicCount:
    """A topic of a bag.

    Attributes:
        name: the topic.
        kind: type of its messages.
        type_hash: of the type's definition, REP-2011; empty where it is not known.
        message_count: how many messages.
    """

    name: str
    kind: str
    type_hash: str
    message_count: int


@dataclass(frozen=True)
class BagMetadata:
    """What metadata.yaml of a bag that is written says.

    Attributes:
        files: names of its files.
        first_ns, last_ns: log times; 0 without messages.
        topics: those declared.
    """

    files: tuple[str, ...]
    first_ns: int
    last_ns: int
    topics: tuple[TopicCount, ...]


@dataclass(frozen=True)
class BagStorage:
    """Where the messages of a bag lie.

    Attributes:
        storage: "mcap" or "sqlite3".
        files: names of its files.
        is_compressed: whole files or messages are compressed, next to what mcap does itself.
    """

    storage: str
    files: tuple[str, ...]
    is_compressed: bool


def metadata_text(metadata: BagMetadata) -> str:
    """Return metadata.yaml."""
    return yaml.safe_dump({_ROOT: _information(metadata)}, sort_keys=False)


def summary_text(metadata: BagMetadata) -> str:
    """Return what an mcap file holds of it."""
    return yaml.safe_dump(_information(metadata), sort_keys=False)


def _information(metadata: BagMetadata) -> Mapping[str, Any]:
    message_count = sum(topic.message_count for topic in metadata.topics)
    span = {
        "starting_time": {"nanoseconds_since_epoch": metadata.first_ns},
        "duration": {"nanoseconds": metadata.last_ns - metadata.first_ns},
        "message_count": message_count,
    }
    return {
        "version": BAG_VERSION,
        "storage_identifier": "mcap",
        **_copy(span),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.kind,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [],
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.message_count,
            }
            for topic in metadata.topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": list(metadata.files),
        "files": [{"path": name, **_copy(span)} for name in metadata.files],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def _copy(span: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy, since YAML would write what it meets twice as an alias."""
    return {name: dict(value) if isinstance(value, dict) else value for name, value in span.items()}


def read_metadata(folder: Path) -> BagStorage:
    """Read where the messages of a bag lie.

    Raises:
        FileNotFoundError: no metadata.yaml.
        ValueError: it is broken.
    """
    path = folder / METADATA
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing")
    document = read_yaml(path)
    information = document.get(_ROOT) if isinstance(document, dict) else None
    if not isinstance(information, dict):
        raise ValueError(f"{path} has no {_ROOT}")
    storage = information.get("storage_identifier")
    if storage not in ("mcap", "sqlite3"):
        raise ValueError(
            f"{path}: storage_identifier is {str(storage)[:40]!r}, expected 'mcap' or 'sqlite3'"
        )
    files = information.get("relative_file_paths")
    is_list = isinstance(files, list) and all(isinstance(name, str) for name in files)
    if not is_list or not files:
        raise ValueError(f"{path}: relative_file_paths names no file")
    mode = str(information.get("compression_mode") or "none").lower()
    names = [Path(name).name for name in files]
    if not all(names) or any(name == ".." or "\0" in name for name in names):
        raise ValueError(f"{path}: relative_file_paths names no file")
    return BagStorage(storage, tuple(names), mode not in ("none", "storage"))
