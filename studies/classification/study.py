# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Classifiers learnt from each image model's simulated touches, judged on measured ones."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from dotsim_ros.data.data_set import find_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import Float32Array, IntArray
from dotsim_ros.io.cache import PHYSICS, content_key
from dotsim_ros.io.files import cache_directory, write_json
from dotsim_ros.io.provenance import provenance
from dotsim_ros.io.worker_pool.pool import Crew, crew, open_pool
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.twin.footage import FilmedPress
from studies.classification.classifier import (
    ClassifierSettings,
    classified,
    confusion,
    touched,
    touched_as_taken,
    train_classifier,
)
from studies.classification.domains import DOMAINS, Domain, DomainName, Fold, domain_of
from studies.classification.pictures import write_confusions
from studies.classification.presses import (
    PressPlan,
    pressed_skins,
    simulated_presses,
)
from studies.classification.real_ball import BallStudy, evaluate_real_ball
from studies.data import REAL, SENSOR_A
from studies.geometry.registry import sensor_file
from studies.optics.judge import recordings_of, restricted
from studies.optics.models import (
    BOUND,
    CLIPPED,
    MADE_BY,
    REFINED,
    ClassifiedBy,
    FitSettings,
    factory_of,
)
from studies.optics.rows import by_name
from studies.optics.source import Footage, read_footage
from studies.rivals.optics.clipped import clipped_press

APART = 5
"""Every fifth simulated press is not learnt from."""


@dataclass(frozen=True)
class Study:
    """What is asked.

    Attributes:
        data: folder of the data set.
        sensor: name or file of a sensor, or a folder with one for each domain.
        models: rows, of `ClassifiedBy`.
        domains: of `DOMAINS`.
        seeds: classifiers of each row and fold.
        plan: of the simulated presses.
        classifier: how they are trained.
        fit: how image models are fitted.
    """

    data: Path
    sensor: str
    models: tuple[str, ...]
    domains: tuple[str, ...] = DOMAINS
    seeds: int = 5
    plan: PressPlan = field(default_factory=PressPlan)
    classifier: ClassifierSettings = field(default_factory=ClassifierSettings)
    fit: FitSettings = field(default_factory=FitSettings)


def classification(
    *,
    data: Path = SENSOR_A,
    sensor: str = "out/apart/apart.yaml",
    models: tuple[ClassifiedBy, ...] = ("ours", "bound", "tacto", "difftactile", "paper"),
    domains: tuple[DomainName, ...] = DOMAINS,
    classifiers: int = 5,
    presses: int = 60,
    epochs: int = 60,
    seed: int = 0,
    network_epochs: int | None = 20,
    network_width: int | None = 64,
    real_ball: bool = True,
    gelsight: Path = REAL / "gelsight",
    workers: int = 1,
    ray_address: str | None = None,
    images: Path = Path("docs/images"),
    cache: Path | None = None,
) -> dict[str, Any]:
    """Which indenter touches, learnt from each image model's images and judged on measured ones.

    Args:
        data: folder of a data set.
        sensor: name or file of the sensor, or a folder with DOMAIN.yaml for each domain.
        models: which; bound learns from measured images of other presses.
        domains: which.
        classifiers: of each row.
        presses: simulated, of each indenter.
        epochs: of a classifier's training.
        seed: of all draws.
        network_epochs: of a published network's training.
        network_width: of the published networks' images, pixels.
        real_ball: whether real presses of a ball on a flat sensor are classified as well.
        gelsight: folder of FOTS's recording of them.
        workers: processes, or workers of the Ray cluster, at most.
        ray_address: HOST:PORT of the head of a Ray cluster, auto or local (none).
        images: folder of the picture.
        cache: folder of the rows made before, and of trainings (the user's cache).

    Raises:
        FileNotFoundError: no data set, or no sensor of a domain.
        ValueError: data that cannot be classified so, or a model that could not be fitted.
    """
    study = Study(
        data,
        sensor,
        models=models,
        domains=domains,
        seeds=classifiers,
        plan=PressPlan(count=presses, seed=seed),
        classifier=ClassifierSettings(epochs=epochs),
        fit=FitSettings(seed, network_epochs, network_width),
    )
    kept = cache or cache_directory() / "classification"
    figures = {
        "study": {**asdict(replace(study, data=Path(data.name))), "data": data.name},
        **_rows(study, kept, crew(workers, ray_address)),
    }
    if real_ball:
        ball = BallStudy(gelsight, seeds=study.seeds, classifier=study.classifier, fit=study.fit)
        figures["real_ball"] = evaluate_real_ball(ball, kept / "real_ball")
    write_confusions(images / "classification.png", figures, study.domains)
    return figures


def _rows(study: Study, kept: Path, workers: Crew) -> dict[str, dict[str, Any]]:
    """Return the rows of a study by domain and model; those that are kept are not made again.

    Args:
        study: what is asked.
        kept: folder of rows, skins and trainings.
        workers: how many processes, or workers of Ray, each of which presses an indenter or makes
            a row of a domain.
    """
    rows: dict[str, dict[str, Any]] = {name: {} for name in study.domains}
    with open_pool(workers, _prepare, reads=(study.data,), writes=(kept,)) as pool:
        # Bad data is reported before anything is pressed.
        classes = [pool.submit(_classes, study, name).result() for name in study.domains]
        pressing = [
            (study, kept, domain, indenter)
            for domain, indenters in zip(study.domains, classes, strict=True)
            for indenter in indenters
        ]
        # The first one leaves the tables on disk that the others read.
        pool.submit(_press, *pressing[0]).result()
        for pressed in [pool.submit(_press, *one) for one in pressing[1:]]:
            pressed.result()
        running = {
            pool.submit(made_row, study, kept, domain, model): (domain, model)
            for domain in study.domains
            for model in study.models
        }
        for done in as_completed(running):
            domain, model = running[done]
            row = rows[domain][model] = done.result()
            print(f"{domain}, {model}: {100.0 * row['mean']:.1f} %")
    return {name: {model: rows[name][model] for model in study.models} for name in study.domains}


def made_row(study: Study, kept: Path, domain_name: str, model: str) -> dict[str, Any]:
    """Return how classifiers that learnt from a model's images do in a domain.

    Returns:
        `mean` and `std` between seeds of the share of frames told right, the same of the
        `balanced` share (mean over the classes), `seeds` with the share of each, `confusion`
        (true class by told class, of all seeds), `classes`, `frames`, `trajectories`, `simulated`
        (share of simulated touches that no classifier learnt from) and where the row comes from.
    """
    measured = _footage(study, domain_name)
    # Nothing measured of the classes may be fitted on out of the domain, which no bound can do
    # without: it is the same in both.
    split = "in_domain" if (model, domain_name) == (BOUND, "out_of_domain") else domain_name
    domain = domain_of(split, recordings_of(measured.data))
    trained = (study.fit.epochs_of(model), study.fit.width_of(model))
    key = content_key(
        (*PHYSICS, *MADE_BY, "../studies/classification"),
        (measured.filmed.idle, [press.measured for press in measured.filmed.presses]),
        [press.skin_position_m for press in measured.filmed.presses],
        measured.sensor.camera,
        domain,
        model,
        (study.seeds, study.plan, study.classifier, study.fit.seed, trained),
    )
    path = kept / "rows" / f"{domain_name}-{model}-{key}.json"
    if not path.is_file():
        row = _made(study, kept, measured, domain, model)
        write_json(path, row | {"origin": provenance()})
    found: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return found


def _made(
    study: Study, kept: Path, measured: Footage, domain: Domain, model: str
) -> dict[str, Any]:
    truth: list[int] = []
    told: list[list[int]] = [[] for _ in range(study.seeds)]
    simulated: list[float] = []
    trajectories: set[str] = set()
    rank = {indenter: number for number, indenter in enumerate(domain.classes)}
    for fold in domain.folds:
        seen, labels = _touches(study, measured, fold.judged, rank)
        truth += labels.tolist()
        trajectories |= {name for name, _ in fold.judged}
        learnt, learnt_labels, apart, apart_labels = _to_learn_from(
            study, kept, measured, domain, fold, model
        )
        for seed in range(study.seeds):
            network = train_classifier(
                learnt, learnt_labels, len(rank), study.classifier, study.fit.seed + seed
            )
            told[seed] += classified(network, seen).tolist()
            if len(apart):
                simulated.append(float(np.mean(classified(network, apart) == apart_labels)))
    right = np.array(told) == np.array(truth)
    recalls = np.array(
        [right[:, np.array(truth) == number].mean(axis=1) for number in rank.values()]
    )
    balanced = recalls.mean(axis=0)
    accuracy = right.mean(axis=1)
    return {
        "mean": float(accuracy.mean()),
        "std": float(accuracy.std()),
        "balanced": {"mean": float(balanced.mean()), "std": float(balanced.std())},
        "seeds": accuracy.tolist(),
        "confusion": confusion(truth * study.seeds, [t for one in told for t in one], len(rank)),
        "classes": list(domain.classes),
        "frames": len(truth),
        "trajectories": len(trajectories),
        "simulated": float(np.mean(simulated)) if simulated else None,
    }


def _touches(
    study: Study, measured: Footage, keys: Sequence[tuple[str, int]], rank: dict[str, int]
) -> tuple[Float32Array, IntArray]:
    """Return what measured touches add to the idle image, and their classes; contact only."""
    seen, labels = [], []
    for press in restricted(by_name(measured.data), keys):
        touches = press.tip_depth_m > 0.0
        seen.append(
            touched_as_taken(press.measured[touches], measured.filmed.idle, study.classifier)
        )
        labels += [rank[press.indenter]] * int(touches.sum())
    return np.concatenate(seen), np.array(labels)


def _to_learn_from(
    study: Study, kept: Path, measured: Footage, domain: Domain, fold: Fold, model: str
) -> tuple[Float32Array, IntArray, Float32Array, IntArray]:
    """Return touches and classes to learn from, and others to see how well that went."""
    rank = {indenter: number for number, indenter in enumerate(domain.classes)}
    if model == BOUND:
        seen, labels = _touches(study, measured, fold.fitted, rank)
        return seen, labels, seen[:0], labels[:0]
    footage, data = measured.filmed, measured.data
    if model in REFINED:
        footage = measured.refined(fold.fitted)
        data = measured.rendered(footage)
    clips = model in CLIPPED
    presses = measured.clipped(data) if clips else by_name(data)
    # The lit disc is the same for all, as where images are judged.
    rest = replace(data.rest, lit=measured.data.rest.lit)
    state = kept / "fits" / content_key(MADE_BY, model, fold, study.fit)
    make = factory_of(model, study.fit, state=state)
    fitted = make(restricted(presses, fold.fitted), rest, data.camera)
    random = np.random.default_rng(study.fit.seed)
    filmed, poses_of = simulated_touches(study, kept, domain.name)
    renderer = SkinRenderer(data.camera, footage.skin)
    learnt: tuple[list[Float32Array], list[int]] = ([], [])
    apart: tuple[list[Float32Array], list[int]] = ([], [])
    for indenter in domain.classes:
        own = [number for number, press in enumerate(filmed) if press.indenter == indenter]
        # One indenter at a time: a rendered frame takes two megabytes.
        rendered = measured.rendered(replace(footage, presses=tuple(filmed[n] for n in own)))
        shape = find_indenter(measured.source, indenter)
        for place, (number, press) in enumerate(zip(own, rendered.presses, strict=True)):
            if clips:
                press = clipped_press(press, poses_of[number], shape, renderer)
            images = fitted.predict(press, rest)
            seen_of, labels_of = apart if place % APART == 0 else learnt
            seen_of.append(touched(images, measured.filmed.idle, study.classifier, random))
            labels_of += [rank[indenter]] * len(images)
    shutil.rmtree(state, ignore_errors=True)
    return (
        np.concatenate(learnt[0]),
        np.array(learnt[1]),
        np.concatenate(apart[0]),
        np.array(apart[1]),
    )


def simulated_touches(
    study: Study, kept: Path, domain_name: str
) -> tuple[list[FilmedPress], list[list[Pose]]]:
    """Return the simulated presses of a domain's indenters, and the poses of each."""
    measured = _footage(study, domain_name)
    classes = domain_of(domain_name, recordings_of(measured.data)).classes
    return simulated_presses(
        measured.sensor,
        {name: find_indenter(measured.source, name) for name in classes},
        study.plan,
        measured.filmed.idle.shape[:2],
        cache=kept / "skins",
    )


def _classes(study: Study, domain_name: str) -> tuple[str, ...]:
    """Return the indenters of a domain, in the order of their names."""
    measured = _footage(study, domain_name)
    return tuple(sorted(domain_of(domain_name, recordings_of(measured.data)).classes))


def _press(study: Study, kept: Path, domain_name: str, indenter: str) -> None:
    """Press an indenter as often as a domain needs it, so that the skins are kept."""
    measured = _footage(study, domain_name)
    pressed_skins(
        measured.sensor,
        indenter,
        find_indenter(measured.source, indenter),
        _classes(study, domain_name).index(indenter),
        study.plan,
        cache=kept / "skins",
    )


def _footage(study: Study, domain_name: str) -> Footage:
    return _read_footage(study.data, sensor_file(domain_name, study.sensor))


# One at a time: the frames of one take half a gigabyte.
_read_footage = lru_cache(maxsize=1)(read_footage)


def _prepare() -> None:
    torch.set_num_threads(1)
