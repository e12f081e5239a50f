# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Images of every model on measured frames."""

from __future__ import annotations

from functools import cache as kept
from functools import lru_cache
from pathlib import Path
from typing import Any

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.io.files import cache_directory
from dotsim_ros.optics.idle import lights_of
from dotsim_ros.optics.idle_check import read_idle_images
from dotsim_ros.specification import load_sensor
from dotsim_ros.twin.footage import camera_for, read_filmed_data, render_filmed
from studies.data import SENSOR_A
from studies.geometry.registry import sensor_file
from studies.optics.judge import ceilings, splits_of
from studies.optics.models import FitSettings
from studies.optics.names import ImageModel
from studies.optics.report import evaluate_optics, joined
from studies.optics.rows import RowMaker
from studies.optics.sheet import write_sheets
from studies.optics.source import clipped_presses, refined_data
from studies.optics.split import WAYS, Level


def optics(
    *,
    data: Path = SENSOR_A,
    sensor: str = "out/apart/apart.yaml",
    models: tuple[ImageModel, ...] = (
        "idle",
        "idle_refined",
        "tacto",
        "tacto_refined",
        "tacto_warped",
        "taxim",
        "taxim_warped",
        "difftactile",
        "difftactile_warped",
        "carried",
        "ours",
    ),
    splits: tuple[Level, ...] = ("easy", "hard"),
    seed: int = 0,
    network_epochs: int | None = None,
    network_width: int | None = None,
    images: Path = Path("docs/images"),
    cache: Path | None = None,
) -> dict[str, Any]:
    """Images of every model on frames that it was not fitted on.

    Args:
        data: folder of a data set.
        sensor: name or file of the sensor, or a folder with LEVEL.yaml for each split.
        models: which; published networks take hours without CUDA unless their images are small.
        splits: which.
        seed: of all draws.
        network_epochs: of a published network's training (its own number).
        network_width: of the published networks' images, pixels (their own).
        images: folder of the sheets of images.
        cache: folder of the rows made before, and of trainings (the user's cache).
    """
    settings = FitSettings(seed, network_epochs, network_width)
    data_set = read_data_set(data)

    # One at a time: the frames of one take half a gigabyte.
    @lru_cache(maxsize=1)
    def maker_of(file: Path | str) -> RowMaker:
        given = load_sensor(file)
        filmed = read_filmed_data(data, given, progress=print)
        camera = camera_for(given, filmed.idle, str(data))
        lighting, vignetting = lights_of(given)
        rendered = render_filmed(filmed, camera, lighting=lighting, vignetting=vignetting)
        return RowMaker(
            rendered,
            kept(lambda: clipped_presses(data_set, given, rendered)),
            lru_cache(maxsize=1)(lambda split: refined_data(filmed, given, rendered, split)),
            cache or cache_directory() / "optics",
            settings,
            print,
        )

    files = {level: sensor_file(level, sensor) for level in splits}
    figures: dict[str, Any] = {}
    for level, file in files.items():
        maker = maker_of(file)
        drawn = splits_of(maker.data, seed=seed)[level]
        part, rows = evaluate_optics(maker, [drawn[way] for way in WAYS], models, sensor=str(file))
        figures = joined(figures, part)
        write_sheets(images, maker, rows)
    # The measured images decide these, so that any level's data will do.
    figures["ceiling"] = ceilings(maker.data, read_idle_images(data_set.idle_images()))
    return figures
