# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A data set: `dataset.yaml` and one bag a trajectory, with the sensor's skin and indenters."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.data.trajectory import (
    BASE_FRAME,
    MEASURED_TOPICS,
    Topics,
    Trajectory,
    read_trajectory,
)
from dotsim_ros.geometry.closed_mesh import MESH_SUFFIXES
from dotsim_ros.geometry.indenter import Indenter, is_definition, load_indenter
from dotsim_ros.geometry.skin_mesh import SkinMesh, skin_of_triangles
from dotsim_ros.io.documents import ArrayForm, read_arrays, read_yaml, value_text
from dotsim_ros.io.files import expanded
from dotsim_ros.io.printable import did_you_mean, placed
from dotsim_ros.specification import LARGEST_LENGTH_M

INDEX = "dataset.yaml"
SKIN_MESH = "skin_mesh.npz"
INDENTER_SUFFIXES = (*MESH_SUFFIXES, ".yaml")
"""Of the files of indenters, in the order in which they are looked for."""
SKIN_FORMS = {
    "rest_position_m": ArrayForm((None, 3)),
    "triangles": ArrayForm((None, 3), "whole number"),
    "on_base": ArrayForm((None,), "truth value"),
}
"""The arrays of a skin's file."""
SMALLEST_SKIN_M = 1e-3
LONGEST_NAME = 200
STANDARD_GRAVITY_M_S2 = 9.80665
WEIGHT_TOLERANCE = 0.005
"""Deviation of a weight, as a share, where the index does not say another: gravity differs by 0.3 %
between places, and a gauge by as much with how it is held."""


@dataclass(frozen=True)
class DataSetEntry:
    """One trajectory of a data set.

    Attributes:
        name: the bag's name.
        bag: its folder.
        indenter: name of the indenter, or its definition.
        frame_count: how many frames it says to hold.
        has_images: whether it says to hold images.
        base_frame: name of the sensor's base frame in its messages.
    """

    name: str
    bag: Path
    indenter: str
    frame_count: int
    has_images: bool
    base_frame: str = BASE_FRAME

    def read(self, *, topics: Topics = MEASURED_TOPICS) -> Trajectory:
        """Read the trajectory; see `read_trajectory`."""
        return read_trajectory(self.bag, topics=topics)


@dataclass(frozen=True)
class WeightEntry:
    """A recording of the force gauge under a known weight, with one deviation of it as a share."""

    name: str
    bag: Path
    known_force_n: float
    tolerance: float


@dataclass(frozen=True)
class DataSet:
    """What a data set's folder holds, in the order of its index; bags are read when asked."""

    directory: Path
    entries: tuple[DataSetEntry, ...]
    weights: tuple[WeightEntry, ...] = ()

    @property
    def has_skin_mesh(self) -> bool:
        """Whether the clouds of the bags list the vertices of a skin that is there."""
        return (self.directory / SKIN_MESH).is_file()

    def skin_mesh(self) -> SkinMesh:
        """Return the skin whose vertices the bags' clouds list.

        Raises:
            FileNotFoundError: the data set has no skin_mesh.npz.
            ValueError: it is no mesh.
        """
        path = self.directory / SKIN_MESH
        arrays = read_arrays(path, SKIN_FORMS)
        position, on_base = arrays["rest_position_m"], arrays["on_base"]
        if len(on_base) != len(position):
            raise ValueError(
                f"{path}: on_base says of {len(on_base)} vertices whether they are bonded, but "
                f"rest_position_m has {len(position)}; write both for the same skin"
            )
        largest = float(np.abs(position).max(initial=0.0))
        if not SMALLEST_SKIN_M <= largest <= LARGEST_LENGTH_M:
            raise ValueError(
                f"{path}: the skin reaches {largest:.4g} m from the middle of its base, expected "
                f"{SMALLEST_SKIN_M} to {LARGEST_LENGTH_M} m; if these are millimetres, multiply by "
                "0.001"
            )
        with placed(path):
            return replace(skin_of_triangles(position, arrays["triangles"]), on_base=on_base)

    def named(self, names: Sequence[str]) -> tuple[DataSetEntry, ...]:
        """Return the trajectories of some names, in their order.

        Raises:
            ValueError: no name, or one that the data set does not have.
        """
        by_name = {entry.name: entry for entry in self.entries}
        unknown = sorted(set(names) - set(by_name))
        if unknown:
            raise ValueError(
                f"{self.directory} has no trajectory {', '.join(unknown)}; it has "
                f"{', '.join(sorted(by_name))}"
            )
        if not names:
            raise ValueError("no trajectory was named, expected at least one")
        return tuple(by_name[name] for name in names)

    def filmed(self, names: Collection[str] = ()) -> tuple[DataSetEntry, ...]:
        """Return the trajectories with images, all or those of some names.

        Raises:
            ValueError: there is none, or none of a name.
        """
        entries = {entry.name: entry for entry in self.entries if entry.has_images}
        if not entries:
            raise ValueError(
                f"{self.directory} says that none of its trajectories holds images; record them "
                "with images, or set 'images: true' in its index"
            )
        unknown = sorted(set(names) - set(entries))
        if unknown:
            raise ValueError(
                f"{self.directory} has no trajectory with images named {', '.join(unknown)}"
            )
        return tuple(entry for name, entry in entries.items() if name in (names or entries))

    def idle_images(self) -> tuple[Path, ...]:
        """Return the files of the images without contact."""
        return tuple(sorted(self.directory.glob("idle_*.png")))

    def indenter_file(self, indenter: str, folder: str | Path | None = None) -> Path:
        """Return the file of an indenter: a mesh in metres, tip at the origin, +z off the gel, or a
        YAML file that describes one. Every command looks for indenters by this rule.

        Args:
            indenter: its name.
            folder: of the files, where alone it is looked for; None looks into the data set's own
                `indenters`, and then into those of the data sets next to it, by their names.

        Raises:
            FileNotFoundError: no such file; the text lists where it was looked for.
        """
        if folder is not None:
            places = [expanded(folder)]
        else:
            own = self.directory / "indenters"
            beside = sorted(self.directory.resolve().parent.glob("*/indenters"))
            places = [own, *(place for place in beside if place != own.resolve())]
        files = [place / f"{indenter}{suffix}" for place in places for suffix in INDENTER_SUFFIXES]
        found = next((file for file in files if file.is_file()), None)
        if found is not None:
            return found
        first, *others = places
        names = [path.stem for path in indenter_files(first)]
        known = ", ".join(names) or "no indenter"
        also = f", nor in {', '.join(map(str, others))}" if others else ""
        raise FileNotFoundError(
            f"no mesh {indenter}.stl{did_you_mean(indenter, names)} in {first}, which holds "
            f"{known}{also}; put it into {first}, "
            "or name the folder of the meshes (--indenters of calibrate, find-gap and plan-gap), "
            "or write what it is in place of its name, such as 'sphere(radius_m=0.004)'"
        )


def indenter_files(folder: Path) -> list[Path]:
    """Return the files of indenters in a folder, by name."""
    return sorted(path for path in folder.glob("*") if path.suffix in INDENTER_SUFFIXES)


def _bag(directory: Path, record: Any, place: str) -> Path:
    """Return the bag that a record of the index names, which is there."""
    if not isinstance(record, dict) or not isinstance(record.get("bag"), str):
        raise ValueError(
            f"{place}: expected a mapping with the key 'bag', got {value_text(record)}"
        )
    bag = directory / expanded(record["bag"])
    # A name of NUL characters, or of 5,000, is no path that can be asked for.
    with suppress(ValueError, OSError):
        if bag.exists():
            return bag
    raise FileNotFoundError(f"{place}: there is no bag {value_text(record['bag'])}")


def _entry(directory: Path, record: Any, base_frame: str, place: str) -> DataSetEntry:
    bag = _bag(directory, record, place)
    frames, indenter = record.get("frames", 0), record.get("indenter", "")
    if isinstance(frames, bool) or not isinstance(frames, int) or frames < 0:
        raise ValueError(f"{place}: frames must be a whole number, got {value_text(frames)}")
    is_name = isinstance(indenter, str) and Path(indenter).name == indenter
    if not is_name or not indenter.isprintable() or len(indenter) > LONGEST_NAME:
        raise ValueError(
            f"{place}: indenter is {value_text(indenter)}, expected the name of a mesh in "
            "indenters/, without .stl, or a definition such as 'sphere(radius_m=0.004)'"
        )
    has_images = bool(record.get("images", False))
    return DataSetEntry(bag.name, bag, indenter, frames, has_images, base_frame)


def _weight(directory: Path, record: Any, place: str) -> WeightEntry:
    bag = _bag(directory, record, place)
    given = [key for key in ("mass_kg", "known_force_n") if key in record]
    if len(given) != 1:
        raise ValueError(
            f"{place}: expected either 'mass_kg' or 'known_force_n', got "
            f"{' and '.join(given) or 'neither'}"
        )
    values = {given[0]: record[given[0]], "tolerance": record.get("tolerance", WEIGHT_TOLERANCE)}
    for key, value in values.items():
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not 0.0 < value < np.inf:
            raise ValueError(f"{place}: {key} is {value_text(value)}, expected a number above 0")
    known, tolerance = map(float, values.values())
    force_n = known * STANDARD_GRAVITY_M_S2 if given == ["mass_kg"] else known
    return WeightEntry(bag.name, bag, force_n, tolerance)


def read_data_set(directory: str | Path | DataSet) -> DataSet:
    """Read the index, dataset.yaml, of a data set's folder; bags are read when asked. A data set is
    returned as it is.

    Raises:
        FileNotFoundError: no index there, or a bag that it names is not.
        ValueError: the index is no YAML, or not of the documented form.
    """
    if isinstance(directory, DataSet):
        return directory
    directory = expanded(directory)
    index = directory / INDEX
    if not index.is_file():
        raise FileNotFoundError(f"{directory} is no data set: it holds no {INDEX}")
    content = read_yaml(index)
    records = content.get("trajectories") if isinstance(content, dict) else None
    if not isinstance(records, list) or not records:
        raise ValueError(f"{index}: expected a list under the key 'trajectories'")
    base_frame = content.get("base_frame", BASE_FRAME)
    if not isinstance(base_frame, str):
        raise ValueError(
            f"{index}: base_frame is {base_frame!r}, expected the name of the sensor's base frame "
            f"in the messages, such as {BASE_FRAME}"
        )
    entries = tuple(
        _entry(directory, record, base_frame, f"{index}, trajectory {number}")
        for number, record in enumerate(records)
    )
    names = [entry.name for entry in entries]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ValueError(
            f"{index}: two trajectories have the name {twice!r}, that of their bags' folders; give "
            "every bag its own"
        )
    weights = content.get("weights", [])
    if not isinstance(weights, list):
        raise ValueError(
            f"{index}: weights is {value_text(weights)}, expected a list of bags, each with its "
            "mass_kg"
        )
    known = tuple(
        _weight(directory, record, f"{index}, weight {number}")
        for number, record in enumerate(weights)
    )
    return DataSet(directory, entries, known)


def find_indenter(data_set: DataSet, name: str, indenters: str | Path | None = None) -> Indenter:
    """Return an indenter by its name, or by a definition in its place, as `load_indenter` takes it.

    Raises:
        FileNotFoundError: no file of this name; the text lists where it was looked for.
        ValueError: it is no closed mesh in metres, or no valid definition.
    """
    if is_definition(name):
        found = load_indenter(name, folder=indenters or data_set.directory / "indenters")
    else:
        found = load_indenter(data_set.indenter_file(name, indenters))
    return replace(found, name=name)
