"""A data set: `dataset.yaml` and one bag a trajectory, with the sensor's skin and indenters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dotsim_ros.geometry.indenter import Indenter, load_mesh
from dotsim_ros.geometry.skin_mesh import SkinMesh, skin_of_triangles
from dotsim_ros.measured.trajectory import MEASURED_TOPICS, Topics, Trajectory, read_trajectory

INDEX = "dataset.yaml"


@dataclass(frozen=True)
class DataSetEntry:
    """One trajectory of a data set.

    Attributes:
        name: the bag's name.
        bag: its folder.
        indenter: name of the indenter.
        frame_count: how many frames it says to hold.
        has_images: whether it says to hold images.
    """

    name: str
    bag: Path
    indenter: str
    frame_count: int
    has_images: bool

    def read(self, *, topics: Topics = MEASURED_TOPICS) -> Trajectory:
        """Read the trajectory; see `read_trajectory`."""
        return read_trajectory(self.bag, topics=topics)


@dataclass(frozen=True)
class DataSet:
    """What a data set's folder holds; bags are read when asked.

    Attributes:
        directory: the folder.
        entries: its trajectories, in the order of the index.
    """

    directory: Path
    entries: tuple[DataSetEntry, ...]

    @property
    def has_skin_mesh(self) -> bool:
        """Whether the clouds of the bags list the vertices of a skin that is there."""
        return (self.directory / "skin_mesh.npz").is_file()

    def skin_mesh(self) -> SkinMesh:
        """Return the skin whose vertices the bags' clouds list.

        Raises:
            FileNotFoundError: the data set has no skin_mesh.npz.
            ValueError: it is no mesh.
        """
        path = self.directory / "skin_mesh.npz"
        with np.load(path, allow_pickle=False) as arrays:
            missing = {"rest_position_m", "triangles", "on_base"} - set(arrays.files)
            if missing:
                raise ValueError(f"{path} has no array {', '.join(sorted(missing))}")
            mesh = skin_of_triangles(arrays["rest_position_m"], arrays["triangles"])
            return replace(mesh, on_base=arrays["on_base"].astype(bool))

    def idle_images(self) -> tuple[Path, ...]:
        """Return the files of the images without contact."""
        return tuple(sorted(self.directory.glob("idle_*.png")))

    def indenter_mesh(self, indenter: str) -> Path:
        """Return the mesh file of an indenter, in metres, tip at the origin, +z off the gel.

        Raises:
            FileNotFoundError: the data set holds no such mesh; the message lists those it holds.
        """
        path = self.directory / "indenters" / f"{indenter}.stl"
        if not path.is_file():
            known = sorted(mesh.stem for mesh in path.parent.glob("*.stl"))
            raise FileNotFoundError(
                f"no mesh {path}; the data set holds {', '.join(known) or 'no indenter'}"
            )
        return path


def _entry(directory: Path, index: int, record: Any) -> DataSetEntry:
    place = f"{directory / INDEX}, trajectory {index}"
    if not isinstance(record, dict) or not isinstance(record.get("bag"), str):
        raise ValueError(f"{place}: expected a mapping with the key 'bag', got {record!r}")
    bag = directory / record["bag"]
    if not bag.exists():
        raise FileNotFoundError(f"{place}: no bag at {bag}")
    frames = record.get("frames", 0)
    if not isinstance(frames, int) or frames < 0:
        raise ValueError(f"{place}: frames must be a whole number, got {frames!r}")
    return DataSetEntry(
        name=bag.name,
        bag=bag,
        indenter=str(record.get("indenter", "")),
        frame_count=frames,
        has_images=bool(record.get("images", False)),
    )


def read_data_set(directory: str | Path) -> DataSet:
    """Read the index of a data set.

    Args:
        directory: the folder that holds dataset.yaml.

    Raises:
        FileNotFoundError: no index there, or a bag that it names is not.
        ValueError: the index is no YAML, or not of the documented form.
    """
    directory = Path(directory)
    index = directory / INDEX
    if not index.is_file():
        raise FileNotFoundError(f"{directory} is no data set: it holds no {INDEX}")
    try:
        content = yaml.safe_load(index.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise ValueError(f"{index} is no YAML: {error}") from error
    records = content.get("trajectories") if isinstance(content, dict) else None
    if not isinstance(records, list) or not records:
        raise ValueError(f"{index}: expected a list under the key 'trajectories'")
    entries = tuple(_entry(directory, number, record) for number, record in enumerate(records))
    return DataSet(directory, entries)


def find_indenter(data_set: DataSet, name: str, indenters: str | Path | None) -> Indenter:
    """Return an indenter by its name.

    Args:
        data_set: that names it.
        name: of the indenter.
        indenters: folder of meshes; None looks in the data set, then in those beside it.

    Raises:
        FileNotFoundError: no mesh of this name; the text lists where it was looked for.
    """
    if indenters is not None:
        places = [Path(indenters)]
    else:
        beside = sorted(data_set.directory.resolve().parent.glob("*/indenters"))
        places = [data_set.directory / "indenters", *beside]
    for place in places:
        if (place / f"{name}.stl").is_file():
            return load_mesh(place / f"{name}.stl")
    raise FileNotFoundError(
        f"no mesh {name}.stl in {', '.join(map(str, places)) or 'any folder'}; name the folder of "
        "the indenters with --indenters"
    )
