# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The files of sensors: refused, or taken as they stand and within the ranges of their fields."""

from __future__ import annotations

from pathlib import Path
from random import Random
from typing import Any

import yaml

from dotsim_ros.io.quantity import Quantity, quantities_of
from dotsim_ros.specification import (
    LARGEST_MEMORY_BYTES,
    SECTIONS,
    SensorSpecification,
    load_sensor,
    size_of,
)
from fuzz.mutate import spoilt_text, spoilt_tree
from fuzz.target import Finding, Target, answer

NAMES = ("densetact2", "sensor_a", "flat_pad")
FILE = "sensor.yaml"


def _sensors(folder: Path) -> list[dict[str, Any]]:
    """Return every field of the shipped sensors as mappings."""
    documents = []
    for name in NAMES:
        sensor = load_sensor(name)
        document: dict[str, Any] = {"name": sensor.name}
        for section in SECTIONS:
            values = getattr(sensor, section)
            document[section] = {
                field: list(value) if isinstance(value, tuple) else value
                for field, value in ((f, getattr(values, f)) for f in quantities_of(type(values)))
            }
        documents.append(document)
    return documents


def _attempt_tree(documents: list[dict[str, Any]], random: Random, folder: Path) -> None:
    document = spoilt_tree(random.choice(documents), random)
    _check(yaml.safe_dump(document), document, folder)


def _attempt_text(documents: list[dict[str, Any]], random: Random, folder: Path) -> None:
    text = spoilt_text(yaml.safe_dump(random.choice(documents)), random)
    _check(text, None, folder)


def _attempt_range(documents: list[dict[str, Any]], random: Random, folder: Path) -> None:
    """Put one number out of the range of its field, which must be refused by name and range."""
    document = random.choice(documents)
    section, kind = random.choice(list(SECTIONS.items()))
    field, (default, quantity) = random.choice(list(quantities_of(kind).items()))
    number = _beyond(quantity, random)
    if number is None:
        return
    value: Any = number
    if isinstance(default, tuple):
        value = [*default] or [number]
        value[random.randrange(len(value))] = number
    elif isinstance(default, bool):
        return
    spoilt = {**document, section: {**document[section], field: value}}
    path = folder / FILE
    path.write_text(yaml.safe_dump(spoilt))
    if answer(lambda: load_sensor(path), [field]) is not None:
        raise Finding(f"{section}.{field} = {value} was taken, its range is {quantity.range_text}")


def _beyond(quantity: Quantity, random: Random) -> float | None:
    if not quantity.has_range:
        return None
    span = quantity.high - quantity.low
    return random.choice(
        (
            quantity.low - 1e-6 * span,
            quantity.high + 1e-6 * span,
            quantity.low - span,
            1e3 * quantity.high + span,
            float("inf"),
            float("nan"),
            -float("inf"),
        )
    )


def _check(text: str, document: Any, folder: Path) -> None:
    path = folder / FILE
    path.write_text(text)
    sensor = answer(lambda: load_sensor(path), [FILE])
    if sensor is None:
        return
    if not isinstance(sensor, SensorSpecification):
        raise Finding(f"it gave {sensor!r}")
    for section, kind in SECTIONS.items():
        values = getattr(sensor, section)
        given = document.get(section) if isinstance(document, dict) else None
        for field, (_, quantity) in quantities_of(kind).items():
            value = getattr(values, field)
            for number in value if isinstance(value, tuple) else (value,):
                if quantity.has_range and not quantity.contains(number):
                    raise Finding(f"{section}.{field} is {value}")
            if given and field in given:
                meant = tuple(given[field]) if isinstance(given[field], list) else given[field]
                if isinstance(meant, bool) != isinstance(value, bool) or meant != value:
                    raise Finding(f"{section}.{field}: {given[field]!r} was taken as {value!r}")
    if (size := size_of(sensor)).memory_bytes > LARGEST_MEMORY_BYTES:
        raise Finding(f"it would take {size.memory_bytes:g} bytes")


TARGETS = (
    Target("sensor", _sensors, _attempt_tree),
    Target("sensor_text", _sensors, _attempt_text),
    Target("sensor_range", _sensors, _attempt_range),
)
