# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What resolution and effort cost, and what they buy: the runtime table."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.data.presses import Prediction, Press
from dotsim_ros.gel.explicit.gel import PAPER_FRAME_S
from dotsim_ros.gel.make import law_of
from dotsim_ros.gel.material import NeoHookean, small_strain_moduli_pa
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.specification import SensorSpecification, load_sensor
from dotsim_ros.twin.follow import steps
from dotsim_ros.twin.press_metrics import (
    contact_region,
    judged_frames,
    root_mean_square,
    surface_errors,
)
from dotsim_ros.twin.surface_metrics import relative_rms
from studies.data import SENSOR_A
from studies.geometry.explicit import SETTINGS, ExplicitModel
from studies.geometry.implicit_model import ImplicitModel
from studies.geometry.scores import Measured
from studies.geometry.study import read_measured

WARM_UP_FRAMES = 2


@dataclass(frozen=True)
class Effort:
    """One row of the table.

    Attributes:
        method: "implicit" or "explicit".
        spacing_m: of the grid.
        tolerance_m: of the implicit gel's solver.
        substeps: of the explicit gel in a frame of 1/24 s.
    """

    method: str
    spacing_m: float
    tolerance_m: float | None = None
    substeps: int | None = None

    @property
    def effort(self) -> str:
        """Tolerance or substeps, in words."""
        if self.tolerance_m is None:
            return f"{self.substeps} substeps"
        return f"{1e6 * self.tolerance_m:g} um"


EFFORTS = (
    Effort("implicit", 2.4e-3, tolerance_m=100e-6),
    Effort("implicit", 2.4e-3, tolerance_m=10e-6),
    Effort("implicit", 2.4e-3, tolerance_m=1e-6),
    Effort("implicit", 1.8e-3, tolerance_m=10e-6),
    Effort("explicit", 2.4e-3, substeps=50),
    Effort("explicit", 2.4e-3, substeps=100),
    Effort("explicit", 1.2e-3, substeps=100),
    Effort("explicit", 1.2e-3, substeps=200),
)


def runtime(
    *,
    data: Path = SENSOR_A,
    sensor: str = "sensor_a",
    presses: tuple[str, ...] = ("1_sphere_0", "2_cone_3"),
) -> dict[str, Any]:
    """Frames a second of each solver against its error.

    Args:
        data: folder of a data set.
        sensor: name or file of the sensor.
        presses: names of those to follow.

    Raises:
        ValueError: no such press.
    """
    measured = read_measured(read_data_set(data))
    unknown = sorted(set(presses) - set(measured.presses))
    if unknown:
        raise ValueError(
            f"no press {', '.join(unknown)}; the data set holds {', '.join(measured.presses)}"
        )
    specification = load_sensor(sensor)
    rows = [_row(effort, specification, presses, measured) for effort in EFFORTS]
    return {"presses": list(presses), "rows": rows}


def model_of(effort: Effort, specification: SensorSpecification) -> ImplicitModel | ExplicitModel:
    """Return the model of a row: the sensor's gel, solved so.

    The explicit gel is neo-Hookean with the moduli that the sensor's law has at small strain. Grids
    other than the implicit gel's own are not refined.
    """
    if effort.tolerance_m is None:
        # Softness counts in cells; the paper's two rows mean the same length.
        settings = replace(
            SETTINGS,
            spacing_m=effort.spacing_m,
            substeps_per_frame=effort.substeps or SETTINGS.substeps_per_frame,
            softness=SETTINGS.softness * effort.spacing_m / SETTINGS.spacing_m,
        )
        youngs, bulk = small_strain_moduli_pa(law_of(specification.material))
        law = NeoHookean(youngs, 0.5 - youngs / (6.0 * bulk))
        return ExplicitModel(specification, law, settings)
    own = specification.solver
    solver = replace(
        own,
        method="implicit",
        grid_spacing_m=effort.spacing_m,
        tolerance_m=effort.tolerance_m,
        refined=own.refined and effort.spacing_m == own.grid_spacing_m,
    )
    return ImplicitModel(replace(specification, solver=solver), longest_step_s=PAPER_FRAME_S)


def _row(
    effort: Effort, specification: SensorSpecification, names: Sequence[str], measured: Measured
) -> dict[str, Any]:
    """Return a row of the table.

    The gel follows the presses in frames of at most 1/24 s; building it and its tables is not
    timed. A press that it cannot follow is named in the row and in none of its figures.
    """
    model, skin = model_of(effort, specification), measured.skin
    seconds, cpu_seconds, count, failed = 0.0, 0.0, 0, {}
    errors = _Errors()
    for name in names:
        press = measured.presses[name]
        print(f"{effort.method}, {1e3 * effort.spacing_m:g} mm, {effort.effort}: {name}")
        indenter = measured.indenters[press.indenter]
        try:
            model.predict(_first_frames(press), indenter, skin)
            begun, cpu_begun = time.perf_counter(), time.process_time()
            prediction = model.predict(press, indenter, skin)
            seconds += time.perf_counter() - begun
            cpu_seconds += time.process_time() - cpu_begun
        # Solvers that fail raise either; the row says so.
        except (ValueError, RuntimeError) as error:
            failed[name] = str(error)
            continue
        count += sum(1 for _ in steps(press.poses, press.stamp_s, longest_step_s=PAPER_FRAME_S))
        errors.add(press, prediction, indenter, skin)
    return {
        "method": effort.method,
        "spacing_mm": 1e3 * effort.spacing_m,
        "effort": effort.effort,
        "frames_per_cpu_second": count / cpu_seconds if count else None,
        "frames_per_second": count / seconds if count else None,
        **errors.figures(),
        "frames": count,
        "failures": failed,
    }


def _first_frames(press: Press) -> Press:
    """Return the beginning of a press, to compile and cache what the first steps need."""
    count = WARM_UP_FRAMES
    return Press(press.name, press.indenter, press.poses[:count], press.stamp_s[:count])


class _Errors:
    """Squared errors of the judged frames of several presses."""

    def __init__(self) -> None:
        self._skin_m: list[float] = []
        self._contact_m: list[float] = []
        self._predicted_n: list[float] = []
        self._measured_n: list[float] = []

    def add(self, press: Press, prediction: Prediction, indenter: Indenter, skin: SkinMesh) -> None:
        measured, force = press.skin_position_m, press.force_n
        if measured is None:
            raise ValueError(f"{press.name}: no skin was measured, so no error can be computed")
        for frame in judged_frames(press, skin).tolist():
            region = contact_region(measured[frame], press.poses[frame], indenter)
            predicted = prediction.skin_position_m[frame]
            skin_m, contact_m = surface_errors(measured[frame], predicted, region, skin)
            self._skin_m.append(skin_m)
            if region.any():
                self._contact_m.append(contact_m)
            if force is not None and prediction.force_n is not None:
                self._predicted_n.append(prediction.force_n[frame, 2])
                self._measured_n.append(force[frame, 2])

    def figures(self) -> dict[str, float | None]:
        predicted, measured = np.array(self._predicted_n), np.array(self._measured_n)
        return {
            "skin_rms_mm": _rms_mm(self._skin_m),
            "contact_rms_mm": _rms_mm(self._contact_m),
            "normal_force_error": relative_rms(predicted - measured, measured),
        }


def _rms_mm(values_m: Sequence[float]) -> float | None:
    return 1e3 * root_mean_square(values_m) if values_m else None
