# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A bulge or a dent below a soft skin, classified by touch."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from dotsim_ros.io.files import cache_directory
from studies.reference.run import calculix_path, calculix_version
from studies.tumour.pictures import write_presses
from studies.tumour.skins import SKIN_NAMES, PressPlan, SkinName
from studies.tumour.study import TRAINING, Study, run_study


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
    """
    calculix_path()
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
    figures = run_study(study, kept, print)
    write_presses(images / "tumour.png", study, kept, print)
    return figures | {"calculix": calculix_version()}
