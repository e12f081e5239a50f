"""The data set of solved presses: it grows by one trajectory at a time, and can be resumed."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dotsim_ros.files import whole_file, write_text
from dotsim_ros.geometry.indenter import Indenter, load_indenter
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.measured.data_set import INDEX, read_data_set
from dotsim_ros.measured.trajectory import Trajectory, read_trajectory, write_trajectory
from dotsim_ros.reference.surface import indenter_surface
from dotsim_ros.specification import SensorSpecification, sensor_from

FINE_STEP_M = 50e-6
"""Length of the edges in the indenter's written mesh."""


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


class ReferenceDataSet:
    """A data set that grows by one trajectory at a time.

    Args:
        directory: where; a data set that is there already is continued.
        skin: whose vertices the trajectories list.

    Raises:
        ValueError: the data set there has another skin.
    """

    def __init__(self, directory: Path, skin: SkinMesh) -> None:
        self.directory = directory
        directory.mkdir(parents=True, exist_ok=True)
        path = directory / "skin_mesh.npz"
        if path.is_file():
            with np.load(path, allow_pickle=False) as arrays:
                there = arrays["rest_position_m"]
            if there.shape != skin.rest_position_m.shape or not np.allclose(
                there, skin.rest_position_m, rtol=0.0, atol=1e-9
            ):
                raise ValueError(f"{path} holds another skin; give another folder")
        else:
            with whole_file(path) as part:
                np.savez_compressed(
                    part,
                    rest_position_m=skin.rest_position_m,
                    triangles=skin.triangles,
                    on_base=skin.on_base,
                )

    def bag(self, name: str) -> Path:
        """Return where the trajectory of a name lies or will lie."""
        return self.directory / "bags" / name

    def holds(self, name: str, notes: Mapping[str, Any]) -> bool:
        """Return whether the trajectory is there, solved to its end, with the same notes."""
        record = self._records().get(name)
        if record is None or record.get("failure") or not self.bag(name).is_dir():
            return False
        return all(record.get(key) == value for key, value in notes.items())

    def add(
        self,
        trajectory: Trajectory,
        indenter: Indenter,
        notes: Mapping[str, Any],
        *,
        failure: str = "",
    ) -> None:
        """Write a trajectory, its indenter's mesh and its entry in the index; one of the same name
        is replaced.

        Args:
            trajectory: its name becomes the bag's.
            indenter: its name becomes the mesh's.
            notes: entered into the index beside what a data set needs.
            failure: why frames are missing; such a trajectory does not count as held.
        """
        self._write_indenter(indenter)
        name = trajectory.name
        records = self._records()
        if records.pop(name, None) is not None:
            self._write_index(records)
        shutil.rmtree(self.bag(name), ignore_errors=True)
        write_trajectory(self.bag(name), trajectory)
        records[name] = {
            "bag": f"bags/{name}",
            "indenter": indenter.name,
            "frames": 0 if trajectory.pose is None else len(trajectory.pose.stamp_ns),
            "images": False,
            **notes,
            **({"failure": failure} if failure else {}),
        }
        self._write_index(records)

    def _records(self) -> dict[str, dict[str, Any]]:
        """Return the index's entries by the names of their bags."""
        index = self.directory / INDEX
        content = yaml.safe_load(index.read_text(encoding="utf-8")) if index.is_file() else {}
        return {Path(record["bag"]).name: record for record in content.get("trajectories", [])}

    def _write_index(self, records: Mapping[str, Mapping[str, Any]]) -> None:
        index = self.directory / INDEX
        content = {"trajectories": list(records.values())}
        write_text(index, yaml.safe_dump(content, sort_keys=False))

    def _write_indenter(self, indenter: Indenter) -> None:
        import trimesh  # half a second

        path = self.directory / "indenters" / f"{indenter.name}.stl"
        if path.is_file():
            return
        surface = indenter_surface(indenter, FINE_STEP_M)
        mesh = trimesh.Trimesh(surface.vertices_m, surface.triangles, process=False)
        with whole_file(path) as part:
            mesh.export(part)


def read_solved_presses(directory: Path) -> tuple[SkinMesh, list[SolvedPress]]:
    """Return the skin and the presses of a data set that `dotsim_ros reference` wrote.

    Raises:
        FileNotFoundError: there is no data set.
        ValueError: an entry does not state what it was solved for, so it is not a reference's.
    """
    data_set = read_data_set(directory)
    content = yaml.safe_load((directory / INDEX).read_text(encoding="utf-8"))
    indenters: dict[str, Indenter] = {}
    presses = []
    for entry, record in zip(data_set.entries, content["trajectories"], strict=True):
        if "sensor" not in record:
            raise ValueError(
                f"{directory / INDEX}: {entry.name} names no sensor that it was solved for; "
                "expected a data set that dotsim_ros reference wrote"
            )
        sensor = sensor_from(record["sensor"], f"{directory / INDEX}, {entry.name}")
        if entry.indenter not in indenters:
            indenters[entry.indenter] = load_indenter(data_set.indenter_mesh(entry.indenter))
        # A spacing's decimal point in the name is no suffix.
        trajectory = replace(read_trajectory(entry.bag), name=entry.name)
        presses.append(SolvedPress(sensor, indenters[entry.indenter], trajectory, record))
    return data_set.skin_mesh(), presses
