# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Measured and simulated images side by side, with what is wrong with each."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dotsim_ros.io.arrays import BoolArray, ImageArray
from dotsim_ros.io.files import whole_file
from dotsim_ros.io.printable import boxes_for_missing_glyphs, figure_label
from dotsim_ros.view.panels import STYLE
from studies.optics.image_scores import score_image
from studies.optics.rows import Row, RowMaker
from studies.optics.split import FrameKey

SHOWN_MODELS = ("ours", "carried", "paper", "tacto", "difftactile", "taxim")
ERROR_GAIN = 3.0
COLUMN_INCHES, ROW_INCHES, TITLE_INCHES = 2.1, 2.0, 0.4
DOTS_PER_INCH = 90
MARGIN_PX = 4
JPEG_QUALITY = 85
"""PNG takes three times the space, and the sheets lie in the repository."""


def write_optics_sheet(
    path: Path,
    measured: Mapping[FrameKey, ImageArray],
    predicted: Mapping[str, Mapping[FrameKey, ImageArray]],
    lit: BoolArray,
    *,
    title: str,
) -> None:
    """Write a sheet as JPEG, whole or not at all: two rows a frame, images above errors.

    Args:
        path: the file; replaced where it is there.
        measured: images (H, W, 3) of the frames to show.
        predicted: the same frames by model, in the order of the columns.
        lit: (H, W) the lit disc, to whose surroundings the images are cropped.
        title: printed above.
    """
    rows, columns = np.nonzero(lit)
    crop = (
        slice(max(rows.min() - MARGIN_PX, 0), rows.max() + MARGIN_PX),
        slice(max(columns.min() - MARGIN_PX, 0), columns.max() + MARGIN_PX),
    )
    with matplotlib.rc_context(STYLE):
        width = 1 + len(predicted)
        height = 2 * len(measured)
        figure = Figure(
            figsize=(COLUMN_INCHES * width, ROW_INCHES * height + TITLE_INCHES),
            dpi=DOTS_PER_INCH,
            layout="constrained",
        )
        FigureCanvasAgg(figure)
        figure.suptitle(figure_label(title, 80), fontsize=11)
        axes = figure.subplots(height, width, squeeze=False)
        for axis in axes.flat:
            axis.set_axis_off()
        for place, (key, image) in enumerate(measured.items()):
            upper, lower = axes[2 * place], axes[2 * place + 1]
            upper[0].imshow(image[crop])
            upper[0].set_title(f"measured: {figure_label(key[0])}, frame {key[1]}", fontsize=7)
            lower[0].text(0.5, 0.5, f"error x{ERROR_GAIN:g}", ha="center", va="center", fontsize=8)
            for column, (name, images) in enumerate(predicted.items(), start=1):
                score = score_image(images[key], image, {"frame": None})["frame"]
                upper[column].imshow(images[key][crop])
                upper[column].set_title(f"{name}: {score.psnr_db:.1f} dB", fontsize=7)
                lower[column].imshow(_error(images[key], image)[crop])
        with whole_file(path) as temporary, boxes_for_missing_glyphs():
            figure.savefig(temporary, format="jpeg", pil_kwargs={"quality": JPEG_QUALITY})


def _error(predicted: ImageArray, measured: ImageArray) -> ImageArray:
    difference = np.abs(predicted.astype(np.float64) - measured)
    return np.clip(ERROR_GAIN * difference, 0.0, 255.0).astype(np.uint8)


def write_sheets(directory: Path, maker: RowMaker, rows: Mapping[str, Mapping[str, Row]]) -> None:
    """Write a sheet for each level.

    Args:
        directory: folder of the sheets, `optics_LEVEL.jpg`.
        maker: of the rows.
        rows: by level and model, those of the split by trajectory.
    """
    for level, by_model in rows.items():
        models = [name for name in SHOWN_MODELS if name in by_model]
        if not models:
            continue
        keys = sorted(by_model[models[0]].images)
        write_optics_sheet(
            directory / f"optics_{level}.jpg",
            {key: maker.presses[key[0]].measured[key[1]] for key in keys},
            {name: by_model[name].images for name in models},
            maker.data.rest.lit,
            title=f"{level}, by whole trajectories: frames that no model was fitted on",
        )
