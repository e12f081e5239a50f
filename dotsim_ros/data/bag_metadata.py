# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""metadata.yaml of a ROS 2 bag."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from dotsim_ros.io.documents import read_yaml

METADATA = "metadata.yaml"
BAG_VERSION = 9
_ROOT = "rosbag2_bagfile_information"


def bag_information(
    file_name: str, first_ns: int, last_ns: int, topics: Sequence[tuple[str, str, str, int]]
) -> dict[str, Any]:
    """Return what metadata.yaml of a bag says.

    Args:
        file_name: of its mcap file.
        first_ns, last_ns: log times; 0 without messages.
        topics: name, type, hash of the type (REP 2011; empty where it is not known) and number of
            messages of each.
    """

    def span() -> dict[str, Any]:
        # Recreated for each use: YAML would write what it meets twice as an alias.
        return {
            "starting_time": {"nanoseconds_since_epoch": first_ns},
            "duration": {"nanoseconds": last_ns - first_ns},
            "message_count": sum(count for *_, count in topics),
        }

    return {
        "version": BAG_VERSION,
        "storage_identifier": "mcap",
        **span(),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": name,
                    "type": kind,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [],
                    "type_description_hash": type_hash,
                },
                "message_count": count,
            }
            for name, kind, type_hash, count in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file_name],
        "files": [{"path": file_name, **span()}],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def metadata_texts(information: dict[str, Any]) -> tuple[str, str]:
    """Return metadata.yaml, and what an mcap file holds of it."""
    whole = yaml.safe_dump({_ROOT: information}, sort_keys=False)
    return whole, yaml.safe_dump(information, sort_keys=False)


def read_mcap_names(folder: Path) -> tuple[str, ...]:
    """Return the names of a bag's mcap files; none where it is in sqlite3, or where whole files or
    messages are compressed next to what mcap does itself.

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
    names = []
    if isinstance(files, list) and all(isinstance(name, str) for name in files):
        names = [Path(name).name for name in files]
    if not names or any(name in ("", "..") or "\0" in name for name in names):
        raise ValueError(f"{path}: relative_file_paths names no file")
    mode = str(information.get("compression_mode") or "none").lower()
    return tuple(names) if storage == "mcap" and mode in ("none", "storage") else ()
