# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Surfaces and forces of every model, on presses that were held out or recorded later."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from dotsim_ros.data.data_set import read_data_set
from studies.data import MEASURED, SENSOR_A
from studies.geometry.registry import NAMES, GeometryModel, factories_of
from studies.geometry.report import evaluate_geometry, read_measured, read_with_later, splits_of


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
    return evaluate_geometry(
        measured,
        splits_of(measured, count=count, seed=seed, with_indenters=splits == "all"),
        factories_of(models, sensor=sensor, stated=stated),
        seed=seed,
        from_depth_m=1e-3 * from_depth_mm,
        progress=print,
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
    return evaluate_geometry(
        measured,
        [split],
        factories_of(models, sensor=sensor, stated=stated),
        seed=seed,
        from_depth_m=1e-3 * from_depth_mm,
        progress=print,
    )
