# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The plan of a data set of touches: one YAML file with ranges that are drawn from."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.data.data_set import indenter_files
from dotsim_ros.effects.library import load_effects
from dotsim_ros.gel.values import GEL_PARAMETERS, values_of
from dotsim_ros.geometry.indenter import Indenter, load_indenter
from dotsim_ros.io.documents import is_number, read_yaml, value_text
from dotsim_ros.io.files import expanded, parameter_path
from dotsim_ros.io.printable import did_you_mean
from dotsim_ros.specification import SensorSpecification, load_sensor
from dotsim_ros.twin.simulator import check_is_quasi_static

VERSION = 1
GRASP = "grasp"
KINDS = ("press", "hold", "slide", "twist", "roll", GRASP)
CONTENTS = (
    *("image", "difference", "depth", "normal", "markers", "skin"),
    *("wrench", "pose", "contact", "slip", "constants"),
)
"""What a frame can hold; `formats.KEYS` says what data sets call it."""
OF_OWN = "of own"
"""Unit of a range that the sensor's own value is multiplied by."""
KEYS = (
    *("version", "sensor", "indenters", "touches", "frames", "rate_hz", "image_side_px"),
    *("touches_a_gel", "contents", "pose", "gel", "effects", "noise"),
)
POSE_LIMITS: dict[str, tuple[str, float, float]] = {
    "depth": ("of the thickness", 0.01, 0.6),
    "place": ("of the face", 0.0, 0.8),
    "tilt": ("rad", 0.0, 0.8),
    "slide": ("m", 0.0, 0.02),
    "twist": ("rad", 0.0, 1.6),
    "roll": ("rad", 0.0, 1.6),
}
"""Unit and limits of what is drawn for the motion of every touch: how deep the indenter goes; how
far from the middle of the face it meets it; its axis's angle to the face's normal; and how far it
slides, turns and rolls, either way."""
NOISE_LIMITS = {"deviation": ("grey levels of 255", 0.0, 50.0)}
LEAST_FRAMES = 4


@dataclass(frozen=True)
class Range:
    """What a number is drawn from, evenly."""

    low: float
    high: float
    is_factor: bool = False

    def draw(self, random: np.random.Generator, own: float = 1.0) -> float:
        """Return a number; where the range is of factors, times the sensor's own."""
        drawn = float(random.uniform(self.low, self.high))
        return own * drawn if self.is_factor else drawn


@dataclass(frozen=True)
class TouchPlan:
    """What is touched, how, and what differs from touch to touch.

    Attributes:
        document: the plan as its file has it, for the card of a data set.
        sensor: that is pressed.
        indenters: that press, each as often.
        touches: shares of the kinds of `KINDS`.
        frames: of each touch; the first one is without contact.
        rate_hz: of the frames.
        image_px: width and height of the images, no larger than the camera's.
        touches_a_gel: so many touches, one after the other, have one gel, and are written together.
        contents: of `CONTENTS`.
        pose, gel, noise: ranges by name: of the motion, of parameters of the gel, and of noise.
        effects: ranges of their parameters, by the effects' names.
    """

    document: Mapping[str, Any]
    sensor: SensorSpecification
    indenters: tuple[Indenter, ...]
    touches: Mapping[str, float]
    frames: int
    rate_hz: float
    image_px: tuple[int, int]
    touches_a_gel: int
    contents: tuple[str, ...]
    pose: Mapping[str, Range]
    gel: Mapping[str, Range]
    effects: Mapping[str, Mapping[str, Range]]
    noise: Mapping[str, Range]

    @property
    def is_grasp(self) -> bool:
        """Whether two sensors touch at once."""
        return GRASP in self.touches


def read_plan(
    path: Path | None = None,
    *,
    sensor: str | None = None,
    indenters: tuple[str, ...] = (),
    touches: tuple[str, ...] = (),
) -> TouchPlan:
    """Read a plan.

    Args:
        path: of the file; None for the shipped one.
        sensor, indenters, touches: in place of those of the file.

    Raises:
        FileNotFoundError: a file that is not there.
        ValueError: an entry is unknown, missing or out of range; the message names it.
    """
    path = parameter_path("touches/default.yaml") if path is None else expanded(path)
    given = read_yaml(path)
    if not isinstance(given, dict):
        raise ValueError(f"{path} holds no mapping, expected {', '.join(KEYS)}")
    unknown = [str(key) for key in given if key not in KEYS]
    if unknown:
        near = did_you_mean(unknown[0], KEYS)
        raise ValueError(
            f"{path}: unknown entry {value_text(unknown[0])}{near}; known are {', '.join(KEYS)}"
        )
    if given.get("version") != VERSION:
        raise ValueError(
            f"{path} is a plan of version {value_text(given.get('version'))}, expected {VERSION}"
        )
    missing = [key for key in KEYS if key not in given]
    if missing:
        raise ValueError(f"{path} lacks {', '.join(missing)}; params/touches/default.yaml has all")
    changed: dict[str, Any] = {
        **({"sensor": sensor} if sensor else {}),
        **({"indenters": list(indenters)} if indenters else {}),
        **({"touches": dict.fromkeys(touches, 1)} if touches else {}),
    }
    return plan_of({**given, **changed}, str(path))


def plan_of(document: Mapping[str, Any], place: str) -> TouchPlan:
    """Return the plan of a mapping that has all `KEYS`; errors as `read_plan`."""
    specification = load_sensor(str(document["sensor"]))
    check_is_quasi_static(specification)
    return TouchPlan(
        document=document,
        sensor=specification,
        indenters=_indenters(document["indenters"], place),
        touches=_touches(document["touches"], place),
        frames=_whole(document["frames"], f"{place}: frames", LEAST_FRAMES, 10_000),
        rate_hz=_number(document["rate_hz"], f"{place}: rate_hz", 0.1, 1000.0),
        image_px=_size(document["image_side_px"], specification, f"{place}: image_side_px"),
        touches_a_gel=_whole(document["touches_a_gel"], f"{place}: touches_a_gel", 1, 10_000),
        contents=_contents(document["contents"], specification, place),
        pose=_ranges(document["pose"], POSE_LIMITS, f"{place}: pose", needs_all=True),
        gel=_gel(document["gel"], specification, place),
        effects=_effects(document["effects"], place),
        noise=_ranges(document["noise"], NOISE_LIMITS, f"{place}: noise", needs_all=True),
    )


def _indenters(given: Any, place: str) -> tuple[Indenter, ...]:
    names = [given] if isinstance(given, str) else given
    are_names = isinstance(names, list) and all(isinstance(n, str) and n for n in names)
    if not are_names or not names:
        raise ValueError(
            f"{place}: indenters is {value_text(given)}, expected names, definitions or files of "
            "indenters, or folders of files"
        )
    found: list[Indenter] = []
    for name in names:
        folder = expanded(name)
        # Unlike Path.is_dir, it takes any name.
        if not os.path.isdir(folder):
            found.append(load_indenter(name))
            continue
        files = indenter_files(folder)
        if not files:
            raise ValueError(f"{place}: the folder {folder} holds no mesh of an indenter")
        found += [replace(load_indenter(path), name=path.stem) for path in files]
    return tuple(found)


def _touches(given: Any, place: str) -> dict[str, float]:
    if not isinstance(given, dict) or not given:
        raise ValueError(f"{place}: touches is {value_text(given)}, expected kinds and shares")
    for kind, share in given.items():
        if kind not in KINDS:
            raise ValueError(
                f"{place}: touches has the kind {value_text(kind)}{did_you_mean(str(kind), KINDS)},"
                f" expected of {', '.join(KINDS)}"
            )
        _number(share, f"{place}: touches.{kind}", 0.0, 1e6)
    shares = {kind: float(share) for kind, share in given.items() if share > 0}
    if not shares:
        raise ValueError(f"{place}: touches has no share above 0")
    if GRASP in shares and len(shares) > 1:
        raise ValueError(
            f"{place}: touches has {GRASP}, of two sensors, next to kinds of one; make a data set "
            "of each"
        )
    return shares


def _contents(given: Any, sensor: SensorSpecification, place: str) -> tuple[str, ...]:
    wrong = [each for each in given if each not in CONTENTS] if isinstance(given, list) else [given]
    if wrong or not given:
        raise ValueError(
            f"{place}: contents has {value_text(wrong[0] if wrong else given)}, expected of "
            f"{', '.join(CONTENTS)}"
        )
    # The one thing that not every sensor has.
    no_markers = not sensor.markers.columns
    return tuple(
        each for each in CONTENTS if each in given and not (each == "markers" and no_markers)
    )


def _gel(given: Any, sensor: SensorSpecification, place: str) -> dict[str, Range]:
    limits = {
        name: (p.unit, *p.bounds)
        for name, p in GEL_PARAMETERS.items()
        if p.name and np.isscalar(getattr(values_of(sensor), name))
    }
    return _ranges(given, limits, f"{place}: gel", own=vars(values_of(sensor)))


def _effects(given: Any, place: str) -> dict[str, Mapping[str, Range]]:
    if given is None:
        return {}
    if not isinstance(given, dict):
        raise ValueError(f"{place}: effects is {value_text(given)}, expected names and parameters")
    library = load_effects()
    found: dict[str, Mapping[str, Range]] = {}
    for name, ranges in given.items():
        effect = library.get(name)
        if effect is None or effect.motion or effect.response:
            kept = [n for n, e in library.items() if not (e.motion or e.response)]
            raise ValueError(
                f"{place}: effects has {value_text(name)}{did_you_mean(str(name), kept)}, expected "
                f"effects on gel or image: {', '.join(kept)}"
            )
        limits = {p.name: (p.unit, p.low, p.high) for p in effect.parameters}
        found[name] = _ranges(ranges, limits, f"{place}: effects.{name}")
    return found


def _ranges(
    given: Any,
    limits: Mapping[str, tuple[str, float, float]],
    place: str,
    *,
    needs_all: bool = False,
    own: Mapping[str, float] | None = None,
) -> dict[str, Range]:
    """Return ranges, of which each has its unit and lies within limits."""
    if given is None:
        given = {}
    if not isinstance(given, dict):
        raise ValueError(f"{place} is {value_text(given)}, expected ranges by name")
    missing = sorted(set(limits) - set(given)) if needs_all else []
    if missing:
        raise ValueError(f"{place} lacks {', '.join(missing)}; low: 0 and high: 0 leave it out")
    found = {}
    for name, entry in given.items():
        if name not in limits:
            raise ValueError(
                f"{place} has {value_text(name)}{did_you_mean(str(name), limits)}, expected of "
                f"{', '.join(limits)}"
            )
        unit, low, high = limits[name]
        called = f"{place}.{name}"
        if not isinstance(entry, dict) or set(entry) != {"low", "high", "unit"}:
            raise ValueError(f"{called} is {value_text(entry)}, expected low, high and unit")
        units = (unit, OF_OWN) if own is not None else (unit,)
        if entry["unit"] not in units:
            expected = " or ".join(value_text(each) for each in units)
            raise ValueError(
                f"{called} has the unit {value_text(entry['unit'])}, expected {expected}"
            )
        is_factor = entry["unit"] == OF_OWN and own is not None
        scale = float(own[name]) if own is not None and is_factor else 1.0
        ends = [_number(entry[end], f"{called}.{end}", -np.inf, np.inf) for end in ("low", "high")]
        if ends[0] > ends[1]:
            raise ValueError(
                f"{called} is upside down: low is {ends[0]:g} and high is {ends[1]:g}; swap them"
            )
        for end in ends:
            if not low <= scale * end <= high:
                meant = f"{end:g} of own, which is {scale * end:g}" if is_factor else f"{end:g}"
                raise ValueError(
                    f"{called} reaches {meant}, expected {low:g} to {high:g} {unit}".rstrip()
                )
        found[name] = Range(ends[0], ends[1], is_factor)
    return found


def _number(value: Any, called: str, low: float, high: float) -> float:
    if not is_number(value) or not low <= value <= high or not np.isfinite(value):
        expected = f" from {low:g} to {high:g}" if np.isfinite([low, high]).all() else ""
        raise ValueError(f"{called} is {value_text(value)}, expected a number{expected}")
    return float(value)


def _whole(value: Any, called: str, low: int, high: int) -> int:
    if _number(value, called, low, high) != int(value):
        raise ValueError(f"{called} is {value_text(value)}, expected a whole number")
    return int(value)


def _size(value: Any, sensor: SensorSpecification, called: str) -> tuple[int, int]:
    """Return the size of the camera's image with a longer side of so many pixels."""
    camera = sensor.camera
    share = _whole(value, called, 16, 4096) / max(camera.width, camera.height)
    if share >= 1.0:
        return camera.width, camera.height
    return round(share * camera.width), round(share * camera.height)
