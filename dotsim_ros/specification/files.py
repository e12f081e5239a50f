# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A sensor's file: found, read and written."""

from __future__ import annotations

import dataclasses
import itertools
import os
from pathlib import Path
from typing import Any

import yaml

from dotsim_ros.io.documents import read_yaml
from dotsim_ros.io.files import expanded, shipped_path, whole_file
from dotsim_ros.io.printable import printable
from dotsim_ros.io.quantity import section_from
from dotsim_ros.specification.sections import CameraSpecification
from dotsim_ros.specification.sensor import SECTIONS, SensorSpecification

FILES = ("idle_image", "residual")
"""Fields of a camera that name a file or a folder."""
SOURCE_MARK = "Source: "
"""Begins the line of a sensor's comment that says where its numbers come from."""
WRITTEN_BY_NEED = ("noise", "lighting", "vignetting", "pattern", "markers")
"""Sections that a written file has only where they differ from their defaults."""


def sensor_path(source: str | Path) -> Path:
    """Return the file of a sensor, given itself or by the sensor's name.

    Raises:
        FileNotFoundError: no sensor of this name comes with the package.
    """
    path = expanded(source)
    if path.suffix in (".yaml", ".yml"):
        return path
    return shipped_path("sensors", str(source), "sensor", "the path of a YAML file")


def load_sensor(source: str | Path) -> SensorSpecification:
    """Read a sensor from a YAML file, or by name from `params/sensors/`.

    An idle image or a network that lies next to the file is found there, wherever the folder is.

    Raises:
        FileNotFoundError: no such file or name.
        ValueError: an entry is unknown, of the wrong type or out of range; the message names it.
    """
    path = sensor_path(source)
    return _read_beside(path.resolve().parent, path)


def _read_beside(folder: Path, path: Path) -> SensorSpecification:
    """Return the sensor of a file, whose image and network may lie in a folder."""
    sensor = sensor_from(read_yaml(path), str(path), name=path.stem)
    found: dict[str, Any] = {
        name: str(folder / value)
        for name, value in _files_of(sensor.camera)
        # A name that no file can have is looked for, and refused, where it is used.
        if not Path(value).is_absolute() and os.path.exists(folder / value)
    }
    return dataclasses.replace(sensor, camera=dataclasses.replace(sensor.camera, **found))


def _files_of(camera: CameraSpecification) -> list[tuple[str, str]]:
    """Return the fields of a camera that name a file, with their values, where they do."""
    return [(name, getattr(camera, name)) for name in FILES if getattr(camera, name)]


def given_sensor(sensor: str | Path | SensorSpecification) -> SensorSpecification:
    """Return a specification as it is, or the one that `load_sensor` reads."""
    return sensor if isinstance(sensor, SensorSpecification) else load_sensor(sensor)


def sensor_from(document: Any, source: str, *, name: str = "") -> SensorSpecification:
    """Return the sensor of a mapping of sections as a sensor's YAML file holds them.

    Args:
        document: the mapping.
        source: where it comes from, for messages.
        name: of a sensor whose mapping gives none.

    Raises:
        ValueError: it is no mapping, or an entry is unknown, of the wrong type or out of range;
            the message names it.
    """
    if not isinstance(document, dict):
        raise ValueError(f"{source} holds no mapping; see params/sensors/densetact2.yaml")
    unknown = sorted(str(section) for section in set(document) - set(SECTIONS) - {"name"})
    if unknown:
        raise ValueError(f"{source}: unknown sections {unknown}; known are {sorted(SECTIONS)}")
    try:
        sections = {
            section: section_from(kind, section, document.get(section))
            for section, kind in SECTIONS.items()
        }
        return SensorSpecification(name=document.get("name", name), **sections)
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from error


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
    for section, kind in SECTIONS.items():
        values = getattr(specification, section)
        if section not in WRITTEN_BY_NEED or values != kind():
            document[section] = dataclasses.asdict(values)
    folder = path.resolve().parent
    for name, value in _files_of(specification.camera):
        if Path(value).is_relative_to(folder):
            document["camera"][name] = str(Path(value).relative_to(folder))
    head = "".join(f"# {printable(line)}\n" for line in comment.splitlines())
    with whole_file(path) as part:
        part.write_text(head + yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
        if _read_beside(folder, part) != specification:
            raise ValueError(f"{path} does not give the sensor back that was written")


def read_comment(path: Path) -> list[str]:
    """Return the lines of the comment that begins a sensor's file, without their marks."""
    lines = path.read_text(encoding="utf-8").splitlines()
    head = itertools.takewhile(lambda line: line.startswith("#"), lines)
    return [line.removeprefix("#").removeprefix(" ") for line in head]


def read_source(path: Path) -> str:
    """Return where a sensor's numbers come from: what its comment says after `Source: `, or the
    comment's first line."""
    comment = read_comment(path)
    stated = [line.removeprefix(SOURCE_MARK) for line in comment if line.startswith(SOURCE_MARK)]
    return next(iter([*stated, *comment]), "").rstrip(":")
