# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes data sets with a hidden effect, and seals what it is."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.data.presses import Press
from dotsim_ros.gel.values import GelValues
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.twin.simulator import REFERENCE_MODULUS_PA, GelSimulator
from studies.hidden.laws import LAWS, LawAnswer, LawMotion


@dataclass(frozen=True)
class Truth:
    """What is hidden: names and sizes of laws; none for a null."""

    effects: tuple[tuple[str, float], ...]

    def sealed(self) -> str:
        """Return the text of the truth's file."""
        return json.dumps({"effects": [list(pair) for pair in self.effects]}, sort_keys=True)

    def digest(self) -> str:
        """Return the hash that is published before the search."""
        return hashlib.sha256(self.sealed().encode()).hexdigest()


def library_names(truth: Truth) -> set[str]:
    """Return the names that the library has for what is hidden; "" for what it does not know."""
    return {LAWS[name].library for name, _ in truth.effects}


def part_names(truth: Truth) -> set[str]:
    """Return the names that the library has for further parts of what is hidden."""
    return {part for name, _ in truth.effects for part in LAWS[name].also}


def answer_of(
    simulator: GelSimulator,
    values: GelValues,
    indenter: Indenter,
    press: Press,
    truth: Truth,
    *,
    session_s: float,
    seed: int,
    number: int,
) -> tuple[FloatArray, FloatArray]:
    """Return skin (F, V, 3) and force (F, 3) of a press in a reality.

    Args:
        simulator: of the gel.
        values: the gel without the hidden effects.
        indenter: what presses.
        press: whose poses and times are followed.
        truth: the effects.
        session_s: when the press begins.
        seed: of what is random in the unit's effects.
        number: of the trajectory, for what is random in each.
    """
    random = np.random.default_rng([seed, number])
    relaxation = None
    force = np.zeros((press.frame_count, 3)) if press.force_n is None else press.force_n
    poses = list(press.poses)
    for name, size in truth.effects:
        law = LAWS[name]
        if law.gel is not None:
            values, found = law.gel(values, size)
            relaxation = relaxation if found is None else found
        if law.motion is not None:
            motion = LawMotion(poses, press.stamp_s, force)
            poses = law.motion(motion, size, np.random.default_rng(seed), random)
    solved = simulator.press(
        replace(values, youngs_modulus_pa=REFERENCE_MODULUS_PA),
        indenter,
        poses,
        press.stamp_s,
        relaxation=relaxation,
    )
    scale = values.youngs_modulus_pa / REFERENCE_MODULUS_PA
    skin, load = solved.skin_position_m, scale * solved.force_n
    for name, size in truth.effects:
        law = LAWS[name]
        if law.answer is not None:
            rest = simulator.skin.rest_position_m
            skin, load = law.answer(LawAnswer(skin, load, rest, press.stamp_s, session_s), size)
    return skin, load


def write_truth(path: Path, truth: Truth, **details: Any) -> None:
    """Write the truth; only what scores may read it."""
    path.write_text(
        json.dumps({**json.loads(truth.sealed()), **details}, indent=2), encoding="utf-8"
    )
