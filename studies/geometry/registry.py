# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The models that the geometry tables compare, by name, each made for a split when asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, get_args

from dotsim_ros.data.presses import Press
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.specification import SensorSpecification, load_sensor
from studies.geometry.batched_model import BatchedModel
from studies.geometry.explicit import ExplicitFit
from studies.geometry.implicit_model import ImplicitModel
from studies.geometry.scores import Factory, Model, Split
from studies.rivals import difftactile, tacto, taxim
from studies.run import expect_known

GeometryModel = Literal[
    "ours",
    "batched",
    "batched_fine",
    "explicit",
    "explicit_fitted",
    "tacto",
    "taxim",
    "difftactile",
]
NAMES: tuple[GeometryModel, ...] = get_args(GeometryModel)
"""The explicit gel is the paper's, with the paper's modulus and with one fitted to the forces."""


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


def factories_of(
    names: Sequence[str], *, sensor: str | Path, stated: str | Path
) -> dict[str, Factory]:
    """Return what makes each model; the two explicit gels share the runs of their fits, as do the
    fits of DiffTactile on several splits.

    Args:
        names: some of `NAMES`.
        sensor: of "ours" and the batched gels, see `sensor_file`.
        stated: name or file of the sensor as its maker states it, for body, density and friction
            of the explicit gels.

    Raises:
        ValueError: no such model.
    """
    expect_known("model", names, NAMES)
    explicit = ExplicitFit(load_sensor(stated))
    # DiffTactile's mesh is that of the skin, which comes with the first split.
    trials: list[difftactile.FitTrials] = []

    def implicit(split: Split) -> SensorSpecification:
        specification = load_sensor(sensor_file(split.name, sensor))
        solver = replace(specification.solver, method="implicit")
        return replace(specification, solver=solver)

    def dynamic(
        _split: Split, train: Sequence[Press], indenters: Mapping[str, Indenter], skin: SkinMesh
    ) -> Model:
        if not trials:
            gel = difftactile.DynamicGel(difftactile.Shell().mesh(skin), skin)
            trials.append(difftactile.FitTrials(gel, indenters))
        return difftactile.fit(train, trials[0])

    makers: dict[str, Factory] = {
        "ours": lambda split, *_given: ImplicitModel(implicit(split)),
        "batched": lambda split, *_given: BatchedModel(implicit(split), "default"),
        "batched_fine": lambda split, *_given: BatchedModel(implicit(split), "fine"),
        "explicit": lambda _split, *given: explicit.fit(*given),
        "explicit_fitted": lambda _split, *given: explicit.fit_with_force(*given),
        "tacto": lambda _split, *given: tacto.fit(*given),
        "taxim": lambda _split, *given: taxim.fit(*given),
        "difftactile": dynamic,
    }
    return {name: makers[name] for name in names}
