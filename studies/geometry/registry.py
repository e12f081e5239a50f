# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The models that the geometry tables compare, by name, each made for a split when asked."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, cast, get_args

from dotsim_ros.data.presses import Press
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.specification import SensorSpecification, load_sensor
from studies.geometry.explicit import ExplicitFit
from studies.geometry.implicit_model import ImplicitModel
from studies.geometry.scores import Factory, Model, Split

BASELINES = ("tacto", "taxim", "difftactile")
"""Each is a module of `studies.rivals` with `fit(train, indenters, skin) -> Model`."""
EXPLICIT = ("explicit", "explicit_fitted")
"""The paper's gel with the paper's modulus, and with one that is fitted to the forces."""
GeometryModel = Literal["ours", "explicit", "explicit_fitted", "tacto", "taxim", "difftactile"]
NAMES: tuple[GeometryModel, ...] = get_args(GeometryModel)


def sensor_file(split: str, sensor: str | Path) -> str | Path:
    """Return the name or file of the sensor to judge a split with.

    Args:
        split: its name.
        sensor: name or file of a sensor, which serves for every split; or a folder with one file
            `SPLIT.yaml` for each, calibrated without what it is judged on.

    Raises:
        FileNotFoundError: the folder lacks the split's file.
    """
    folder = Path(sensor)
    if not folder.is_dir():
        return sensor
    path = folder / f"{split}.yaml"
    if not path.is_file():
        raise FileNotFoundError(
            f"{folder} holds no {path.name}: calibrate on the presses that split {split!r} "
            "leaves for it, or name one sensor's file"
        )
    return path


def sensor_for(split: Split, sensor: str | Path) -> SensorSpecification:
    """Return the specification to judge a split with; arguments as `sensor_file`.

    Raises:
        FileNotFoundError: no such sensor, or the folder lacks the split's file.
        ValueError: it is no sensor.
    """
    return load_sensor(sensor_file(split.name, sensor))


def _ours(sensor: str | Path) -> Factory:
    def make(
        split: Split,
        _train: Sequence[Press],
        _indenters: Mapping[str, Indenter],
        _skin: SkinMesh,
    ) -> Model:
        specification = sensor_for(split, sensor)
        solver = replace(specification.solver, method="implicit")
        return ImplicitModel(replace(specification, solver=solver))

    return make


def _explicit(fits: ExplicitFit, *, with_force: bool) -> Factory:
    def make(
        _split: Split,
        train: Sequence[Press],
        indenters: Mapping[str, Indenter],
        skin: SkinMesh,
    ) -> Model:
        fit = fits.fit_with_force if with_force else fits.fit
        return fit(train, indenters, skin)

    return make


def _difftactile() -> Factory:
    """Return what makes DiffTactile; the fits of several splits share their runs."""
    from studies.rivals.difftactile import DynamicGel, FitTrials, Shell, fit

    trials: list[FitTrials] = []

    def make(
        _split: Split,
        train: Sequence[Press],
        indenters: Mapping[str, Indenter],
        skin: SkinMesh,
    ) -> Model:
        if not trials:
            trials.append(FitTrials(DynamicGel(Shell().mesh(skin), skin), indenters))
        return fit(train, indenters, skin, trials=trials[0])

    return make


def _fitted_baseline(name: str) -> Factory:
    def make(
        _split: Split,
        train: Sequence[Press],
        indenters: Mapping[str, Indenter],
        skin: SkinMesh,
    ) -> Model:
        module = importlib.import_module(f"studies.rivals.{name}")
        return cast(Model, module.fit(train, indenters, skin))

    return make


def factories_of(
    names: Sequence[str], *, sensor: str | Path, stated: str | Path
) -> dict[str, Factory]:
    """Return what makes each model; the two explicit gels share the runs of their fits.

    Args:
        names: some of `NAMES`.
        sensor: of "ours", see `sensor_for`.
        stated: name or file of the sensor as its maker states it, for body, density and friction
            of the explicit gels.

    Raises:
        ValueError: no such model, or one that this installation lacks.
    """
    explicit = ExplicitFit(load_sensor(stated)) if set(names) & set(EXPLICIT) else None
    factories = {}
    for name in names:
        if name == "ours":
            factories[name] = _ours(sensor)
        elif name in EXPLICIT and explicit is not None:
            factories[name] = _explicit(explicit, with_force=name == "explicit_fitted")
        else:
            factories[name] = _baseline(name)
    return factories


def _baseline(name: str) -> Factory:
    if name not in BASELINES:
        raise ValueError(f"no model {name!r}; known are {', '.join(NAMES)}")
    module = f"studies.rivals.{name}"
    if importlib.util.find_spec(module) is None:
        raise ValueError(f"model {name!r} is not installed: there is no module {module}")
    return _difftactile() if name == "difftactile" else _fitted_baseline(name)
