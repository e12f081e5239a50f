# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Models of the image, judged on measured frames: scores and their summaries."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any, Protocol, TypeVar

import numpy as np

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.twin.footage import FilmedPress, OpticalData, OpticalPress, Rest
from dotsim_ros.twin.image_metrics import depth_ranges, image_psnr_db, psnr_db
from studies.optics.image_scores import ImageScore, score_image
from studies.optics.split import FrameKey, OpticalSplit, Recorded, optical_splits

AnyPress = TypeVar("AnyPress", FilmedPress, OpticalPress)

DEEP_M = 2.0e-3
"""Depth of the tip from which a frame counts as deep."""


class ImageModel(Protocol):
    """A simulator of the camera's image."""

    @property
    def name(self) -> str:
        """How tables call it."""

    def predict(self, press: OpticalPress, rest: Rest) -> ImageArray:
        """Return the images (F, H, W, 3) of a press; its measured ones are not read.

        Args:
            press: depth, normals and warped images of the frames.
            rest: of the gel untouched.
        """


Factory = Callable[[Sequence[OpticalPress], Rest, Camera], ImageModel]
"""Makes a model from the frames to fit on."""


@dataclass(frozen=True)
class Idle:
    """The idle image, whatever presses the gel: the floor."""

    name: str = "idle"

    def predict(self, press: OpticalPress, rest: Rest) -> ImageArray:
        """Return images (F, H, W, 3); see `ImageModel`."""
        return np.broadcast_to(rest.idle, press.warped.shape).copy()


@dataclass(frozen=True)
class WarpedIdle:
    """The idle image warped by the skin and shaded to first order, without anything learned."""

    name: str = "carried"

    def predict(self, press: OpticalPress, rest: Rest) -> ImageArray:
        """Return images (F, H, W, 3); see `ImageModel`."""
        return press.warped


@dataclass(frozen=True)
class ImageFrameScores:
    """How one frame was predicted.

    Attributes:
        press: name of the trajectory.
        indenter: name of the indenter.
        frame: its number in the trajectory.
        tip_depth_m: how deep the indenter's tip lies below the skin at rest.
        full_depth: whether it is the last frame of a single press.
        frame_score: over the whole frame.
        disc_score: inside the lit disc.
    """

    press: str
    indenter: str
    frame: int
    tip_depth_m: float
    full_depth: bool
    frame_score: ImageScore
    disc_score: ImageScore


def splits_of(data: OpticalData, *, seed: int = 0) -> dict[str, dict[str, OpticalSplit]]:
    """Return the splits of a data set by level and way; errors as `optical_splits`."""
    return optical_splits(recordings_of(data), seed=seed)


def recordings_of(data: OpticalData) -> list[Recorded]:
    """Return the trajectories of a data set, as far as drawing needs them."""
    return [Recorded(press.name, press.indenter, len(press.measured)) for press in data.presses]


def with_frames(press: AnyPress, frames: Sequence[int]) -> AnyPress:
    """Return a press with the given frames alone, in their order."""
    index = np.asarray(frames, dtype=np.int64)
    arrays = {
        field.name: getattr(press, field.name)[index]
        for field in fields(press)
        if isinstance(getattr(press, field.name), np.ndarray)
    }
    return replace(press, **arrays)


def frames_by_press(keys: Iterable[FrameKey]) -> dict[str, list[int]]:
    """Return the numbers of the frames of each trajectory."""
    frames: dict[str, list[int]] = {}
    for name, frame in keys:
        frames.setdefault(name, []).append(frame)
    return frames


def restricted(presses: Mapping[str, OpticalPress], keys: Iterable[FrameKey]) -> list[OpticalPress]:
    """Return the presses that have some of the frames, with those alone."""
    return [with_frames(presses[name], f) for name, f in frames_by_press(keys).items()]


def is_single_press(press: OpticalPress) -> bool:
    """Return whether a trajectory only goes deeper: neither a slide nor a cycle."""
    return bool(np.all(np.diff(press.tip_depth_m) > 0.0))


def score_frames(
    model: ImageModel,
    presses: Mapping[str, OpticalPress],
    keys: Iterable[FrameKey],
    rest: Rest,
    *,
    keep: Iterable[FrameKey] = (),
) -> tuple[list[ImageFrameScores], dict[FrameKey, ImageArray]]:
    """Return the scores of frames, and the predicted images (H, W, 3) of those to keep.

    Args:
        model: that predicts.
        presses: whole trajectories by name.
        keys: the frames to judge.
        rest: of the gel untouched.
        keep: frames whose images are wanted.

    Raises:
        ValueError: the model gives images of another shape.
    """
    wanted = set(keep)
    scores: list[ImageFrameScores] = []
    images: dict[FrameKey, ImageArray] = {}
    for name, frames in frames_by_press(keys).items():
        press = presses[name]
        judged = with_frames(press, frames)
        predicted = model.predict(judged, rest)
        if predicted.shape != judged.measured.shape:
            raise ValueError(
                f"{model.name} gives images of shape {predicted.shape} for {name}, expected "
                f"{judged.measured.shape}"
            )
        last = len(press.measured) - 1 if is_single_press(press) else -1
        for frame, image, measured in zip(frames, predicted, judged.measured, strict=True):
            score = score_image(image, measured, {"frame": None, "disc": rest.lit})
            scores.append(
                ImageFrameScores(
                    press=name,
                    indenter=press.indenter,
                    frame=frame,
                    tip_depth_m=float(press.tip_depth_m[frame]),
                    full_depth=frame == last,
                    frame_score=score["frame"],
                    disc_score=score["disc"],
                )
            )
            if (name, frame) in wanted:
                images[name, frame] = image
    return scores, images


def mean_score(scores: Sequence[ImageScore]) -> dict[str, float]:
    """Return the mean of each figure over frames; PSNR is the mean of the frames' PSNR."""
    return {
        field.name: float(np.mean([getattr(score, field.name) for score in scores]))
        for field in fields(ImageScore)
    }


def summarize(scores: Sequence[ImageFrameScores]) -> dict[str, Any]:
    """Return the figures of frames: over the whole frame at the top, then by region and depth.

    Returns:
        `psnr_db`, `mean_l2`, `significant_l2`, `ssim` over whole frames; the same under `disc`
        inside the lit disc; both again under `full_depth` (last frames of single presses) and
        `deep` (tip 2 mm deep at least), None where no frame is; `depths` and `indenters` with the
        figures of each range of depth and each indenter; `frames` and `trajectories`, how many.

    Raises:
        ValueError: no frame.
    """
    if not scores:
        raise ValueError("no frame was judged")
    figures = _figures(scores)
    figures["full_depth"] = _figures_or_none([s for s in scores if s.full_depth])
    figures["deep"] = _figures_or_none([s for s in scores if s.tip_depth_m >= DEEP_M])
    figures["depths"] = {
        name: _figures_or_none([s for s in scores if low <= s.tip_depth_m < high])
        for name, low, high in depth_ranges()
    }
    figures["indenters"] = {
        indenter: _figures([s for s in scores if s.indenter == indenter])
        for indenter in sorted({s.indenter for s in scores})
    }
    return figures


def _figures(scores: Sequence[ImageFrameScores]) -> dict[str, Any]:
    return {
        **mean_score([score.frame_score for score in scores]),
        "disc": mean_score([score.disc_score for score in scores]),
        "frames": len(scores),
        "trajectories": len({score.press for score in scores}),
    }


def _figures_or_none(scores: Sequence[ImageFrameScores]) -> dict[str, Any] | None:
    return _figures(scores) if scores else None


def scores_from_json(rows: Iterable[Mapping[str, Any]]) -> list[ImageFrameScores]:
    """Return scores of plain values.

    Raises:
        KeyError, TypeError: they are no scores.
    """
    return [
        ImageFrameScores(
            **{
                **row,
                "frame_score": ImageScore(**row["frame_score"]),
                "disc_score": ImageScore(**row["disc_score"]),
            }
        )
        for row in rows
    ]


def ceilings(data: OpticalData, idle_images: ImageArray) -> dict[str, float]:
    """Return what no model can pass, from measured images that show the same.

    `camera_noise_db`: a noiseless image against one with the camera's noise, estimated from the
    differences of the idle images, each of which has the noise twice. `two_renderings_db`: the idle
    image against the frames before anything touched; on a stand-in sensor they are another
    rendering of the same scene. `one_rendering_db`: a frame against an image without any noise,
    estimated from the differences of those frames, each of which has the noise of its own.

    Args:
        data: the measured frames.
        idle_images: (N, H, W, 3) single ones.
    """
    figures = {}
    if len(idle_images) > 1:
        figures["camera_noise_db"] = _noise_db(idle_images)
    untouched = [press.measured[0] for press in data.presses if press.tip_depth_m[0] < 0.0]
    if untouched:
        scores = [image_psnr_db(image, data.rest.idle) for image in untouched]
        figures["two_renderings_db"] = float(np.mean(scores))
    if len(untouched) > 1:
        figures["one_rendering_db"] = _noise_db(untouched)
    return figures


def _noise_db(images: Sequence[ImageArray] | ImageArray) -> float:
    """Return the PSNR of images that show the same against one without their noise."""
    pairs = [
        np.mean(((first.astype(np.float64) - second) / 255.0) ** 2)
        for first, second in pairwise(images)
    ]
    return psnr_db(0.5 * float(np.mean(pairs)))
