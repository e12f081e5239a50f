# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Classifiers learnt from simulated presses onto each skin, judged on CalculiX's and on shifts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from dotsim_ros.io.arrays import Float32Array, FloatArray, IntArray
from dotsim_ros.io.cache import PHYSICS, content_key
from dotsim_ros.io.documents import read_json
from dotsim_ros.io.files import cache_directory, write_json
from dotsim_ros.io.provenance import provenance
from dotsim_ros.specification import SensorSpecification, load_sensor
from studies.classification.classifier import (
    ClassifierSettings,
    TouchClassifier,
    classified,
    confusion,
    train_classifier,
)
from studies.reference.run import calculix_path, calculix_version
from studies.tumour.images import AS_ASSUMED, OTHER, TO_LEARN_FROM, Eye, Light
from studies.tumour.pair.layer import LayerSpecification
from studies.tumour.pictures import write_presses
from studies.tumour.presses import Simulation, SolvedPress, coarse
from studies.tumour.reality import calculix_presses
from studies.tumour.rigid import rigid_presses
from studies.tumour.skins import (
    CLASSES,
    FACTORS,
    SKIN_NAMES,
    SKINS,
    PressPlan,
    SkinName,
    changed,
)

APART = 5
"""Every fifth simulated press of each class is not learnt from."""
LEARNT, JUDGED, SHIFTED = 0, 1, 2
"""Streams of the draws: presses to learn from, those of the stand-in, those of changed skins."""
OTHER_LIGHT = "other lights"
RIGID_TURNS, RIGID_SEEDS = 2, 1
"""Of the baseline, which knows no force and whose images no more of them make better."""
TRAINING = ClassifierSettings(epochs=25, learning_rate=2e-3, gain=0.05, stretch=0.0, turn_rad=0.0)
"""Chosen on simulated presses that were not learnt from. Small differences of where and how far the
gel moved tell the classes: images that are shifted, or scaled by more, were told worse."""
MOVED_M = 0.05e-3
"""Markers that move farther count where our skin is compared with CalculiX's."""


@dataclass(frozen=True)
class Study:
    """What is asked.

    Attributes:
        sensor: name or file of the sensor.
        skins: of `SKINS`.
        seeds: classifiers of each skin.
        presses: simulated ones of each class, for each skin.
        judged: CalculiX's, of each class, for each skin.
        shifted: simulated ones of each class, for each change of a skin; 0 for no changes.
        turns: of each simulated press about the sensor's axis, to learn from.
        judged_turns: of each press that is judged.
        judged_shares: of the deepest depth: the frames of a press that is judged.
        plan: of the presses.
        classifier: how classifiers are trained; its size and its noise play no part.

    Raises:
        ValueError: an unknown skin, too few presses, or no classifier.
    """

    sensor: str = "densetact2"
    skins: tuple[str, ...] = tuple(SKINS)
    seeds: int = 3
    presses: int = 30
    judged: int = 6
    shifted: int = 2
    turns: int = 5
    judged_turns: int = 3
    judged_shares: tuple[float, ...] = (0.75, 1.0)
    plan: PressPlan = field(default_factory=PressPlan)
    classifier: ClassifierSettings = TRAINING

    def __post_init__(self) -> None:
        unknown = sorted(set(self.skins) - set(SKINS))
        if unknown or not self.skins:
            raise ValueError(
                f"no skin {', '.join(unknown) or 'at all'}; known are {', '.join(SKINS)}"
            )
        if self.presses < 2:
            raise ValueError(
                f"{self.presses} simulated presses of each class, expected 2 at least: every "
                f"{APART}th is not learnt from"
            )
        for name, least in (("seeds", 1), ("judged", 1), ("judged_turns", 1), ("shifted", 0)):
            value = getattr(self, name)
            if value < least:
                raise ValueError(f"{name} is {value}, expected {least} or more")


def tumour(
    *,
    sensor: str = "densetact2",
    skins: tuple[SkinName, ...] = SKIN_NAMES,
    presses: int = 30,
    judged: int = 6,
    shifted: int = 2,
    classifiers: int = 3,
    epochs: int = 25,
    seed: int = 0,
    images: Path = Path("docs/images"),
    cache: Path | None = None,
) -> dict[str, Any]:
    """A bulge or a dent below a soft skin, learnt in simulation and judged on CalculiX's presses.

    Args:
        sensor: name or file of the sensor, a dome.
        skins: which.
        presses: simulated ones to learn from, of each class.
        judged: presses that CalculiX solves, of each class.
        shifted: presses for each changed skin, of each class.
        classifiers: of each skin.
        epochs: of a classifier's training.
        seed: of the draws.
        images: folder of the picture.
        cache: folder of the presses solved before (the user's cache).

    Raises:
        CalculixMissingError: CalculiX is not installed.
        ValueError: as `Study`, or a sensor that is not a dome.

    Returns:
        Each skin's rows by its name, `study`, and CalculiX's version.
    """
    calculix_path()
    torch.set_num_threads(1)
    study = Study(
        sensor,
        skins=skins,
        seeds=classifiers,
        presses=presses,
        judged=judged,
        shifted=shifted,
        plan=PressPlan(seed=seed),
        classifier=replace(TRAINING, epochs=epochs),
    )
    kept = cache or cache_directory() / "tumour"
    dome = coarse(load_sensor(sensor))
    simulation = Simulation(dome, kept)
    eye = Eye(dome, simulation.skin)
    figures: dict[str, Any] = {}
    shown: dict[str, list[SolvedPress]] = {}
    for name in study.skins:
        shown[name], asked = _judged_presses(study, name, dome, kept)
        key = content_key(
            (*PHYSICS, "../studies/classification", "../studies/tumour"),
            replace(study, skins=(name,)),
            SKINS[name],
            replace(dome, name=""),
            eye.idle,
        )
        path = kept / "rows" / f"{name}-{key}.json"
        if not path.is_file():
            rows = _skin_rows(study, name, simulation, eye, shown[name])
            rows["ours"]["presses_asked"] = asked
            write_json(path, rows | {"origin": provenance()})
        figures[name] = read_json(path)
        print(f"{name}: {100.0 * figures[name]['ours']['accuracy']:.1f} %")
    write_presses(images / "tumour.png", simulation, eye, shown)
    asked_for = {
        **asdict(study),
        "skins": {name: asdict(SKINS[name]) for name in study.skins},
        "classes": list(CLASSES),
    }
    return {**figures, "study": asked_for, "calculix": calculix_version()}


def _judged_presses(
    study: Study, name: str, sensor: SensorSpecification, cache: Path
) -> tuple[list[SolvedPress], int]:
    """Return CalculiX's presses onto a skin, and how many were asked for."""
    stream = 10 * list(SKINS).index(name) + JUDGED
    plan = replace(study.plan, shares=study.judged_shares)
    drawn = plan.drawn(study.judged, stream, in_plane=True)
    random = np.random.default_rng([study.plan.seed, stream, 1])
    turns = random.uniform(0.0, 2.0 * np.pi, (len(drawn), study.judged_turns))
    print(f"{name}: {len(drawn)} presses by CalculiX")
    return calculix_presses(sensor, SKINS[name], drawn, turns, cache), len(drawn)


@dataclass(frozen=True)
class _Judged:
    """Images as taken, their classes, and the press of each."""

    seen: Float32Array
    labels: IntArray
    press: IntArray


def _skin_rows(
    study: Study, name: str, simulation: Simulation, eye: Eye, real: Sequence[SolvedPress]
) -> dict[str, Any]:
    layer, stream = SKINS[name], 10 * list(SKINS).index(name)
    drawn = study.plan.drawn(study.presses, stream + LEARNT)
    simulated = simulation.solved(layer, drawn, study.turns)
    learnt = [p for n, p in enumerate(simulated) if n // 2 % APART != APART - 1]
    apart = [p for n, p in enumerate(simulated) if n // 2 % APART == APART - 1]
    reality = _taken(study, eye, real, AS_ASSUMED)
    networks, loads = _learnt(study, eye, learnt)
    rigid = rigid_presses(
        simulation.skin,
        layer,
        simulation.sensor.gel.outer_radius_m,
        [press.press for press in learnt],
        min(study.turns, RIGID_TURNS),
    )
    rigid_networks, _ = _learnt(replace(study, seeds=RIGID_SEEDS), eye, rigid)
    again = simulation.solved(layer, [press.press for press in real], 1)
    simulated_rows = {
        name: _row(networks, _taken(study, eye, presses, AS_ASSUMED))["accuracy"]
        for name, presses in (("simulated", apart), ("same_presses", again))
        if presses
    }
    ours = _row(networks, reality) | simulated_rows
    shifts = {OTHER_LIGHT: _row(networks, _taken(study, eye, real, OTHER))}
    if study.shifted:
        shifts |= _changed_rows(study, layer, stream, simulation, eye, networks)
    return {
        "ours": ours,
        "rigid": _row(rigid_networks, reality),
        "load": _load_row(loads, reality),
        "shifts": shifts,
        "learnt_presses": len(learnt),
        "learnt_images": sum(p.skin_m.shape[0] * p.skin_m.shape[1] for p in learnt),
        "refused_presses": len(drawn) - len(simulated),
        "chance": {"accuracy": 1.0 / len(CLASSES)},
        "difference": _difference(simulation.skin.rest_position_m, again, real),
    }


def _changed_rows(
    study: Study,
    layer: LayerSpecification,
    stream: int,
    simulation: Simulation,
    eye: Eye,
    networks: Sequence[TouchClassifier],
) -> dict[str, Any]:
    """Return how classifiers do on our own presses onto changed skins."""
    plan = replace(study.plan, shares=study.judged_shares)
    drawn = plan.drawn(study.shifted, stream + SHIFTED)
    rows = {}
    for change in FACTORS:
        presses = simulation.solved(changed(layer, change), drawn, 1)
        rows[change] = _row(networks, _taken(study, eye, presses, AS_ASSUMED))
    return rows


def _taken(study: Study, eye: Eye, presses: Sequence[SolvedPress], light: Light) -> _Judged:
    return _Judged(*eye.taken(presses, light, study.plan.seed))


def _learnt(
    study: Study, eye: Eye, presses: Sequence[SolvedPress]
) -> tuple[list[TouchClassifier], tuple[float, float]]:
    """Return classifiers of presses, and the threshold and the sign of the mean motion that
    classify most of the same images right."""
    seen, labels, _ = eye.taken(presses, TO_LEARN_FROM, study.plan.seed)
    networks = [
        train_classifier(seen, labels, len(CLASSES), study.classifier, study.plan.seed + seed)
        for seed in range(study.seeds)
    ]
    load = np.abs(seen).mean(axis=(1, 2, 3))
    best = max(
        ((float(at), sign) for at in np.sort(load) for sign in (1.0, -1.0)),
        key=lambda rule: float(np.mean((rule[1] * (load - rule[0]) > 0.0) == labels)),
    )
    return networks, best


def _load_row(rule: tuple[float, float], judged: _Judged) -> dict[str, Any]:
    at, sign = rule
    load = np.abs(judged.seen).mean(axis=(1, 2, 3))
    return _figures([(sign * (load - at) > 0.0).astype(int)], judged)


def _row(networks: Sequence[TouchClassifier], judged: _Judged) -> dict[str, Any]:
    return _figures([classified(network, judged.seen) for network in networks], judged)


def _figures(told: Sequence[IntArray], judged: _Judged) -> dict[str, Any]:
    """Return how well classifiers do.

    Returns:
        `accuracy` (share of images told right) with `accuracy_std` between classifiers, `seeds`
        with that of each, `balanced_accuracy`, `least_press` (the worst press's share), `presses`
        (independent units), `images`, and `confusion` of all classifiers.
    """
    right = np.array(told) == judged.labels
    accuracy = right.mean(axis=1)
    recalls = [right[:, judged.labels == label].mean() for label in np.unique(judged.labels)]
    by_press = [right[:, judged.press == number].mean() for number in np.unique(judged.press)]
    truth = np.tile(judged.labels, len(told))
    return {
        "accuracy": float(accuracy.mean()),
        "accuracy_std": float(accuracy.std()),
        "seeds": accuracy.tolist(),
        "balanced_accuracy": float(np.mean(recalls)),
        "least_press": float(min(by_press)),
        "by_press": [float(share) for share in by_press],
        "presses": len(by_press),
        "images": len(judged.labels),
        "confusion": confusion(truth.tolist(), np.concatenate(told).tolist(), len(CLASSES)),
    }


def _difference(
    rest_m: FloatArray, ours: Sequence[SolvedPress], real: Sequence[SolvedPress]
) -> dict[str, float]:
    """Return how far our presses are from CalculiX's.

    Returns:
        `skin_rms_mm` over the markers that CalculiX moves by more than `MOVED_M`, `moved_rms_mm`
        (how far it moves them), and `force_error`, the mean relative one.
    """
    solved = {press.press: press for press in ours}
    pairs = [(solved[press.press], press) for press in real if press.press in solved]
    if not pairs:
        return {}
    found, true, forces = [], [], []
    for own, other in pairs:
        moved = np.linalg.norm(other.skin_m[0] - rest_m, axis=-1)
        apart = np.linalg.norm(other.skin_m[0] - own.skin_m[0], axis=-1)
        found.append(apart[moved > MOVED_M])
        true.append(moved[moved > MOVED_M])
        forces.append(np.abs(own.force_n / other.force_n - 1.0))
    return {
        "skin_rms_mm": 1e3 * float(np.sqrt(np.mean(np.concatenate(found) ** 2))),
        "moved_rms_mm": 1e3 * float(np.sqrt(np.mean(np.concatenate(true) ** 2))),
        "force_error": float(np.mean(forces)),
    }
