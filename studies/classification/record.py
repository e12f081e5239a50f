# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which indenter touches, learnt from simulated images."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dotsim_ros.io.files import cache_directory
from dotsim_ros.io.worker_pool.pool import crew
from studies.classification.classifier import ClassifierSettings
from studies.classification.domains import DOMAINS, DomainName
from studies.classification.pictures import write_confusions
from studies.classification.presses import PressPlan
from studies.classification.real_ball import BallStudy, evaluate_real_ball
from studies.classification.study import Study, run_study
from studies.data import REAL, SENSOR_A
from studies.optics.models import FitSettings
from studies.optics.names import ClassifiedBy


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
        FileNotFoundError, ValueError: as `run_study`.
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
    figures = run_study(study, kept, workers=crew(workers, ray_address), tell=print)
    if real_ball:
        ball = BallStudy(gelsight, seeds=study.seeds, classifier=study.classifier, fit=study.fit)
        figures["real_ball"] = evaluate_real_ball(ball, kept / "real_ball", tell=print)
    write_confusions(images / "classification.png", figures, study.domains)
    return figures
