# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Scores of predicted surfaces and forces against measured presses, and their summaries."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.data.presses import Prediction, Press
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.mesh_distance import surface_distance
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, tip_depth_m, vertex_normals
from dotsim_ros.io.arrays import BoolArray, FloatArray
from dotsim_ros.twin.surface_metrics import (
    SAMPLE_COUNT,
    CloudDistances,
    along_surface,
    cloud_distances,
    relative_rms,
    sample_surface,
    weighted_rms,
)

JUDGED_DEPTH_M = 2.0e-3
"""Frames whose indenter is less deep are easy for every model and are not judged."""
CONTACT_REACH_M = 0.5e-3
"""Measured skin nearer to the indenter than this is the contact region: the noise of skin and pose
is a tenth of it, and a measured mesh has corners a few tenths of a millimetre off."""


@dataclass(frozen=True)
class PressFrameScore:
    """How one predicted frame differs from the measured one.

    Attributes:
        press: name of the press.
        indenter: name of the indenter.
        frame: its number in the press.
        clouds: distances between samples of the two surfaces.
        skin_m: root mean square, over the area of the skin, of the distance from the measured skin
            to the predicted surface.
        contact_m: likewise over the contact region; NaN where nothing is in contact.
        vertex_m: root mean square, over the area, of how far each measured vertex is from where it
            is predicted to be (with what slides along the surface).
        inside_m: root mean square, over the contact region, of how deep the measured skin lies in
            the indenter: no surface that stays outside of the indenter has a smaller contact_m.
        normal: (3,) mean outward unit normal, at rest, of the skin in contact.
        measured_n, predicted_n: (3,) forces; None where there is none.
    """

    press: str
    indenter: str
    frame: int
    clouds: CloudDistances
    skin_m: float
    contact_m: float
    vertex_m: float
    inside_m: float
    normal: FloatArray
    measured_n: FloatArray | None
    predicted_n: FloatArray | None


@dataclass(frozen=True)
class Summary:
    """Scores of several frames together; None where a figure does not exist.

    Attributes:
        chamfer_mm, significant_chamfer_mm, emd_mm, f_score: means over the frames.
        skin_rms_mm, contact_rms_mm, vertex_rms_mm: root mean squares over the frames.
        normal_force_error, tangential_force_error: root mean square of the error over that of the
            measured component, along the sensor's axis (base frame +z) and in its base plane, as a
            force sensor below it reads.
        shear_force_error: root mean square of the error along the skin in contact over that of the
            whole force. A press without a slide has little shear, which as a share of itself would
            be noise.
        frames: how many.
        presses: of how many presses.
    """

    chamfer_mm: float
    significant_chamfer_mm: float
    emd_mm: float
    f_score: float
    skin_rms_mm: float
    contact_rms_mm: float | None
    vertex_rms_mm: float
    normal_force_error: float | None
    tangential_force_error: float | None
    shear_force_error: float | None
    frames: int
    presses: int


def judged_frames(
    press: Press, skin: SkinMesh, *, from_depth_m: float = JUDGED_DEPTH_M
) -> NDArray[np.int64]:
    """Return the numbers of the frames whose tip is at least so deep."""
    return np.flatnonzero(tip_depth_m(skin, press.poses) >= from_depth_m)


def contact_region(measured_m: FloatArray, pose: Pose, indenter: Indenter) -> BoolArray:
    """Return which measured vertices (V, 3) lie within 0.5 mm of the indenter, or in it."""
    return np.asarray(indenter.distance_from(measured_m, pose) < CONTACT_REACH_M)


def measured_skin(press: Press, skin: SkinMesh) -> FloatArray:
    """Return the skin (F, V, 3) of a press.

    Raises:
        ValueError: none was measured, or of another number of vertices.
    """
    if press.skin_position_m is None:
        raise ValueError(f"{press.name}: no skin was measured, so no surface can be judged")
    if press.skin_position_m.shape[1] != skin.vertex_count:
        raise ValueError(
            f"{press.name}: {press.skin_position_m.shape[1]} points of the skin, but its mesh has "
            f"{skin.vertex_count} vertices"
        )
    return press.skin_position_m


def _check_prediction(press: Press, prediction: Prediction, skin: SkinMesh) -> None:
    expected = (press.frame_count, skin.vertex_count, 3)
    if prediction.skin_position_m.shape != expected:
        raise ValueError(
            f"{press.name}: predicted skin of shape {prediction.skin_position_m.shape}, expected "
            f"{expected}"
        )
    if not np.all(np.isfinite(prediction.skin_position_m)):
        raise ValueError(f"{press.name}: the predicted skin is not finite")
    force = prediction.force_n
    if force is not None and (
        force.shape != (press.frame_count, 3) or not np.all(np.isfinite(force))
    ):
        raise ValueError(
            f"{press.name}: predicted forces of shape {force.shape}, expected "
            f"({press.frame_count}, 3) of finite numbers"
        )


def _sample(position_m: FloatArray, skin: SkinMesh, seed: int, *draw: int) -> FloatArray:
    # Samples of two surfaces must not share their draws: neighbours would then be the same points.
    random = np.random.default_rng([seed, *draw])
    return sample_surface(position_m, skin.triangles, SAMPLE_COUNT, random)


def score_press(
    press: Press,
    prediction: Prediction,
    indenter: Indenter,
    skin: SkinMesh,
    *,
    seed: int = 0,
    from_depth_m: float = JUDGED_DEPTH_M,
) -> list[PressFrameScore]:
    """Return the scores of the frames of a press whose tip is at least `from_depth_m` deep.

    The surfaces are sampled by the seed; `skin` is the measured one at rest.

    Raises:
        ValueError: no skin was measured, or a prediction of another shape or not finite.
    """
    measured = measured_skin(press, skin)
    _check_prediction(press, prediction, skin)
    area = skin.rest_area_m2
    rest_normal = vertex_normals(skin.rest_position_m, skin.triangles)
    scores = []
    for frame in judged_frames(press, skin, from_depth_m=from_depth_m).tolist():
        predicted = prediction.skin_position_m[frame]
        distance = indenter.distance_from(measured[frame], press.poses[frame])
        region = distance < CONTACT_REACH_M
        inside = np.maximum(0.0, -distance[region])
        skin_m, contact_m = surface_errors(measured[frame], predicted, region, skin)
        scores.append(
            PressFrameScore(
                press=press.name,
                indenter=press.indenter,
                frame=frame,
                clouds=cloud_distances(
                    _sample(predicted, skin, seed, frame, 0),
                    _sample(measured[frame], skin, seed, frame, 1),
                ),
                skin_m=skin_m,
                contact_m=contact_m,
                vertex_m=weighted_rms(np.linalg.norm(predicted - measured[frame], axis=1), area),
                inside_m=weighted_rms(inside, area[region]) if region.any() else np.nan,
                normal=_mean_normal(rest_normal, area * region, press.poses[frame]),
                measured_n=None if press.force_n is None else press.force_n[frame],
                predicted_n=None if prediction.force_n is None else prediction.force_n[frame],
            )
        )
    return scores


def surface_errors(
    measured_m: FloatArray, predicted_m: FloatArray, region: BoolArray, skin: SkinMesh
) -> tuple[float, float]:
    """Return the root mean square distances (m) from the measured vertices (V, 3) to the predicted
    surface (V, 3), over the area of the skin and over that of a region (V,); NaN for an empty one.
    """
    area = skin.rest_area_m2
    distance = surface_distance(measured_m, predicted_m, skin.triangles)
    whole = weighted_rms(distance, area)
    return whole, weighted_rms(distance[region], area[region]) if region.any() else np.nan


def _mean_normal(normal: FloatArray, weight: FloatArray, pose: Pose) -> FloatArray:
    mean = weight @ normal
    length = float(np.linalg.norm(mean))
    return np.asarray(mean / length) if length > 0.0 else pose.rotation()[:, 2]


def root_mean_square(values: Sequence[float] | Sequence[FloatArray] | FloatArray) -> float:
    """Return the root mean square of all numbers."""
    return float(np.sqrt(np.mean(np.square(values))))


def summarize(scores: Sequence[PressFrameScore]) -> Summary:
    """Return the figures of several frames.

    Raises:
        ValueError: no frame.
    """
    if not scores:
        raise ValueError("no frame was judged: no press is as deep as asked for")
    means = {
        field.name: float(np.mean([getattr(score.clouds, field.name) for score in scores]))
        for field in fields(CloudDistances)
    }
    contact = [score.contact_m for score in scores if np.isfinite(score.contact_m)]
    return Summary(
        chamfer_mm=1e3 * means["chamfer_m"],
        significant_chamfer_mm=1e3 * means["significant_chamfer_m"],
        emd_mm=1e3 * means["earth_mover_m"],
        f_score=means["f_score"],
        skin_rms_mm=1e3 * root_mean_square([score.skin_m for score in scores]),
        contact_rms_mm=1e3 * root_mean_square(contact) if contact else None,
        vertex_rms_mm=1e3 * root_mean_square([score.vertex_m for score in scores]),
        **_force_errors(scores),
        frames=len(scores),
        presses=len({score.press for score in scores}),
    )


def _force_errors(scores: Sequence[PressFrameScore]) -> dict[str, float | None]:
    names = ("normal_force_error", "tangential_force_error", "shear_force_error")
    pairs = [
        (score.predicted_n, score.measured_n, score.normal)
        for score in scores
        if score.predicted_n is not None and score.measured_n is not None
    ]
    if not pairs:
        return dict.fromkeys(names)
    predicted, measured, normal = (np.stack(column) for column in zip(*pairs, strict=True))
    error = predicted - measured
    errors = (
        relative_rms(error[:, 2], measured[:, 2]),
        relative_rms(error[:, :2], measured[:, :2]),
        relative_rms(along_surface(error, normal), measured),
    )
    return dict(zip(names, errors, strict=True))


def by_indenter(scores: Iterable[PressFrameScore]) -> dict[str, list[PressFrameScore]]:
    """Return the scores of each indenter, in the order of their names."""
    grouped: dict[str, list[PressFrameScore]] = {}
    for score in scores:
        grouped.setdefault(score.indenter, []).append(score)
    return dict(sorted(grouped.items()))
