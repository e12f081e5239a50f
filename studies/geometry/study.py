# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Surfaces and forces of every model, on presses that were held out or recorded later."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dotsim_ros.data.data_set import DataSet, read_data_set
from dotsim_ros.data.presses import Press
from dotsim_ros.data.reading import PressReader, summarize_reasons
from dotsim_ros.data.split import (
    hold_out_of_protocols,
)
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.twin.press_metrics import (
    CONTACT_REACH_M,
    PressFrameScore,
    by_indenter,
    judged_frames,
    summarize,
)
from dotsim_ros.twin.surface_metrics import F_SCORE_THRESHOLD_M, SAMPLE_COUNT, SIGNIFICANT_SHARE
from studies.data import MEASURED, SENSOR_A
from studies.geometry.registry import NAMES, GeometryModel, factories_of
from studies.geometry.scores import (
    Factory,
    Measured,
    MeasuredNoise,
    ModelScores,
    Split,
    evaluate_model,
    floor_scores,
    leave_one_indenter_out,
    measurement_noise,
)

HELD_OUT = "held_out"


def geometry(
    *,
    data: Path = SENSOR_A,
    sensor: str = "sensor_a",
    models: tuple[GeometryModel, ...] = NAMES,
    splits: Literal["held_out", "all"] = "held_out",
    count: int = 9,
    stated: str = "densetact2",
    from_depth_mm: float = 2.0,
    seed: int = 0,
) -> dict[str, Any]:
    """Surfaces and forces of every model on presses that were held out.

    Args:
        data: folder of a data set.
        sensor: name or file of the sensor, or a folder with held_out.yaml and INDENTER.yaml.
        models: which.
        splits: the drawn one alone, or with each indenter left out in turn.
        count: presses held out.
        stated: sensor as its maker states it, for the explicit gels.
        from_depth_mm: least depth of the frames that are judged.
        seed: of the draws.
    """
    measured = read_measured(read_data_set(data))
    return _evaluate(
        measured,
        splits_of(measured, count=count, seed=seed, with_indenters=splits == "all"),
        factories_of(models, sensor=sensor, stated=stated),
        seed=seed,
        from_depth_m=1e-3 * from_depth_mm,
    )


def geometry_later(
    *,
    data: Path = MEASURED / "sensor_a_later",
    fit_data: Path = SENSOR_A,
    sensor: str = "docs/results/sensor_a_28.yaml",
    models: tuple[GeometryModel, ...] = NAMES,
    stated: str = "densetact2",
    from_depth_mm: float = 2.0,
    seed: int = 0,
) -> dict[str, Any]:
    """Surfaces and forces of every model on presses recorded after those that are fitted on.

    Args:
        data: folder of the later data set, all of which is judged.
        fit_data: folder of the one to fit on, of the same sensor, with its indenters' meshes.
        sensor: name or file of the sensor, or a folder with held_out.yaml.
        models: which.
        stated: sensor as its maker states it, for the explicit gels.
        from_depth_mm: least depth of the frames that are judged.
        seed: of the samples of surfaces.
    """
    measured, split = read_with_later(read_data_set(fit_data), read_data_set(data))
    return _evaluate(
        measured,
        [split],
        factories_of(models, sensor=sensor, stated=stated),
        seed=seed,
        from_depth_m=1e-3 * from_depth_mm,
    )


def read_measured(data: DataSet, *, meshes: DataSet | None = None) -> Measured:
    """Read every press of a data set; one that cannot be read is left out and named.

    Args:
        data: that holds the presses.
        meshes: the data set that holds the indenters; None takes the same.

    Raises:
        FileNotFoundError: the data set has no skin.
        ValueError: no press could be read.
    """
    skin = data.skin_mesh()
    reader = PressReader(data if meshes is None else meshes, skin, True)
    presses: dict[str, Press] = {}
    indenters: dict[str, Indenter] = {}
    left_out: dict[str, str] = {}
    for entry in data.entries:
        try:
            found = reader.read(entry)
        except (ValueError, OSError) as error:
            left_out[entry.name] = str(error)
            continue
        presses[found.press.name] = found.press
        indenters.setdefault(found.press.indenter, found.indenter)
    if not presses:
        reasons = summarize_reasons(list(left_out.values()))
        raise ValueError(f"{data.directory}: no press can be read: {reasons}")
    return Measured(presses, indenters, skin, left_out)


def read_with_later(earlier: DataSet, later: DataSet) -> tuple[Measured, Split]:
    """Read all presses of a data set to fit on, and all of a later one of the same sensor to judge.

    The indenters are those of the earlier one.

    Raises:
        FileNotFoundError: one of them has no skin.
        ValueError: no press of one of them could be read, their skins differ, or both have a press
            of one name.
    """
    fitted, judged = read_measured(earlier), read_measured(later, meshes=earlier)
    if not _is_same_skin(fitted.skin, judged.skin):
        raise ValueError(
            f"{later.directory}: its skin_mesh.npz is not that of {earlier.directory}; what is "
            "fitted on one sensor's skin is judged on presses of the same one"
        )
    twice = sorted(set(fitted.presses) & set(judged.presses))
    if twice:
        raise ValueError(
            f"{summarize_reasons(twice)} in both {earlier.directory} and {later.directory}; a "
            "press that was fitted on cannot be judged on, so give the later ones other names"
        )
    both = Measured(
        fitted.presses | judged.presses,
        fitted.indenters | judged.indenters,
        fitted.skin,
        fitted.left_out | judged.left_out,
    )
    return both, Split(HELD_OUT, tuple(sorted(fitted.presses)), tuple(sorted(judged.presses)))


def _is_same_skin(skin: SkinMesh, other: SkinMesh) -> bool:
    return np.array_equal(skin.triangles, other.triangles) and np.array_equal(
        skin.rest_position_m, other.rest_position_m
    )


def splits_of(measured: Measured, *, count: int, seed: int, with_indenters: bool) -> list[Split]:
    """Return the drawn split, and that of each indenter left out.

    Raises:
        ValueError: as `hold_out_of_protocols` and `leave_one_indenter_out`.
    """
    splits = [Split(HELD_OUT, *hold_out_of_protocols(measured.presses, count, seed))]
    if with_indenters:
        splits += leave_one_indenter_out(
            {name: press.indenter for name, press in measured.presses.items()}
        )
    return splits


def _evaluate(
    measured: Measured,
    splits: Sequence[Split],
    factories: Mapping[str, Factory],
    *,
    seed: int,
    from_depth_m: float,
) -> dict[str, Any]:
    """Return the figures of every model on every split, as the JSON file holds them.

    Raises:
        ValueError: a model could not be made, or no frame is deep enough.
    """
    how: dict[str, Any] = {"seed": seed, "from_depth_m": from_depth_m}
    figures: dict[str, Any] = {}
    for name, factory in factories.items():
        results = {}
        for split in splits:
            print(f"{name}, {split.name}: fitting on {len(split.train)} presses")
            results[split.name] = evaluate_model(factory, split, measured, **how)
        figures[name] = _figures_of(results)
    print("floor: each measured surface against itself resampled")
    judged = sorted({name for split in splits for name in split.test})
    presses = {name: measured.presses[name] for name in judged}
    floors = {
        name: floor_scores(press, measured.indenters[press.indenter], measured.skin, **how)
        for name, press in presses.items()
    }
    noise = measurement_noise(measured.presses.values(), measured.skin)
    results = {
        split.name: ModelScores(tuple(score for n in split.test for score in floors[n]))
        for split in splits
    }
    figures["floor"] = _figures_of(results, noise)
    figures["splits"] = {split.name: asdict(split) for split in splits}
    figures["left_out_presses"] = measured.left_out
    figures["definitions"] = definitions(from_depth_m)
    figures["judged_frames"] = {
        name: judged_frames(press, measured.skin, from_depth_m=from_depth_m).tolist()
        for name, press in presses.items()
    }
    return figures


def _figures_of(
    results: Mapping[str, ModelScores], noise: MeasuredNoise | None = None
) -> dict[str, Any]:
    figures: dict[str, Any] = {}
    failures = [asdict(f) | {"split": s} for s, r in results.items() for f in r.failures]
    drawn = results.get(HELD_OUT)
    if drawn is not None:
        figures[HELD_OUT] = _figures(drawn.scores, noise)
        figures["held_out_by_indenter"] = {
            indenter: _figures(scores, noise)
            for indenter, scores in by_indenter(drawn.scores).items()
        }
    left_out = {name: result for name, result in results.items() if name != HELD_OUT}
    if left_out:
        figures["indenter_left_out"] = {
            name: _figures(result.scores, noise) for name, result in left_out.items()
        }
        everything = [score for result in left_out.values() for score in result.scores]
        figures["indenter_left_out_all"] = _figures(everything, noise)
    figures["failures"] = failures
    return figures


def _figures(
    scores: Sequence[PressFrameScore], noise: MeasuredNoise | None
) -> dict[str, Any] | None:
    if not scores:
        return None
    figures = asdict(summarize(scores))
    return figures if noise is None else figures | _noise_figures(scores, noise)


def _noise_figures(
    scores: Sequence[PressFrameScore], noise: MeasuredNoise
) -> dict[str, float | None]:
    """Return what the noise of the measurement alone makes of the figures without samples."""
    forces = [score.measured_n for score in scores if score.measured_n is not None]
    inside = [score.inside_m for score in scores if np.isfinite(score.inside_m)]
    embedded_m = float(np.sqrt(np.mean(np.square(inside)))) if inside else 0.0
    floor: dict[str, float | None] = {
        "skin_rms_mm": 1e3 * noise.skin_rms_m,
        "contact_rms_mm": 1e3 * max(noise.skin_rms_m, embedded_m),
        "vertex_rms_mm": 1e3 * noise.vertex_rms_m,
    }
    if forces:
        square = np.mean(np.square(forces), axis=0)
        one = noise.force_rms_n
        floor["normal_force_error"] = one / float(np.sqrt(square[2]))
        floor["tangential_force_error"] = one * float(np.sqrt(2.0 / (square[0] + square[1])))
        floor["shear_force_error"] = one * float(np.sqrt(2.0 / square.sum()))
    return floor


def definitions(from_depth_m: float) -> dict[str, str]:
    """Return what each figure means, in words."""
    return {
        "frames": (
            f"judged are frames whose tip lies at least {1e3 * from_depth_m:g} mm below the skin "
            "at rest; means and root mean squares give each the same weight"
        ),
        "samples": (
            f"{SAMPLE_COUNT} points of each surface, uniform by area, from independent draws; all "
            "models share the same draws"
        ),
        "chamfer_mm": "mean distance to the nearest sample of the other surface, both ways",
        "significant_chamfer_mm": (
            f"the same over the farthest {100 * SIGNIFICANT_SHARE:g} % of the samples"
        ),
        "emd_mm": "mean distance of the best one-to-one assignment of the samples, exact",
        "f_score": (
            "harmonic mean of the shares of samples within "
            f"{1e3 * F_SCORE_THRESHOLD_M:g} mm of the other surface's"
        ),
        "skin_rms_mm": (
            "root mean square over the area of the dome of the distance from the measured skin's "
            "vertices to the predicted triangles"
        ),
        "contact_rms_mm": (
            "the same where the measured skin is nearer to the indenter than "
            f"{1e3 * CONTACT_REACH_M:g} mm, or in it"
        ),
        "vertex_rms_mm": "root mean square of each measured vertex's distance to the predicted one",
        "normal_force_error": (
            "root mean square of the error along the sensor's axis over that of the measured force "
            "along it"
        ),
        "tangential_force_error": "the same in the sensor's base plane",
        "shear_force_error": (
            "root mean square of the error along the skin in contact over that of the whole force"
        ),
        "floor": (
            "of the samples: the measured surface against itself, drawn again; of the others: what "
            "was measured before anything touched, against the skin at rest and no force; of the "
            "contact region how deep the measured skin lies in the indenter, where that is more: "
            "no surface outside of the indenter is nearer to it"
        ),
    }
