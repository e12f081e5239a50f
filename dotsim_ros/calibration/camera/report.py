# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the fit of a camera leaves behind: figures as JSON, and a sheet of images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dotsim_ros.calibration.camera.fit import CameraFit
from dotsim_ros.calibration.camera.model import CameraModel
from dotsim_ros.calibration.camera.score import CameraFrameScore, by_depth
from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.optics.picture import change_image, titled
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.twin.footage import FilmedData
from dotsim_ros.twin.image_metrics import image_psnr_db

CONTRAST = 4.0
"""Differences in the sheet are shown so many times larger, around grey."""

Scores = Mapping[str, Mapping[str, Sequence[CameraFrameScore]]]
"""Scores by model ("before", "lens", "after") and by set ("train", "held_out")."""


def fit_figures(fit: CameraFit, scores: Scores) -> dict[str, Any]:
    """Return parameters and scores as plain numbers."""
    rim = fit.rim
    return {
        "parameters": {
            p.name: {
                "before": round(p.before, 7),
                "after": round(p.after, 7),
                "deviation": round(p.deviation, 7),
                "prior_deviation": round(p.prior, 7),
            }
            for p in fit.parameters
        },
        "rim": None
        if rim is None
        else {
            "centre_px": [round(v, 3) for v in rim.centre_px.tolist()],
            "radius_px": round(rim.radius_px, 3),
            "residual_px": round(rim.residual_px, 3),
        },
        "exposure_ratio": [round(v, 4) for v in fit.exposure.tolist()],
        "frames_fitted": fit.frames,
        "scores": {
            model: {name: by_depth(frames) for name, frames in sets.items() if frames}
            for model, sets in scores.items()
        },
    }


def summary_lines(figures: Mapping[str, Any]) -> list[str]:
    """Return the figures that matter, for the terminal and the sensor's file."""
    lines = [
        f"{name}: {p['before']:.5g} -> {p['after']:.5g} +- {p['deviation']:.2g}"
        for name, p in figures["parameters"].items()
    ]
    for name in ("train", "held_out"):
        for rows in ("full depth", "all"):
            found = {
                model: sets[name][rows]
                for model, sets in figures["scores"].items()
                if name in sets and rows in sets[name]
            }
            if not found:
                continue
            way = " -> ".join(f"{row['carried_db']:.2f}" for row in found.values())
            some = next(iter(found.values()))
            pixels = " -> ".join(f"{row['reprojection_rms_px']:.2f}" for row in found.values())
            lines.append(
                f"{name}, {rows} ({some['frames']} frames): idle {some['idle_db']:.2f} dB, warped "
                f"{way} dB, reprojection {pixels} px"
            )
    return lines


def draw_sheet(filmed: FilmedData, model: CameraModel) -> ImageArray:
    """Return measured, warped and their difference, side by side, for the deepest frame of one
    press of each indenter."""
    renderer = SkinRenderer(model.camera, filmed.skin)
    image = model.images(filmed)
    rows: dict[str, ImageArray] = {}
    for press in filmed.presses:
        if press.indenter in rows:
            continue
        deepest = int(np.argmax(press.tip_depth_m))
        measured = press.measured[deepest]
        warped = image.warp(renderer.render(press.skin_position_m[deepest]))
        shown = {
            f"{press.name} measured": measured,
            f"warped {image_psnr_db(warped, measured):.1f} dB": warped,
            f"difference x{CONTRAST:g}": change_image(warped, measured, CONTRAST),
        }
        rows[press.indenter] = np.hstack([titled(pixels, title) for title, pixels in shown.items()])
    return np.vstack(list(rows.values()))
