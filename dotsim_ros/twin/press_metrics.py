# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Scores of predicted surfaces and forces against measured presses, and their summaries."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.data.presses import Model, Prediction, Press
from dotsim_ros.data.split import Split
from dotsim_ros.geometry.indenter import Indenter
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
    surface_distance,
    weighted_rms,
)

JUDGED_DEPTH_M = 2.0e-3
"""Frames whose indenter is less deep are easy for every model and are not judged."""
CONTACT_REACH_M = 0.5e-3
"""Measured skin nearer to the indenter than this is the contact region: the noise of skin and pose
is a tenth of it, and a measured mesh has corners a few tenths of a millimetre off."""

Factory = Callable[[Split, Sequence[Press], Mapping[str, Indenter], SkinMesh], Model]
"""Makes a model for a split, given the presses to fit it on, their indenters, and the skin."""


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


@dataclass(frozen=True)
class Failure:
    """A press that a model could not predict, and why."""

    press: str
    reason: str


@dataclass(frozen=True)
class ModelScores:
    """What one model got on the presses of a split.

    Attributes:
        scores: of every frame judged.
        failures: presses that it could not predict, which are in no score.
    """

    scores: tuple[PressFrameScore, ...]
    failures: tuple[Failure, ...] = ()


def judged_frames(
    press: Press, skin: SkinMesh, *, from_depth_m: float = JUDGED_DEPTH_M
) -> NDArray[np.int64]:
    """Return the numbers of the frames whose tip is at least so deep."""
    return np.flatnonzero(tip_depth_m(skin, press.poses) >= from_depth_m)


def contact_region(measured_m: FloatArray, pose: Pose, indenter: Indenter) -> BoolArray:
    """Return which measured vertices (V, 3) lie within 0.5 mm of the indenter, or in it."""
    return np.asarray(indenter.distance_from(measured_m, pose) < CONTACT_REACH_M)


def _measured_skin(press: Press, skin: SkinMesh) -> FloatArray:
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
    """Return the scores of the judged frames of a press.

    Args:
        press: what was measured.
        prediction: of a model.
        indenter: that pressed.
        skin: the measured skin at rest.
        seed: of the samples of the surfaces.
        from_depth_m: depth of the tip from which frames are judged.

    Raises:
        ValueError: no skin was measured, or a prediction of another shape or not finite.
    """
    measured = _measured_skin(press, skin)
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


def floor_scores(
    press: Press,
    indenter: Indenter,
    skin: SkinMesh,
    *,
    seed: int = 0,
    from_depth_m: float = JUDGED_DEPTH_M,
) -> list[PressFrameScore]:
    """Return what a perfect prediction would get: the measured surface against itself resampled,
    and forces against those measured.

    Scores that use no samples are zero here; `measurement_noise` gives their lower bound.
    """
    measured = _measured_skin(press, skin)
    perfect = Prediction(measured, press.force_n)
    return score_press(press, perfect, indenter, skin, seed=seed, from_depth_m=from_depth_m)


@dataclass(frozen=True)
class MeasuredNoise:
    """What was measured before anything touched, where a model cannot be wrong.

    Attributes:
        skin_rms_m: distance from the measured vertices to the surface at rest.
        vertex_rms_m: distance to where each vertex rests.
        force_rms_n: of one component of the force.
        frames: how many.
    """

    skin_rms_m: float
    vertex_rms_m: float
    force_rms_n: float
    frames: int


def measurement_noise(presses: Iterable[Press], skin: SkinMesh) -> MeasuredNoise | None:
    """Return the noise of the frames before the first touch; None where there are none."""
    skin_m, vertex_m, force_n = [], [], []
    for press in presses:
        depth = tip_depth_m(skin, press.poses)
        if depth[0] >= 0.0 or press.force_n is None:
            continue
        first = _measured_skin(press, skin)[0]
        distance = surface_distance(first, skin.rest_position_m, skin.triangles)
        skin_m.append(weighted_rms(distance, skin.rest_area_m2))
        moved = np.linalg.norm(first - skin.rest_position_m, axis=1)
        vertex_m.append(weighted_rms(moved, skin.rest_area_m2))
        force_n.append(press.force_n[0])
    if not skin_m:
        return None
    return MeasuredNoise(
        root_mean_square(skin_m), root_mean_square(vertex_m), root_mean_square(force_n), len(skin_m)
    )


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
    forces = _force_errors(scores)
    return Summary(
        chamfer_mm=1e3 * means["chamfer_m"],
        significant_chamfer_mm=1e3 * means["significant_chamfer_m"],
        emd_mm=1e3 * means["earth_mover_m"],
        f_score=means["f_score"],
        skin_rms_mm=1e3 * root_mean_square([score.skin_m for score in scores]),
        contact_rms_mm=1e3 * root_mean_square(contact) if contact else None,
        vertex_rms_mm=1e3 * root_mean_square([score.vertex_m for score in scores]),
        normal_force_error=forces.normal,
        tangential_force_error=forces.tangential,
        shear_force_error=forces.shear,
        frames=len(scores),
        presses=len({score.press for score in scores}),
    )


@dataclass(frozen=True)
class _ForceErrors:
    normal: float | None
    tangential: float | None
    shear: float | None


def _force_errors(scores: Sequence[PressFrameScore]) -> _ForceErrors:
    pairs = [
        (score.predicted_n, score.measured_n, score.normal)
        for score in scores
        if score.predicted_n is not None and score.measured_n is not None
    ]
    if not pairs:
        return _ForceErrors(None, None, None)
    predicted, measured, normal = (np.stack(column) for column in zip(*pairs, strict=True))
    return _ForceErrors(
        relative_rms(predicted[:, 2] - measured[:, 2], measured[:, 2]),
        relative_rms(predicted[:, :2] - measured[:, :2], measured[:, :2]),
        relative_rms(along_surface(predicted - measured, normal), measured),
    )


def by_indenter(scores: Iterable[PressFrameScore]) -> dict[str, list[PressFrameScore]]:
    """Return the scores of each indenter, in the order of their names."""
    grouped: dict[str, list[PressFrameScore]] = {}
    for score in scores:
        grouped.setdefault(score.indenter, []).append(score)
    return dict(sorted(grouped.items()))


def evaluate_model(
    factory: Factory,
    split: Split,
    presses: Mapping[str, Press],
    indenters: Mapping[str, Indenter],
    skin: SkinMesh,
    *,
    seed: int = 0,
    from_depth_m: float = JUDGED_DEPTH_M,
    progress: Callable[[str], None] = lambda _press: None,
) -> ModelScores:
    """Fit a model on the training presses of a split and score it on the others.

    A press that the model cannot predict is reported, and the others are still judged.

    Args:
        factory: makes the model.
        split: what to fit on and to judge on.
        presses: by name.
        indenters: by name.
        skin: the measured skin at rest.
        seed: of the samples.
        from_depth_m: depth of the tip from which frames are judged.
        progress: called with the name of each press that is done.

    Raises:
        ValueError: the model could not be made.
    """
    model = factory(split, [presses[name] for name in split.train], indenters, skin)
    scores: list[PressFrameScore] = []
    failures: list[Failure] = []
    for name in split.test:
        press = presses[name]
        indenter = indenters[press.indenter]
        try:
            prediction = model.predict(press, indenter, skin)
            scores += score_press(
                press, prediction, indenter, skin, seed=seed, from_depth_m=from_depth_m
            )
        # Solvers that fail raise either; the table says so rather than end.
        except (ValueError, RuntimeError) as error:
            failures.append(Failure(name, str(error)))
        progress(name)
    return ModelScores(tuple(scores), tuple(failures))
