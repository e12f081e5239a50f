# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The optics table of a data set: every model of the image on every split, and its page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from dotsim_ros.learning.recipe import RECIPES
from dotsim_ros.metrics.images import SIGNIFICANT_SHARE, SSIM_SIGMA_PX, depth_ranges
from dotsim_ros.twin.footage import OpticalPress
from studies.optics.judge import DEEP_M, is_single_press, summarize
from studies.optics.names import NETWORKS
from studies.optics.rows import Row, RowMaker
from studies.optics.split import LEVELS, WAYS, FrameKey, OpticalSplit
from studies.table import Column, entry_list, markdown_table

SHOWN_FRAMES = 3
OPTICS_COLUMNS = (
    Column("psnr_db", "PSNR dB ↑", 2),
    Column("mean_l2", "mean L2 x 10⁻² ↓", 2, 100.0),
    Column("significant_l2", "sig. L2 x 10⁻² ↓", 2, 100.0),
    Column("ssim", "SSIM ↑", 4),
    Column("disc_psnr_db", "disc PSNR ↑", 2),
    Column("disc_ssim", "disc SSIM ↑", 4),
    Column("full_depth_psnr_db", "full depth PSNR ↑", 2),
    Column("full_depth_disc_psnr_db", "full depth, disc ↑", 2),
    Column("deep_psnr_db", "from 2 mm PSNR ↑", 2),
)
TITLES = {
    "by_frame": "by frame (neighbouring frames leak)",
    "by_trajectory": "by whole trajectories",
}


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
            # Solvers and trainings that fail raise these; the page says so rather than end.
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


def flat_figures(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of one row with the nested ones at the top, as columns name them."""
    flat = {key: value for key, value in figures.items() if not isinstance(value, dict)}
    for group in ("disc", "full_depth", "deep"):
        for key, value in (figures.get(group) or {}).items():
            if isinstance(value, dict):
                flat |= {f"{group}_{key}_{inner}": number for inner, number in value.items()}
            else:
                flat[f"{group}_{key}"] = value
    return flat


def optics_page(figures: Mapping[str, Any], sheets: Mapping[str, str]) -> str:
    """Return the tables as a Markdown page.

    Args:
        figures: of `evaluate_optics`, with ceiling and provenance.
        sheets: path of the image of a level, seen from the page.
    """
    origin = figures["provenance"]
    parts = [f"# Images of {origin['data']}\n"]
    for level in LEVELS:
        for way in WAYS:
            rows = figures.get(level, {}).get(way)
            if not rows:
                continue
            sizes = figures["splits"][f"{level}.{way}"]
            parts.append(
                f"## {level.capitalize()}, {TITLES[way]}\n\nFitted on {sizes['train_frames']} "
                f"frames of {len(sizes['train_trajectories'])} trajectories, judged on "
                f"{sizes['test_frames']} of {len(sizes['test_trajectories'])}.\n"
            )
            table = [([name], flat_figures(row)) for name, row in rows.items()]
            table += [([name], {"psnr_db": db}) for name, db in _ceiling_rows(figures)]
            parts.append(markdown_table(["method"], table, OPTICS_COLUMNS))
            parts.append("PSNR over the whole frame by depth of the tip, dB:\n")
            parts.append(_depth_table(rows))
            trainings = _trainings(rows)
            if trainings:
                parts.append("How long the networks were trained, and on which images:\n")
                parts.append(entry_list(trainings))
        if level in sheets:
            parts.append(f"![measured and simulated images, {level}]({sheets[level]})\n")
    if figures["failures"]:
        parts.append("## Left out\n")
        parts.append(
            "\n".join(
                f"- {f['split']}, {f['way']}, {f['model']}: {f['reason']}"
                for f in figures["failures"]
            )
            + "\n"
        )
    parts.append("## What the figures mean\n")
    parts.append(entry_list(figures["definitions"]))
    parts.append("## Where the rows come from\n")
    parts.append(entry_list(_origins(figures)))
    parts.append("The page:\n")
    parts.append(entry_list(origin))
    return "\n".join(parts)


def _origins(figures: Mapping[str, Any]) -> dict[str, str]:
    """Return commit, date and sensor of the rows of each split, those made alike together."""
    words = {}
    for name in figures["splits"]:
        level, way = name.split(".")
        made: dict[str, list[str]] = {}
        for model, row in figures.get(level, {}).get(way, {}).items():
            source = f"{row['commit']}, {row['date'][:10]}, sensor {row['sensor']}"
            made.setdefault(source, []).append(model)
        words[name] = "; ".join(f"{', '.join(names)} ({source})" for source, names in made.items())
    return words


def _trainings(rows: Mapping[str, Any]) -> dict[str, str]:
    """Return what to know of each network's training before its row is compared."""
    words = {}
    for model, row in rows.items():
        if model not in NETWORKS:
            continue
        training = row.get("training")
        if training is None:
            words[model] = f"{row['fit_s'] / 60.0:.1f} minutes, its epochs were not counted"
            continue
        count, own = training["epochs"], RECIPES[model].epochs
        epochs = f"**{count} of its {own} epochs**" if count < own else f"{count} epochs"
        words[model] = (
            f"{epochs} in {training['minutes']:.1f} minutes of CPU time, images of "
            f"{training['width_px']}x{training['height_px']}"
        )
    return words


def _depth_table(rows: Mapping[str, Any]) -> str:
    ranges = [name for name, _, _ in depth_ranges()]
    columns = [Column(name, name, 2) for name in ranges]
    first = next(iter(rows.values()))["depths"]
    table: list[tuple[list[str], dict[str, Any]]] = [
        ([model], {name: (row["depths"][name] or {}).get("psnr_db") for name in ranges})
        for model, row in rows.items()
    ]
    counts = {name: str((first[name] or {}).get("frames", 0)) for name in ranges}
    return markdown_table(["method"], [*table, (["frames"], counts)], columns)


def _ceiling_rows(figures: Mapping[str, Any]) -> list[tuple[str, float]]:
    titles = {
        "two_renderings_db": "ceiling by the idle image: two renderings",
        "one_rendering_db": "ceiling by a noiseless image: one rendering",
        "camera_noise_db": "ceiling: camera noise",
    }
    return [(titles[key], db) for key, db in figures["ceiling"].items()]
