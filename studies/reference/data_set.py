# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The presses of a data set that `python -m studies reference_presses` wrote, each with what it was
solved for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dotsim_ros.data.data_set import INDEX, find_indenter, read_data_set
from dotsim_ros.data.trajectory import Trajectory, read_trajectory
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.documents import read_yaml
from dotsim_ros.specification import SensorSpecification, sensor_from

FINE_STEP_M = 50e-6
"""Length of the edges in an indenter's mesh, so that it is none of what two solvers differ by."""


@dataclass(frozen=True)
class SolvedPress:
    """A trajectory with what it was solved for.

    Attributes:
        specification: the sensor: name, gel, material and contact.
        indenter: of the mesh that the data set holds.
        trajectory: its frames; fewer than asked for where CalculiX stopped.
        notes: of the index.
    """

    specification: SensorSpecification
    indenter: Indenter
    trajectory: Trajectory
    notes: Mapping[str, Any]


def read_solved_presses(directory: Path) -> tuple[SkinMesh, list[SolvedPress]]:
    """Return skin and presses of a data set that `python -m studies reference_presses` wrote.

    Raises:
        FileNotFoundError: there is no data set.
        ValueError: an entry does not state what it was solved for, so it is not a reference's.
    """
    data_set = read_data_set(directory)
    content = read_yaml(directory / INDEX)
    indenters: dict[str, Indenter] = {}
    presses = []
    for entry, record in zip(data_set.entries, content["trajectories"], strict=True):
        if "sensor" not in record:
            raise ValueError(
                f"{directory / INDEX}: {entry.name} names no sensor that it was solved for; "
                "expected a data set that python -m studies reference_presses wrote"
            )
        sensor = sensor_from(record["sensor"], f"{directory / INDEX}, {entry.name}")
        if entry.indenter not in indenters:
            indenters[entry.indenter] = find_indenter(data_set, entry.indenter)
        # A spacing's decimal point in the name is no suffix.
        trajectory = replace(read_trajectory(entry.bag), name=entry.name)
        presses.append(SolvedPress(sensor, indenters[entry.indenter], trajectory, record))
    return data_set.skin_mesh(), presses
