# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Models of the gel's surface, fitted on some presses of a data set and scored on the others."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from dotsim_ros.data.presses import Prediction, Press
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.mesh_distance import surface_distance
from dotsim_ros.geometry.skin_mesh import SkinMesh, tip_depth_m
from dotsim_ros.twin.press_metrics import (
    JUDGED_DEPTH_M,
    PressFrameScore,
    measured_skin,
    root_mean_square,
    score_press,
)
from dotsim_ros.twin.surface_metrics import weighted_rms


@dataclass(frozen=True)
class Measured:
    """What a data set holds, read.

    Attributes:
        presses: by name.
        indenters: by name.
        skin: at rest.
        left_out: presses that could not be read, with the reason, by name.
    """

    presses: dict[str, Press]
    indenters: dict[str, Indenter]
    skin: SkinMesh
    left_out: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Split:
    """Names of the presses to fit on and to judge on.

    Attributes:
        name: "held_out", or the indenter that is left out.
        train: names to fit on.
        test: names to judge on.
    """

    name: str
    train: tuple[str, ...]
    test: tuple[str, ...]


def leave_one_indenter_out(indenter_of: Mapping[str, str]) -> Iterator[Split]:
    """Yield a split for each indenter: its presses are judged on, all others fitted on.

    Args:
        indenter_of: indenter of each press, by the press's name.

    Raises:
        ValueError: fewer than two indenters.
    """
    indenters = sorted(set(indenter_of.values()))
    if len(indenters) < 2:
        raise ValueError(f"leaving one indenter out takes two at least, got {indenters}")
    names = sorted(indenter_of)
    for left_out in indenters:
        yield Split(
            left_out,
            tuple(n for n in names if indenter_of[n] != left_out),
            tuple(n for n in names if indenter_of[n] == left_out),
        )


class Model(Protocol):
    """A simulator of the gel's surface."""

    @property
    def name(self) -> str:
        """How tables call it."""

    def predict(self, press: Press, indenter: Indenter, skin: SkinMesh) -> Prediction:
        """Return the skin, and the force where it has one, at the poses of a press.

        Nothing of the press is read but its poses and stamps.

        Args:
            press: the poses.
            indenter: the shape that presses.
            skin: the measured skin at rest.
        """


Factory = Callable[[Split, Sequence[Press], Mapping[str, Indenter], SkinMesh], Model]
"""Makes a model for a split, given the presses to fit it on, their indenters, and the skin."""


@dataclass(frozen=True)
class Failure:
    """A press that a model could not predict, and why."""

    press: str
    reason: str


@dataclass(frozen=True)
class ModelScores:
    """What one model got on the presses of a split.

    Attributes:
        scores: of every frame judged.
        failures: presses that it could not predict, which are in no score.
    """

    scores: tuple[PressFrameScore, ...]
    failures: tuple[Failure, ...] = ()


def floor_scores(
    press: Press,
    indenter: Indenter,
    skin: SkinMesh,
    *,
    seed: int = 0,
    from_depth_m: float = JUDGED_DEPTH_M,
) -> list[PressFrameScore]:
    """Return what a perfect prediction would get: the measured surface against itself resampled,
    and forces against those measured.

    Scores that use no samples are zero here; `measurement_noise` gives their lower bound.
    """
    measured = measured_skin(press, skin)
    perfect = Prediction(measured, press.force_n)
    return score_press(press, perfect, indenter, skin, seed=seed, from_depth_m=from_depth_m)


@dataclass(frozen=True)
class MeasuredNoise:
    """What was measured before anything touched, where a model cannot be wrong.

    Attributes:
        skin_rms_m: distance from the measured vertices to the surface at rest.
        vertex_rms_m: distance to where each vertex rests.
        force_rms_n: of one component of the force.
        frames: how many.
    """

    skin_rms_m: float
    vertex_rms_m: float
    force_rms_n: float
    frames: int


def measurement_noise(presses: Iterable[Press], skin: SkinMesh) -> MeasuredNoise | None:
    """Return the noise of the frames before the first touch; None where there are none."""
    skin_m, vertex_m, force_n = [], [], []
    for press in presses:
        depth = tip_depth_m(skin, press.poses)
        if depth[0] >= 0.0 or press.force_n is None:
            continue
        first = measured_skin(press, skin)[0]
        distance = surface_distance(first, skin.rest_position_m, skin.triangles)
        skin_m.append(weighted_rms(distance, skin.rest_area_m2))
        moved = np.linalg.norm(first - skin.rest_position_m, axis=1)
        vertex_m.append(weighted_rms(moved, skin.rest_area_m2))
        force_n.append(press.force_n[0])
    if not skin_m:
        return None
    return MeasuredNoise(
        root_mean_square(skin_m), root_mean_square(vertex_m), root_mean_square(force_n), len(skin_m)
    )


def evaluate_model(
    factory: Factory, split: Split, measured: Measured, *, seed: int, from_depth_m: float
) -> ModelScores:
    """Fit a model on the training presses of a split and score it on the others.

    A press that the model cannot predict is reported, and the others are still judged.

    Args:
        factory: makes the model.
        split: what to fit on and to judge on.
        measured: the data set.
        seed: of the samples.
        from_depth_m: depth of the tip from which frames are judged.

    Raises:
        ValueError: the model could not be made.
    """
    train = [measured.presses[name] for name in split.train]
    model = factory(split, train, measured.indenters, measured.skin)
    scores: list[PressFrameScore] = []
    failures: list[Failure] = []
    for name in split.test:
        press = measured.presses[name]
        indenter = measured.indenters[press.indenter]
        try:
            prediction = model.predict(press, indenter, measured.skin)
            scores += score_press(
                press, prediction, indenter, measured.skin, seed=seed, from_depth_m=from_depth_m
            )
        # Solvers that fail raise either; the table says so rather than end.
        except (ValueError, RuntimeError) as error:
            failures.append(Failure(name, str(error)))
        print(f"{model.name}, {split.name}: {name}")
    return ModelScores(tuple(scores), tuple(failures))
