# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The optics table of a data set: every model of the image on every split."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from dotsim_ros.twin.footage import OpticalPress
from studies.optics.image_scores import SIGNIFICANT_SHARE, SSIM_SIGMA_PX
from studies.optics.judge import DEEP_M, is_single_press, summarize
from studies.optics.rows import Row, RowMaker
from studies.optics.split import FrameKey, OpticalSplit

SHOWN_FRAMES = 3


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
                maker.progress(f"{split.level}, {split.way}, {model} failed: {error}")
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
