# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Real presses of a ball, told by classifiers that learnt from simulated touches of five shapes.

Every other figure of this study is of a synthetic sensor. Here the images are of a real GelSight
(`studies.optics.gelsight`): 32 presses of a ball and nothing else. An image model is fitted on
half of them, renders simulated touches of a ball and of four other shapes, and the classifiers that
learn from these are judged on the other half, then the other way round. Since all that is real is a
ball, "ball" might be what a classifier takes for real, or what a model that has only seen balls
draws. So each is judged on touches of the other shapes as well, drawn by an image model that it
did not learn from and that was fitted on the presses it is judged on: they must not be called a
ball.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay

from dotsim_ros.data.contact_circle import BallPress
from dotsim_ros.gel.make import make_gel
from dotsim_ros.geometry.indenter import (
    Indenter,
    cone,
    flat_punch,
    lying_cylinder,
    sphere,
    torus,
)
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray, ImageArray, IntArray
from dotsim_ros.io.cache import content_key
from dotsim_ros.io.provenance import provenance
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.ball_presses import (
    STEP_S,
    UNCHANGING,
    FlatScene,
    flat_scene,
    gel_presses,
    press_profiles,
)
from dotsim_ros.twin.footage import OpticalPress
from studies.classification.classifier import (
    ClassifierSettings,
    classified,
    confusion,
    touched,
    touched_as_taken,
    train_classifier,
)
from studies.optics.ball_recordings import FOTS, RECORDINGS, read_ball_recording
from studies.optics.gelsight import SENSOR
from studies.optics.models import MADE_BY, FitSettings, factory_of

BALL = "ball"
BALL_RADIUS_M = RECORDINGS[FOTS].ball_radius_m
SHAPES: Mapping[str, Indenter] = {
    BALL: sphere(BALL_RADIUS_M),
    "cone": cone(0.9, 0.004, 0.0004),
    "lying_cylinder": lying_cylinder(0.0015, 0.006, 0.0004),
    "punch": flat_punch(0.0018, 0.006, 0.0004),
    "ring": torus(0.0016, 0.0006),
}
"""About as large as the ball, which leaves circles of 1.8 to 2.4 mm radius."""
DEPTHS_M = tuple(1e-3 * np.arange(0.6, 2.01, 0.2))
"""Of the touches, the same for every shape: depth must not tell which one it is."""
OTHER_MODEL = {"ours": "taxim", "taxim": "ours"}
"""By which a classifier is shown the other shapes that it did not learn from one."""
MODELS = tuple(OTHER_MODEL)
FOLDS = 2
APART = 5
"""Every fifth simulated touch is not learnt from."""
SPREAD_M = 0.003
"""Largest distance of a touch from the image's middle along each axis, as in the recording."""


@dataclass(frozen=True)
class BallStudy:
    """What is asked.

    Attributes:
        directory: of the recording.
        models: image models, of `MODELS`.
        touches: simulated, of each shape.
        seeds: classifiers of each model and half.
        classifier: how they are trained.
        fit: how image models are fitted.
    """

    directory: Path
    models: tuple[str, ...] = MODELS
    touches: int = 60
    seeds: int = 5
    classifier: ClassifierSettings = field(default_factory=ClassifierSettings)
    fit: FitSettings = field(default_factory=FitSettings)


def evaluate_real_ball(
    study: BallStudy,
    state: Path,
    sensor: SensorSpecification = SENSOR,
) -> dict[str, Any]:
    """Return how real presses of a ball are told, a row for each image model.

    Each row has, as `mean` and `std` between seeds: `called_ball` (share of the real presses),
    `others_called_ball` (share of the touches of other shapes, by another image model) and
    `simulated` (share told right of touches that were not learnt from); `told` counts the classes
    that the real presses were taken for and `idle_told` those of the untouched image, of all
    seeds.

    Args:
        study: what is asked.
        state: folder of the networks' trainings, each below a key of what decides it.
        sensor: a flat pad.

    Raises:
        FileNotFoundError, ValueError: as `read_ball_recording`.
    """
    recording = read_ball_recording(study.directory, FOTS)
    idle, presses = recording.idle, recording.presses
    scene = flat_scene(idle, sensor, recording.pixels_per_metre)
    measured = gel_presses(presses, scene, press_profiles(sensor, BALL_RADIUS_M))
    touches, labels = simulated_pad_touches(scene, sensor, study.touches, study.fit.seed)
    print(f"{len(touches)} simulated touches next to {len(presses)} real presses of a ball")
    names = tuple(SHAPES)
    drawn = {
        (model, half): _drawn(
            model,
            [p for k, p in enumerate(measured) if k % FOLDS != half],
            touches,
            scene,
            study,
            state,
        )
        for model in {*study.models, *(OTHER_MODEL[m] for m in study.models)}
        for half in range(FOLDS)
    }
    rows = {}
    for model in study.models:
        rows[model] = row = _row(model, drawn, presses, idle, labels, study)
        print(
            f"{model}: {100.0 * row['called_ball']['mean']:.1f} % of the real presses called a "
            f"ball, and {100.0 * row['others_called_ball']['mean']:.1f} % of other shapes"
        )
    return {
        "rows": rows,
        "classes": list(names),
        "presses": len(presses),
        "touches_of_each_shape": study.touches,
        "origin": provenance(),
    }


def _row(
    model: str,
    drawn: Mapping[tuple[str, int], ImageArray],
    presses: Sequence[BallPress],
    idle: ImageArray,
    labels: IntArray,
    study: BallStudy,
) -> dict[str, Any]:
    settings, ball = study.classifier, list(SHAPES).index(BALL)
    apart = np.arange(len(labels)) % APART == 0
    others = labels != ball
    real: list[list[int]] = [[] for _ in range(study.seeds)]
    untouched: list[int] = []
    false = np.zeros((study.seeds, FOLDS))
    right = np.zeros((study.seeds, FOLDS))
    for half in range(FOLDS):
        random = np.random.default_rng([study.fit.seed, half])
        seen = touched(drawn[model, half], idle, settings, random)
        # By another model, which was fitted on the half that is judged.
        strange = drawn[OTHER_MODEL[model], 1 - half][others]
        strange_seen = touched(strange, idle, settings, random)
        judged = np.stack([press.image for press in presses[half::FOLDS]])
        judged_seen = touched_as_taken(judged, idle, settings)
        blank = touched_as_taken(idle[None], idle, settings)
        for seed in range(study.seeds):
            network = train_classifier(
                seen[~apart], labels[~apart], len(SHAPES), settings, study.fit.seed + seed
            )
            real[seed] += classified(network, judged_seen).tolist()
            false[seed, half] = np.mean(classified(network, strange_seen) == ball)
            right[seed, half] = np.mean(classified(network, seen[apart]) == labels[apart])
            untouched += classified(network, blank).tolist()
    told = np.array(real)
    return {
        "called_ball": _summary((told == ball).mean(axis=1)),
        "others_called_ball": _summary(false.mean(axis=1)),
        "simulated": _summary(right.mean(axis=1)),
        "told": confusion([0] * told.size, told.ravel().tolist(), len(SHAPES))[0],
        "idle_told": confusion([0] * len(untouched), untouched, len(SHAPES))[0],
    }


def _summary(shares: FloatArray) -> dict[str, float]:
    return {"mean": float(shares.mean()), "std": float(shares.std())}


def _drawn(
    model: str,
    fitted_on: Sequence[OpticalPress],
    touches: Sequence[OpticalPress],
    scene: FlatScene,
    study: BallStudy,
    state: Path,
) -> ImageArray:
    """Return what a model, fitted on some real presses, makes of each touch (N, H, W, 3)."""
    own = state / content_key(MADE_BY, model, study.fit, fitted_on)
    make = factory_of(model, study.fit, state=own)
    fitted = make(fitted_on, scene.rest, scene.camera)
    shutil.rmtree(own, ignore_errors=True)
    return np.concatenate([fitted.predict(touch, scene.rest) for touch in touches])


def simulated_pad_touches(
    scene: FlatScene, sensor: SensorSpecification, count: int, seed: int
) -> tuple[list[OpticalPress], IntArray]:
    """Return touches of each of `SHAPES` at random places, turns and depths, and their classes.

    Each shape is pressed into the middle of the pad once, ever deeper; the pad is wide, so that its
    displacement is laid where a touch is.

    Args:
        scene: camera and pad.
        sensor: whose gel is pressed.
        count: of each shape.
        seed: of the draws.

    Raises:
        ValueError: the gel could not be solved.
    """
    renderer = SkinRenderer(scene.camera, scene.skin)
    image = ImageRenderer(scene.camera, scene.skin, scene.rest.idle, lighting=UNCHANGING)
    rest = scene.skin.rest_position_m
    plane = Delaunay(rest[:, :2])
    touches, labels = [], []
    for rank, (name, fields) in enumerate(zip(SHAPES, _displacements(scene, sensor), strict=True)):
        random = np.random.default_rng([seed, rank])
        for number in range(count):
            place = random.uniform(0.0, len(fields) - 1.0)
            lower = min(int(place), len(fields) - 2)
            motion = (lower + 1 - place) * fields[lower] + (place - lower) * fields[lower + 1]
            moved = laid(
                plane,
                motion,
                rest,
                random.uniform(-SPREAD_M, SPREAD_M, size=2),
                random.uniform(0.0, 2.0 * np.pi),
            )
            view = renderer.render(moved)
            touches.append(
                OpticalPress(
                    name=f"{name}_{number}",
                    indenter=name,
                    tip_depth_m=np.array([float((rest - moved)[:, 2].max())]),
                    measured=scene.rest.idle[None],
                    depth_m=view.depth_m[None],
                    normal=view.normal[None],
                    warped=image.warp(view)[None],
                )
            )
            labels.append(rank)
    return touches, np.array(labels)


def _displacements(scene: FlatScene, sensor: SensorSpecification) -> list[FloatArray]:
    """Return how each of `SHAPES` moves the pad's face at each of `DEPTHS_M`, (D, V, 3)."""
    gel = make_gel(sensor, scene.skin, SHAPES[BALL])
    top, rest = sensor.gel.pad_size_m[2], scene.skin.rest_position_m
    fields = []
    for shape in SHAPES.values():
        gel.set_indenter(shape)
        poses = [Pose(np.array([0.0, 0.0, top - depth])) for depth in DEPTHS_M]
        fields.append(np.stack([gel.step(pose, STEP_S).skin_position_m - rest for pose in poses]))
    return fields


def laid(
    plane: Delaunay, field: FloatArray, rest: FloatArray, place_m: FloatArray, turn_rad: float
) -> FloatArray:
    """Return a pad's face (V, 3) pressed at another place and turn.

    Args:
        plane: of the vertices' x and y at rest.
        field: (V, 3) displacement by a press in the middle.
        rest: (V, 3) the face at rest.
        place_m: (2,) of the press.
        turn_rad: of the press, about z.
    """
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    turn = np.array([[cos, -sin], [sin, cos]])
    motion = LinearNDInterpolator(plane, field, fill_value=0.0)((rest[:, :2] - place_m) @ turn)
    motion[:, :2] = motion[:, :2] @ turn.T
    return np.asarray(rest + motion)
