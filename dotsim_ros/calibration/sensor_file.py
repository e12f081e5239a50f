"""Writes a sensor as the YAML file that `load_sensor` and `tactile_sim` read."""

from __future__ import annotations

import dataclasses
import itertools
import os
from pathlib import Path
from typing import Any

import yaml

from dotsim_ros.specification import SensorSpecification, load_sensor


def write_sensor(path: Path, specification: SensorSpecification, comment: str) -> None:
    """Write a sensor's file, whole or not at all, and check that it loads as the same sensor.

    Args:
        path: of the file, ending in .yaml.
        specification: the sensor.
        comment: lines that say where its constants come from.

    Raises:
        ValueError: the suffix is another, or the file does not give the sensor back.
    """
    if path.suffix not in (".yaml", ".yml"):
        raise ValueError(f"{path}: a sensor's file must end in .yaml")
    document: dict[str, Any] = {"name": specification.name}
    for section in ("gel", "material", "contact", "solver", "camera"):
        document[section] = _plain(dataclasses.asdict(getattr(specification, section)))
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.stem + ".part.yaml")
    part.write_text(head + yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    if load_sensor(part) != specification:
        raise ValueError(f"{part} does not give the sensor back that was written")
    os.replace(part, path)


def read_comment(path: Path) -> list[str]:
    """Return the lines of the comment that begins a sensor's file, without their marks."""
    lines = path.read_text(encoding="utf-8").splitlines()
    head = itertools.takewhile(lambda line: line.startswith("#"), lines)
    return [line.removeprefix("#").removeprefix(" ") for line in head]


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    return {
        name: list(value) if isinstance(value, tuple) else value for name, value in values.items()
    }
