# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The overlay: effects that were found in a sensor's data, as a file that the live sensor reads.

It names effects and parameters; what they do stands in the library of the version that reads it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import yaml

from dotsim_ros import __version__
from dotsim_ros.effects.effect import Active, Effect
from dotsim_ros.io.documents import read_yaml, shortened, value_text

VERSION = 1
FILE_NAME = "effects_overlay.yaml"

_KEYS = {"version", "dotsim_ros", "sensor", "data_hash", "effects"}
_NUMBERS = ("value", "low", "high")


@dataclass(frozen=True)
class FoundEffect:
    """An effect of an overlay, with its parameters and their intervals."""

    name: str
    parameters: tuple[Estimate, ...]


@dataclass(frozen=True)
class Overlay:
    """What a search added to a sensor.

    Attributes:
        sensor: name of the sensor whose data were searched.
        data_hash: of these data.
        effects: in the order in which they act.
        written_by: version of dotsim_ros that found them.
    """

    sensor: str
    data_hash: str
    effects: tuple[FoundEffect, ...]
    written_by: str = __version__


def overlay_text(overlay: Overlay) -> str:
    """Return an overlay as the text of its file.

    Raises:
        ValueError: an estimate that `read_overlay` would refuse.
    """
    record = {
        "version": VERSION,
        "dotsim_ros": overlay.written_by,
        "sensor": overlay.sensor,
        "data_hash": overlay.data_hash,
        "effects": [
            {
                "name": effect.name,
                "parameters": {
                    e.name: {k: v for k, v in asdict(e).items() if k != "name"}
                    for e in effect.parameters
                },
            }
            for effect in overlay.effects
        ],
    }
    _overlay_of(record, FILE_NAME)
    return str(yaml.safe_dump(record, sort_keys=False))


def read_overlay(path: str | Path) -> Overlay:
    """Read an overlay.

    Raises:
        FileNotFoundError: no such file.
        ValueError: no overlay, or one of another version; the message says what was expected.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no overlay of effects at {path}; find_gap writes one")
    return _overlay_of(read_yaml(path), str(path))


def active_effects(
    overlay: Overlay, library: Mapping[str, Effect], *, place: str = "the overlay"
) -> tuple[Active, ...]:
    """Return the effects of an overlay at work; errors call the overlay by its place.

    Raises:
        ValueError: an effect that the library does not have or that is named twice, a parameter
            that the effect does not have, one that is missing, or a value out of its range.
    """
    names = [found.name for found in overlay.effects]
    for name in names:
        if name not in library:
            raise ValueError(
                f"{place}: unknown effect {value_text(name)}; known are "
                f"{', '.join(sorted(library))}. One of your own lies in a folder that must be "
                "named, too"
            )
        if names.count(name) > 1:
            raise ValueError(
                f"{place}: the effect {value_text(name)} stands there twice, expected once"
            )
    return tuple(_active(found, library[found.name], place) for found in overlay.effects)


def _active(found: FoundEffect, effect: Effect, place: str) -> Active:
    values = {estimate.name: estimate.value for estimate in found.parameters}
    missing = [p.name for p in effect.parameters if p.name not in values]
    try:
        values = effect.checked(values)
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from error
    if missing:
        raise ValueError(f"{place}: {effect.name} lacks its parameter {', '.join(missing)}")
    for parameter in effect.parameters:
        value = values[parameter.name]
        # A search may name a size beyond the usual.
        opened = parameter.opened
        if not opened.low <= value <= opened.high:
            raise ValueError(
                f"{place}: {effect.name}.{parameter.name} is {value:g} {parameter.unit}".rstrip()
                + f", expected {opened.low:g} to {opened.high:g}"
            )
    return Active(effect, values)


def described(effects: Sequence[Active]) -> tuple[str, ...]:
    """Return each effect with its values, as diagnostics and logs name it."""
    texts = []
    for active in effects:
        values = ", ".join(
            f"{p.name} {active.values[p.name]:.4g} {p.unit}".rstrip()
            for p in active.effect.parameters
        )
        texts.append(f"{active.effect.name} ({values})")
    return tuple(texts)


def _overlay_of(record: Any, place: str) -> Overlay:
    if not isinstance(record, Mapping) or "version" not in record:
        raise ValueError(
            f"{place} is no overlay of effects, expected a mapping with {', '.join(sorted(_KEYS))}"
        )
    if record["version"] != VERSION:
        raise ValueError(
            f"{place} is an overlay of version {value_text(record['version'])}, this dotsim_ros "
            f"reads {VERSION}; search the data again with find_gap"
        )
    if set(record) != _KEYS:
        raise ValueError(
            f"{place} has the keys {value_text(list(record))}; expected {', '.join(sorted(_KEYS))}"
        )
    if not isinstance(record["effects"], list):
        raise ValueError(f"{place}: effects is {value_text(record['effects'])}, expected a list")
    return Overlay(
        sensor=str(record["sensor"]),
        data_hash=str(record["data_hash"]),
        effects=tuple(_effect_of(entry, place) for entry in record["effects"]),
        written_by=str(record["dotsim_ros"]),
    )


def _effect_of(entry: Any, place: str) -> FoundEffect:
    if (
        not isinstance(entry, Mapping)
        or set(entry) != {"name", "parameters"}
        or not isinstance(entry["parameters"], Mapping)
    ):
        raise ValueError(
            f"{place}: {value_text(entry)} is no effect, expected its name and parameters"
        )
    return FoundEffect(
        str(entry["name"]),
        tuple(
            _estimate_of(
                str(name), numbers, f"{place}: {shortened(entry['name'])}.{shortened(name)}"
            )
            for name, numbers in entry["parameters"].items()
        ),
    )


def _estimate_of(name: str, numbers: Any, place: str) -> Estimate:
    if not isinstance(numbers, Mapping) or set(numbers) != {"unit", *_NUMBERS}:
        raise ValueError(f"{place} is {value_text(numbers)}, expected unit, {', '.join(_NUMBERS)}")
    for key in _NUMBERS:
        number = numbers[key]
        if isinstance(number, bool) or not isinstance(number, int | float):
            raise ValueError(f"{place}: {key} is {value_text(number)}, expected a number")
        if not math.isfinite(number):
            raise ValueError(f"{place}: {key} is {number}, expected a finite number")
    if not numbers["low"] <= numbers["value"] <= numbers["high"]:
        raise ValueError(
            f"{place}: {numbers['value']:g} is not within its interval, {numbers['low']:g} to "
            f"{numbers['high']:g}"
        )
    return Estimate(name, str(numbers["unit"]), *(float(numbers[key]) for key in _NUMBERS))


@dataclass(frozen=True)
class Estimate:
    """A fitted number, with its interval of 95 %."""

    name: str
    unit: str
    value: float
    low: float
    high: float
