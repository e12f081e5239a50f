# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Images of every model on measured frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cache as kept
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.io.files import cache_directory
from dotsim_ros.optics.idle_check import read_idle_images
from dotsim_ros.twin.footage import OpticalPress
from studies.data import SENSOR_A
from studies.geometry.registry import sensor_file
from studies.optics.image_scores import SIGNIFICANT_SHARE, SSIM_SIGMA_PX
from studies.optics.judge import DEEP_M, ceilings, is_single_press, splits_of, summarize
from studies.optics.models import FitSettings, ImageModelName
from studies.optics.rows import Row, RowMaker
from studies.optics.sheet import write_sheets
from studies.optics.source import read_footage
from studies.optics.split import WAYS, FrameKey, Level, OpticalSplit

SHOWN_FRAMES = 3


def optics(
    *,
    data: Path = SENSOR_A,
    sensor: str = "out/apart/apart.yaml",
    models: tuple[ImageModelName, ...] = (
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

    # One at a time: the frames of one take half a gigabyte.
    @lru_cache(maxsize=1)
    def maker_of(file: Path | str) -> RowMaker:
        footage = read_footage(data, file)
        return RowMaker(
            footage.data,
            kept(footage.clipped),
            lru_cache(maxsize=1)(lambda split: footage.rendered(footage.refined(split.train))),
            cache or cache_directory() / "optics",
            settings,
        )

    figures: dict[str, Any] = {}
    for level, file in {level: sensor_file(level, sensor) for level in splits}.items():
        maker = maker_of(file)
        drawn = splits_of(maker.data, seed=seed)[level]
        part, rows = evaluate_optics(maker, [drawn[way] for way in WAYS], models, sensor=str(file))
        figures = joined(figures, part)
        write_sheets(images, maker, rows)
    # The measured images decide these, so that any level's data will do.
    idle_images = read_idle_images(read_data_set(data).idle_images())
    figures["ceiling"] = ceilings(maker.data, idle_images)
    return figures


def shown_frames(
    split: OpticalSplit, presses: Mapping[str, OpticalPress], *, seed: int
) -> list[FrameKey]:
    """Return the judged frames that a sheet shows: full depths of single presses, drawn by a seed,
    each of another indenter as long as there are any."""
    full = [
        (name, frame)
        for name, frame in split.test
        if frame == len(presses[name].measured) - 1 and is_single_press(presses[name])
    ]
    random = np.random.default_rng(seed)
    drawn = [full[index] for index in random.permutation(len(full))]
    turn: dict[str, int] = {}
    order: list[tuple[int, int, FrameKey]] = []
    for key in drawn:
        indenter = presses[key[0]].indenter
        turn[indenter] = turn.get(indenter, -1) + 1
        order.append((turn[indenter], len(order), key))
    return sorted(key for _, _, key in sorted(order)[:SHOWN_FRAMES])


def evaluate_optics(
    maker: RowMaker,
    splits: Sequence[OpticalSplit],
    models: Sequence[str],
    *,
    sensor: str,
) -> tuple[dict[str, Any], dict[str, dict[str, Row]]]:
    """Return the figures as the JSON file holds them, and the rows of the splits by trajectory.

    A model that fails is named with the reason, and the others are still judged.

    Args:
        maker: makes the rows.
        splits: which.
        models: names, in the order of the rows.
        sensor: what the maker's sensor is called in the rows.
    """
    figures: dict[str, Any] = {}
    shown_rows: dict[str, dict[str, Row]] = {}
    failures = []
    for split in splits:
        shown = shown_frames(split, maker.presses, seed=maker.settings.seed)
        rows = {}
        for model in models:
            try:
                row = maker.make(model, split, shown)
            # Solvers and trainings that fail raise these; the record says so.
            except (ValueError, RuntimeError, FloatingPointError) as error:
                failures.append(
                    {"split": split.level, "way": split.way, "model": model, "reason": str(error)}
                )
                print(f"{split.level}, {split.way}, {model} failed: {error}")
                continue
            rows[model] = row
            figures.setdefault(split.level, {}).setdefault(split.way, {})[model] = {
                **summarize(row.scores),
                "fit_s": row.fit_s,
                "predict_s": row.predict_s,
                "commit": row.commit,
                "date": row.date,
                "sensor": sensor,
                "training": None if row.training is None else asdict(row.training),
            }
        if split.way == "by_trajectory":
            shown_rows[split.level] = rows
    figures["splits"] = {
        f"{split.level}.{split.way}": {
            "train_frames": len(split.train),
            "test_frames": len(split.test),
            "train_trajectories": sorted({name for name, _ in split.train}),
            "test_trajectories": sorted({name for name, _ in split.test}),
        }
        for split in splits
    }
    figures["failures"] = failures
    figures["definitions"] = definitions()
    return figures, shown_rows


def joined(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of `evaluate_optics` on other levels together; the first may be empty."""
    return {
        **first,
        **second,
        "splits": {**first.get("splits", {}), **second["splits"]},
        "failures": [*first.get("failures", []), *second["failures"]],
    }


def definitions() -> dict[str, str]:
    """Return what each figure means, in words."""
    return {
        "psnr_db": (
            "mean over the judged frames of each frame's PSNR, 10 log10 of 1 over the mean squared "
            "error of all pixels and colours, full scale 1; not the PSNR of the mean error, which "
            "is lower"
        ),
        "mean_l2": "length of a pixel's error in red, green and blue, full scale 1, mean",
        "significant_l2": (
            f"the same over the worst {100 * SIGNIFICANT_SHARE:g} % of each frame's pixels"
        ),
        "ssim": (
            f"structural similarity, Gaussian windows of {SSIM_SIGMA_PX:g} px, mean of the colours"
        ),
        "disc": "inside the lit disc of the idle image only; the unlit border never changes",
        "full_depth": (
            "last frames of single presses, which are the trajectories that only go deeper"
        ),
        "deep": f"frames whose tip lies {1e3 * DEEP_M:g} mm or more below the skin at rest",
        "by_frame": (
            "frames are drawn one by one, so neighbours of nearly every judged frame were fitted on"
        ),
        "by_trajectory": "whole trajectories are drawn; hard is the same both ways",
        "ceiling": (
            "camera_noise_db: an image without noise against one with the camera's, by the "
            "differences of the idle images; two_renderings_db: the idle image against the frames "
            "before anything touched, which on a rendered stand-in are another rendering of the "
            "same scene; one_rendering_db: such a frame against an image without any noise, "
            "estimated from the differences of those frames"
        ),
    }
