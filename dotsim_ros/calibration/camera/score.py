# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How well warped images meet measured ones: in grey levels, and in pixels.

The reprojection error is measured, not modelled: the optical flow (dense inverse search, Kroeger et
al., "Fast optical flow using dense inverse search", 2016) from the warped to the measured image,
both with the brightness of each neighbourhood taken out, is averaged over patches of 12 pixels (at
240 of height) that the skin moved across by at least half a pixel and that hold texture. Its length
is how far from its place the model puts a piece of the pattern; it holds the error of the skin as
well as that of the camera. Untouched frames, where the warped image is the idle image, show how
much of it is the measure's own noise.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.calibration.camera.model import (
    REFERENCE_HEIGHT_PX,
    RIM_MARGIN_PX,
    CameraModel,
    seen_motion_px,
)
from dotsim_ros.io.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from dotsim_ros.optics.idle import lit_region
from dotsim_ros.optics.renderer import SkinRenderer, View
from dotsim_ros.twin.footage import FilmedData
from dotsim_ros.twin.image_metrics import depth_ranges, image_psnr_db

PATCH_PX = 12
MOTION_PX = 0.5
TEXTURE_LEVELS = 8.0
"""Least standard deviation of a patch's brightness for its motion to be measured."""
NEIGHBOURHOOD_PX = 6.0


@dataclass(frozen=True)
class CameraFrameScore:
    """How one frame is met.

    Attributes:
        press: name of the press.
        indenter: name of the indenter.
        frame: its number.
        depth_m: of the tip.
        deepest: whether no frame of the press is deeper.
        idle_db, unshaded_db, carried_db: PSNR of the idle image, of the warped one without and
            with shading, over the whole frame.
        lit_db: of the warped one within the lit disc.
        errors_px: (N,) reprojection errors of its patches; of an untouched frame, of all patches
            with texture.
    """

    press: str
    indenter: str
    frame: int
    depth_m: float
    deepest: bool
    idle_db: float
    unshaded_db: float
    carried_db: float
    lit_db: float
    errors_px: FloatArray


def score_frames(filmed: FilmedData, model: CameraModel) -> list[CameraFrameScore]:
    """Return the scores of all frames by a camera at the images' resolution."""
    renderer = SkinRenderer(model.camera, filmed.skin)
    unshaded, shaded = model.images(filmed, is_shaded=False), model.images(filmed)
    lit = lit_region(filmed.idle)
    rest = renderer.render(filmed.skin.rest_position_m)
    scores = []
    for press in filmed.presses:
        deepest = int(np.argmax(press.tip_depth_m))
        for frame, depth_m in enumerate(press.tip_depth_m.tolist()):
            view = renderer.render(press.skin_position_m[frame])
            measured = press.measured[frame]
            warped = shaded.warp(view)
            scores.append(
                CameraFrameScore(
                    press=press.name,
                    indenter=press.indenter,
                    frame=frame,
                    depth_m=depth_m,
                    deepest=frame == deepest,
                    idle_db=image_psnr_db(filmed.idle, measured),
                    unshaded_db=image_psnr_db(unshaded.warp(view), measured),
                    carried_db=image_psnr_db(warped, measured),
                    lit_db=image_psnr_db(warped[lit], measured[lit]),
                    errors_px=_errors_px(
                        warped,
                        measured,
                        _judged(view, rest, lit, filmed.skin.triangles, depth_m < 0.0),
                    ),
                )
            )
    return scores


def _judged(
    view: View, rest: View, lit: BoolArray, triangles: NDArray[np.int32], untouched: bool
) -> BoolArray:
    """Return (H, W) where motion is judged."""
    margin = round(RIM_MARGIN_PX * len(lit) / REFERENCE_HEIGHT_PX)
    inside = cv2.erode(lit.astype(np.uint8), np.ones((margin, margin))) > 0
    inside &= view.mask
    if untouched:
        return inside
    seen = seen_motion_px(view, rest, triangles)
    return np.asarray(inside & (seen > MOTION_PX * len(lit) / REFERENCE_HEIGHT_PX))


def _even(grey: Float32Array, size_px: float) -> ImageArray:
    """Return an image (H, W) whose neighbourhoods have one mean and one contrast."""
    mean = cv2.GaussianBlur(grey, (0, 0), size_px)
    spread = np.sqrt(np.maximum(cv2.GaussianBlur(grey**2, (0, 0), size_px) - mean**2, 0.0))
    return np.clip(128.0 + 50.0 * (grey - mean) / (spread + 2.0), 0.0, 255.0).astype(np.uint8)


def _errors_px(warped: ImageArray, measured: ImageArray, judged: BoolArray) -> FloatArray:
    """Return the lengths of the mean flow in the patches that are judged by more than half."""
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (warped, measured)]
    scale = len(warped) / REFERENCE_HEIGHT_PX
    even = [_even(image.astype(np.float32), NEIGHBOURHOOD_PX * scale) for image in grey]
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    flow = search.calc(even[0], even[1], np.zeros((*judged.shape, 2), dtype=np.float32))
    size = round(PATCH_PX * scale)
    lengths = []
    for top in range(0, judged.shape[0] - size + 1, size):
        for left in range(0, judged.shape[1] - size + 1, size):
            patch = np.s_[top : top + size, left : left + size]
            where = judged[patch]
            if where.mean() <= 0.5 or grey[1][patch].std() < TEXTURE_LEVELS:
                continue
            lengths.append(float(np.linalg.norm(flow[patch][where].mean(axis=0))))
    return np.array(lengths)


def summarize_frames(scores: Iterable[CameraFrameScore]) -> dict[str, float | int] | None:
    """Return mean PSNR and root mean square reprojection error of frames; None without any."""
    chosen = list(scores)
    if not chosen:
        return None
    errors = np.concatenate([score.errors_px for score in chosen])
    summary: dict[str, float | int] = {
        name: round(float(np.mean([getattr(score, name) for score in chosen])), 3)
        for name in ("idle_db", "unshaded_db", "carried_db", "lit_db")
    }
    if errors.size:
        summary["reprojection_rms_px"] = round(float(np.sqrt(np.mean(errors**2))), 3)
        summary["reprojection_median_px"] = round(float(np.median(errors)), 3)
    summary["patches"] = int(errors.size)
    summary["frames"] = len(chosen)
    return summary


def by_depth(scores: Iterable[CameraFrameScore]) -> Mapping[str, dict[str, float | int]]:
    """Return the summaries of untouched frames, of depths in between, of each press's deepest
    frame and of all frames."""
    chosen = list(scores)
    rows = {
        **{
            name: [s for s in chosen if low <= s.depth_m < high]
            for name, low, high in depth_ranges()
        },
        "full depth": [s for s in chosen if s.deepest],
        "all": chosen,
    }
    summaries = {name: summarize_frames(row) for name, row in rows.items()}
    return {name: summary for name, summary in summaries.items() if summary is not None}
