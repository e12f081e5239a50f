# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What is wrong with each of a series of units, and what each unit is like: drawn by a seed.

A series is balanced: each kind of set has its share of any stretch of it, and each effect lies in
both of its halves. What is hidden is described as the finite elements have it, and, where the
library of effects knows it, by the name and the first parameter that the library has for it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.random import Generator

from dotsim_ros.gel.values import values_of
from dotsim_ros.specification import SensorSpecification

NULL, SINGLE, PAIR, OUTSIDE = "null", "single", "pair", "outside"
NOTHING = "nothing"
COMPOSITION = {NULL: 10, SINGLE: 14, PAIR: 4, OUTSIDE: 4}
"""Sets of each kind, of 32."""
HALVES = ("development", "opened")
"""The second half is judged once."""

DECLARED = {
    "youngs_modulus": 0.08,
    "poisson_ratio": 0.2,
    "friction": 0.2,
    "thickness": 0.01,
    "pose": 0.03e-3,
    "clock": 0.003,
    "force_gain": 0.03,
}
"""One deviation of what units, their mounting and their instruments are declared to differ by: the
logarithms of E, of 1/2 - nu and of the friction, shares of thickness and force, metres on each
axis, seconds."""
ORDINARY = 0.5
"""An ordinary unit's constants deviate by a normal of this many of those, at most by one."""
DECOY = (1.0, 1.5)
"""A decoy deviates by so many of them."""
DECOYS = 2
SPACINGS_M = (2.3e-3, 3.0e-3)
"""Range of the size of the elements where a unit is pressed."""
CONTACT_STIFFNESS = (60.0, 150.0)
"""Range of the contact's stiffness, in the units of a sensor's file."""


@dataclass(frozen=True)
class SolvedLaw:
    """Something that may be wrong with a unit.

    Attributes:
        name: in the truth.
        low, high: range of its size.
        unit: of its size.
        library: name of the effect that the library knows it by; empty for one it does not know.
    """

    name: str
    low: float
    high: float
    unit: str
    library: str = ""


LAWS: Mapping[str, SolvedLaw] = {
    law.name: law
    for law in (
        SolvedLaw("slippery", 0.3, 0.6, "of friction", "coulomb_slip"),
        SolvedLaw("ogden_stiffening", 0.2, 0.4, "of C10", "hyperelastic_stiffening"),
        SolvedLaw("two_branches", 0.12, 0.35, "share", "viscoelastic_relaxation"),
        SolvedLaw("compressible", 0.438, 0.455, "nu", "compressibility"),
        SolvedLaw("soft_base", 3.0e-5, 9.0e-5, "m/N", "base_compliance"),
        SolvedLaw("larger_core", 0.06, 0.12, "of thickness", "thickness_error"),
        SolvedLaw("slipping_core", 0.7, 1.4, "rad"),
        SolvedLaw("stiff_inclusion", 2.5e-3, 3.5e-3, "m"),
        SolvedLaw("stiff_outer_layer", 1.6, 2.5, "times"),
        SolvedLaw("uneven_cure", 1.4, 2.0, "times"),
        SolvedLaw("late", 0.03, 0.08, "s", "latency"),
        SolvedLaw("mounted_off", 0.2e-3, 0.4e-3, "m", "pose_offset"),
    )
}
"""`two_branches` relax in 0.6 and 3 s, the first with 60 % of the share; `slipping_core` is the
half angle about the apex within which the gel slides on its core; `stiff_inclusion` the radius of a
ball ten times as stiff; `uneven_cure` how much stiffer one side is. Poses are `late`, or the sensor
is `mounted_off` along +z."""
OF_ROBOT = ("late", "mounted_off")
"""Laws that a series has only where it is asked for them."""
KNOWN = tuple(name for name, law in LAWS.items() if law.library and name not in OF_ROBOT)
UNKNOWN = tuple(name for name, law in LAWS.items() if not law.library)


@dataclass(frozen=True)
class UnitConstants:
    """What a unit, its mounting and its instruments are like, without what is wrong with it.

    Attributes:
        youngs_modulus_pa, poisson_ratio, friction: of gel and contact.
        c20_ratio: Yeoh's C20, of C10.
        thickness_share: of the gel's thickness, more than declared.
        pose_bias_m: (3,) recorded minus true position of the indenter.
        clock_s: how much later than the poses skin and force are stamped.
        force_gain: recorded over true force.
        spacing_m: of the elements where it is pressed.
        contact_stiffness: in the unit of a sensor's file.
    """

    youngs_modulus_pa: float
    poisson_ratio: float
    friction: float
    c20_ratio: float
    thickness_share: float
    pose_bias_m: tuple[float, float, float]
    clock_s: float
    force_gain: float
    spacing_m: float
    contact_stiffness: float


@dataclass(frozen=True)
class HiddenEffect:
    """Something that is wrong with a unit.

    Attributes:
        name: of its law.
        size: in the law's unit.
        against_twin: the library's first parameter with which a twin as declared behaves like the
            unit; None where none does.
    """

    name: str
    size: float
    against_twin: float | None


@dataclass(frozen=True)
class SolvedUnit:
    """One set of the series.

    Attributes:
        name: of its folder, which does not reveal what is hidden.
        kind: null, single, pair or outside.
        half: development or opened.
        seed: of all that is drawn for it.
        effects: what is wrong.
        decoys: constants that deviate more than those of an ordinary unit.
        constants: of the unit.
    """

    name: str
    kind: str
    half: str
    seed: tuple[int, int]
    effects: tuple[HiddenEffect, ...]
    decoys: tuple[str, ...]
    constants: UnitConstants

    def size_of(self, name: str) -> float | None:
        """Return the size of an effect; None where it is not there."""
        return next((effect.size for effect in self.effects if effect.name == name), None)

    def sealed(self) -> str:
        """Return the text of the truth's file."""
        record = {
            "kind": self.kind,
            "effects": [
                asdict(effect)
                | {"unit": LAWS[effect.name].unit, "library": LAWS[effect.name].library}
                for effect in self.effects
            ],
            "decoys": list(self.decoys),
            "unit": asdict(self.constants),
        }
        return json.dumps(record, indent=2, sort_keys=True) + "\n"

    def digest(self) -> str:
        """Return the SHA-256 of the truth's file."""
        return hashlib.sha256(self.sealed().encode()).hexdigest()


def _against_twin(
    law: SolvedLaw, size: float, own: UnitConstants, sensor: SensorSpecification
) -> float | None:
    """Return what the library's first parameter of an effect must be for a twin as declared to
    behave like the unit, its own constants included; None where none does."""
    if law.name == "slippery":
        return size * own.friction / sensor.contact.friction_coefficient
    if law.name == "larger_core":
        return (1.0 + own.thickness_share) * (1.0 - size) - 1.0
    if law.name == "compressible":
        return float(np.log((0.5 - size) / (0.5 - values_of(sensor).poisson_ratio)))
    if law.name == "late":
        return size + own.clock_s
    if law.name == "mounted_off":
        return size - own.pose_bias_m[2]
    # Ogden's law is not Yeoh's, and two branches are not one: no parameter makes them alike.
    return size if law.name == "soft_base" else None


def draw_series(
    sensor: SensorSpecification, count: int, seed: int, hidden: tuple[str, ...] = ()
) -> list[SolvedUnit]:
    """Return the units of a series, in the order in which they are made.

    Args:
        sensor: as declared.
        count: how many.
        seed: of everything.
        hidden: names of laws, or `NOTHING`, of each unit; empty to draw them too.

    Raises:
        ValueError: a count that is not positive, or names that are not these.
    """
    if hidden != (NOTHING,) and (unknown := sorted({*hidden} - {*LAWS})):
        raise ValueError(
            f"nothing called {', '.join(unknown)} can be hidden; choose of {', '.join(LAWS)}, or "
            f"{NOTHING} alone"
        )
    random = np.random.default_rng([seed, 0])
    kinds = [_kind_of(hidden)] * count if hidden else _kinds(count, random)
    singles = random.permutation(np.array(KNOWN)).tolist()
    pairs = [(a, b) for i, a in enumerate(KNOWN) for b in KNOWN[i + 1 :]]
    chosen_pairs = [pairs[k] for k in random.permutation(len(pairs)).tolist()]
    outside = random.permutation(np.array(UNKNOWN)).tolist()
    first_half = {kind: int(random.integers(2)) for kind in COMPOSITION}
    done = dict.fromkeys(COMPOSITION, 0)
    units = []
    for number, kind in enumerate(kinds):
        place = done[kind]
        done[kind] += 1
        names: tuple[str, ...] = ()
        # A further round of the effects begins in the other half.
        rounds = place // len(singles) if kind == SINGLE else place // len(outside)
        if kind == SINGLE:
            names = (singles[place % len(singles)],)
        elif kind == PAIR:
            names = chosen_pairs[place % len(chosen_pairs)]
        elif kind == OUTSIDE:
            names = (outside[place % len(outside)],)
        if hidden:
            names = tuple(name for name in hidden if name != NOTHING)
        shift = rounds if kind in (SINGLE, OUTSIDE) else 0
        half = HALVES[(place + shift + first_half[kind]) % 2]
        own = np.random.default_rng([seed, 1, number])
        sizes = [float(own.uniform(LAWS[name].low, LAWS[name].high)) for name in names]
        decoys: tuple[str, ...] = ()
        if kind == NULL:
            drawn = own.choice(len(DECLARED), DECOYS, replace=False)
            decoys = tuple(sorted(list(DECLARED)[k] for k in drawn.tolist()))
        constants = _constants(sensor, decoys, own)
        effects = tuple(
            HiddenEffect(name, size, _against_twin(LAWS[name], size, constants, sensor))
            for name, size in zip(names, sizes, strict=True)
        )
        units.append(
            SolvedUnit(f"set_{number:02d}", kind, half, (seed, number), effects, decoys, constants)
        )
    return units


COMMISSIONING = "commissioning"
COMMISSIONED = 3
"""Meshes on which the unit as declared is solved, each along trajectories of its own: one alone
does not show what the model is off by."""
_COMMISSIONING_NUMBER = 1_000_000
"""In its seed, that of the first mesh; no set has it."""


def commissioning_unit(sensor: SensorSpecification, seed: int, mesh: int) -> SolvedUnit:
    """Return the unit as declared, with which a twin is calibrated before it is put to the sets.

    What a model calls friction or stiffness is an effective constant; that of another solver's
    units is not that of another sensor's.

    Args:
        sensor: as declared.
        seed: of the series.
        mesh: number of its mesh and contact stiffness, which are drawn; the rest is the same.
    """
    number = _COMMISSIONING_NUMBER + mesh
    own = np.random.default_rng([seed, 1, number])
    declared = values_of(sensor)
    constants = UnitConstants(
        youngs_modulus_pa=declared.youngs_modulus_pa,
        poisson_ratio=declared.poisson_ratio,
        friction=declared.friction,
        c20_ratio=declared.c20_ratio,
        thickness_share=0.0,
        pose_bias_m=(0.0, 0.0, 0.0),
        clock_s=0.0,
        force_gain=1.0,
        spacing_m=float(own.uniform(*SPACINGS_M)),
        contact_stiffness=float(own.uniform(*CONTACT_STIFFNESS)),
    )
    return SolvedUnit(COMMISSIONING, NULL, HALVES[0], (seed, number), (), (), constants)


def _kind_of(hidden: tuple[str, ...]) -> str:
    """Return the kind of a set in which these are hidden."""
    if hidden == (NOTHING,):
        return NULL
    if not all(LAWS[name].library for name in hidden):
        return OUTSIDE
    return SINGLE if len(hidden) == 1 else PAIR


def _kinds(count: int, random: Generator) -> list[str]:
    """Return the kind of each set: shares as composed, each spread over the series."""
    if count < 1:
        raise ValueError(f"{count} sets, expected at least one")
    total = sum(COMPOSITION.values())
    exact = {kind: count * weight / total for kind, weight in COMPOSITION.items()}
    counts = {kind: int(number) for kind, number in exact.items()}
    most_left = sorted(exact, key=lambda kind: counts[kind] - exact[kind])
    for kind in most_left[: count - sum(counts.values())]:
        counts[kind] += 1
    places = [
        ((number + float(random.random())) / of, kind)
        for kind, of in counts.items()
        for number in range(of)
    ]
    return [kind for _, kind in sorted(places)]


def _constants(
    sensor: SensorSpecification, decoys: tuple[str, ...], random: Generator
) -> UnitConstants:
    def moved(name: str) -> float:
        ordinary = float(np.clip(ORDINARY * random.standard_normal(), -1.0, 1.0))
        far = float(random.uniform(*DECOY) * random.choice((-1.0, 1.0)))
        return DECLARED[name] * (far if name in decoys else ordinary)

    declared = values_of(sensor)
    direction = random.standard_normal(3)
    bias = np.abs(moved("pose")) * np.sign(direction) * (0.5 + 0.5 * random.random(3))
    return UnitConstants(
        youngs_modulus_pa=declared.youngs_modulus_pa * float(np.exp(moved("youngs_modulus"))),
        poisson_ratio=0.5 - (0.5 - declared.poisson_ratio) * float(np.exp(moved("poisson_ratio"))),
        friction=declared.friction * float(np.exp(moved("friction"))),
        c20_ratio=declared.c20_ratio,
        thickness_share=moved("thickness"),
        pose_bias_m=(float(bias[0]), float(bias[1]), float(bias[2])),
        clock_s=moved("clock"),
        force_gain=1.0 + moved("force_gain"),
        spacing_m=float(random.uniform(*SPACINGS_M)),
        contact_stiffness=float(random.uniform(*CONTACT_STIFFNESS)),
    )


def truth_of(text: str) -> dict[str, Any]:
    """Return what the text of a truth's file says.

    Raises:
        ValueError: it is none.
    """
    record = json.loads(text)
    if not isinstance(record, dict) or not {"kind", "effects", "decoys", "unit"} <= set(record):
        raise ValueError(
            "the truth of a set names its kind, effects, decoys and unit; this one does not"
        )
    return record
