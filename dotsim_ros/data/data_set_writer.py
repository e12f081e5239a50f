# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes data sets: `dataset.yaml`, a bag a trajectory, the skin, the indenters, idle images."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import yaml

from dotsim_ros.data.data_set import INDEX, SKIN_FORMS, DataSet, read_data_set
from dotsim_ros.data.trajectory import (
    CHANNELS,
    ImageChannel,
    PoseChannel,
    SkinChannel,
    Trajectory,
    WrenchChannel,
    write_trajectory,
)
from dotsim_ros.geometry.indenter import Indenter, load_mesh
from dotsim_ros.geometry.pose import Pose, Wrench
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.geometry.surface import indenter_surface
from dotsim_ros.io.arrays import FloatArray, ImageArray
from dotsim_ros.io.documents import read_arrays, read_yaml
from dotsim_ros.io.files import whole_file, write_image, write_text
from dotsim_ros.io.replacement import keep

STEP_M = 0.2e-3
"""Usual length of the edges in an indenter's written mesh: 1.3 um off a ball of 4 mm radius."""
SAME_SHAPE_M = 20e-6
"""Vertices of an indenter's written mesh lie closer to its surface."""


class RecordedFrame(Protocol):
    """What a recording takes of a frame of the sensor."""

    @property
    def time_s(self) -> float:
        """Simulated time since the last reset."""

    @property
    def indenter_pose(self) -> Pose | None:
        """In the base frame; None where no indenter is near."""

    @property
    def wrench(self) -> Wrench:
        """Of the gel on the indenter, base frame."""

    @property
    def skin_position_m(self) -> FloatArray:
        """(V, 3) of the skin, base frame."""

    @property
    def image(self) -> ImageArray:
        """(H, W, 3) red, green, blue."""


def trajectory_of_frames(
    frames: Sequence[RecordedFrame], *, name: str, channels: Sequence[str] = tuple(CHANNELS)
) -> Trajectory:
    """Return the trajectory that frames of the sensor, from the first one after a reset on, make.

    Raises:
        ValueError: no frame, a frame without an indenter, times that do not increase, or an
            unknown channel.
    """
    unknown = sorted(set(channels) - set(CHANNELS))
    if unknown or not channels:
        raise ValueError(
            f"{name}: channels are {', '.join(channels) or 'none'}, expected of "
            f"{', '.join(CHANNELS)}"
        )
    poses = [frame.indenter_pose for frame in frames]
    pressed = [pose for pose in poses if pose is not None]
    if not pressed or len(pressed) < len(poses):
        raise ValueError(
            f"{name}: {len(pressed)} of {len(poses)} frames have an indenter, expected all and at "
            "least one; press with a pose in every frame that is recorded"
        )
    stamp_ns = np.array([round(1e9 * frame.time_s) for frame in frames], dtype=np.int64)
    made: dict[str, Any] = {
        "pose": lambda: PoseChannel.of(stamp_ns, pressed),
        "wrench": lambda: WrenchChannel(
            stamp_ns,
            np.stack([frame.wrench.force_n for frame in frames]),
            np.stack([frame.wrench.torque_nm for frame in frames]),
        ),
        "skin": lambda: SkinChannel(
            stamp_ns, np.stack([frame.skin_position_m for frame in frames]).astype(np.float32)
        ),
        "image": lambda: ImageChannel(stamp_ns, np.stack([frame.image for frame in frames])),
    }
    return Trajectory(**{channel: made[channel]() for channel in channels}, name=name)


class DataSetWriter:
    """A data set that grows by one trajectory at a time.

    Args:
        directory: its folder; a data set that is there already is continued.
        skin: whose vertices the trajectories' clouds list; None where there are no clouds, or
            where they list no vertices.
        indenter_step_m: length of the edges in the meshes of indenters that are none; with small
            ones whoever reads the data set waits longer.

    Raises:
        ValueError: the data set there has another skin.
    """

    def __init__(
        self,
        directory: str | Path,
        skin: SkinMesh | None = None,
        *,
        indenter_step_m: float = STEP_M,
    ) -> None:
        self.directory = Path(directory)
        self._indenter_step_m = indenter_step_m
        self._vertex_count = None if skin is None else skin.vertex_count
        self._shapes: dict[str, tuple[Any, ...]] = {}
        self.directory.mkdir(parents=True, exist_ok=True)
        if skin is not None:
            self._write_skin(skin)

    def bag(self, name: str) -> Path:
        """Return where the trajectory of a name lies or will lie."""
        return self.directory / "bags" / name

    def notes(self, name: str) -> Mapping[str, Any] | None:
        """Return what the index says of the trajectory of a name; None where it lists none."""
        return self._records().get(name)

    def holds(self, name: str, notes: Mapping[str, Any]) -> bool:
        """Return whether the trajectory is there, whole, with the same notes."""
        record = self._records().get(name)
        if record is None or record.get("failure") or not self.bag(name).is_dir():
            return False
        return all(record.get(key) == value for key, value in notes.items())

    def add(
        self,
        trajectory: Trajectory,
        indenter: Indenter,
        notes: Mapping[str, Any] | None = None,
        *,
        failure: str = "",
    ) -> None:
        """Write a trajectory, its indenter's mesh and its entry in the index; one of the same name
        is replaced when the new one is whole. A bag of this name that the index does not list is
        kept as `NAME.kept`.

        Args:
            trajectory, indenter: their names become those of the files.
            notes: entered into the index next to what a data set needs.
            failure: why frames are missing; such a trajectory does not count as held.

        Raises:
            ValueError: a name that no file can have, a skin of another number of vertices, or
                another indenter of the same name in the data set; nothing was written.
        """
        self._check(trajectory, indenter)
        self._write_indenter(indenter)
        name = trajectory.name
        records = self._records()
        bags = self.bag(name).parent
        bags.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".part.", dir=bags) as folder:
            part = Path(folder) / name
            write_trajectory(part, trajectory)
            if records.pop(name, None) is not None:
                self._write_index(records)
                shutil.rmtree(self.bag(name), ignore_errors=True)
            if os.path.lexists(self.bag(name)):
                keep(self.bag(name))
            os.replace(part, self.bag(name))
        records[name] = {
            "bag": f"bags/{name}",
            "indenter": indenter.name,
            "frames": 0 if trajectory.pose is None else len(trajectory.pose.stamp_ns),
            "images": trajectory.image is not None,
            **(notes or {}),
            **({"failure": failure} if failure else {}),
        }
        self._write_index(records)

    def add_idle_image(self, image: ImageArray) -> Path:
        """Write an image (H, W, 3), red, green, blue, without contact; return its file."""
        path = self.directory / f"idle_{len(list(self.directory.glob('idle_*.png')))}.png"
        write_image(path, image)
        return path

    def _check(self, trajectory: Trajectory, indenter: Indenter) -> None:
        for what, name in (("trajectory", trajectory.name), ("indenter", indenter.name)):
            if not name or Path(name).name != name or name.startswith("."):
                raise ValueError(
                    f"the {what} has the name {name!r}, expected one that a file can have: it "
                    "becomes that of its file"
                )
        skin, count = trajectory.skin, self._vertex_count
        if skin is not None and count is not None and skin.position_m.shape[1] != count:
            raise ValueError(
                f"{trajectory.name}: the skin has {skin.position_m.shape[1]} points, that of the "
                f"data set {count} vertices; give the skin that the points are of"
            )

    def _write_skin(self, skin: SkinMesh) -> None:
        path = self.directory / "skin_mesh.npz"
        if path.is_file():
            there = read_arrays(path, SKIN_FORMS)["rest_position_m"]
            if there.shape != skin.rest_position_m.shape or not np.allclose(
                there, skin.rest_position_m, rtol=0.0, atol=1e-9
            ):
                raise ValueError(f"{path} holds another skin; give another folder")
            return
        with whole_file(path) as part:
            np.savez_compressed(
                part,
                rest_position_m=skin.rest_position_m,
                triangles=skin.triangles,
                on_base=skin.on_base,
            )

    def _records(self) -> dict[str, dict[str, Any]]:
        """Return the index's entries by the names of their bags."""
        return {Path(r["bag"]).name: r for r in self._index().get("trajectories", [])}

    def _index(self) -> dict[str, Any]:
        index = self.directory / INDEX
        return read_yaml(index) if index.is_file() else {}

    def _write_index(self, records: Mapping[str, Mapping[str, Any]]) -> None:
        # What else the owner of the data set wrote there stays.
        content = self._index() | {"trajectories": list(records.values())}
        write_text(self.directory / INDEX, yaml.safe_dump(content, sort_keys=False))

    def _write_indenter(self, indenter: Indenter) -> None:
        """Write an indenter's mesh, unless it is there.

        Raises:
            ValueError: the mesh that is there is of another shape.
        """
        mount = indenter.mount.position_m.tobytes() + indenter.mount.quaternion_xyzw.tobytes()
        shape = (indenter.kind, indenter.parameters, mount, indenter.mesh)
        if self._shapes.get(indenter.name) == shape:
            return
        path = self.directory / "indenters" / f"{indenter.name}.stl"
        if path.is_file():
            there = load_mesh(path).mesh
            assert there is not None
            if np.abs(indenter.signed_distance(there.vertices_m)).max() > SAME_SHAPE_M:
                raise ValueError(
                    f"{path} holds another indenter of this name; give each its own name"
                )
        else:
            import trimesh  # half a second

            surface = indenter_surface(indenter, self._indenter_step_m)
            mesh = trimesh.Trimesh(surface.vertices_m, surface.triangles, process=False)
            with whole_file(path) as part:
                mesh.export(part)
        self._shapes[indenter.name] = shape


def write_data_set(
    directory: str | Path,
    presses: Iterable[tuple[Trajectory, Indenter]],
    *,
    skin: SkinMesh | None = None,
    idle_images: Iterable[ImageArray] = (),
    indenter_step_m: float = STEP_M,
) -> DataSet:
    """Write a data set, whole or not at all, and return it; `DataSetWriter` writes one that grows.

    Args:
        directory: its folder, which must not exist.
        presses: each trajectory with its indenter; their names become those of the files.
        skin: whose vertices the trajectories' clouds list, such as a sensor's own; None where there
            are no clouds, or where they list no vertices.
        idle_images: (H, W, 3) uint8 each, red, green, blue, of the sensor without contact.
        indenter_step_m: as for `DataSetWriter`.

    Raises:
        FileExistsError: there is something at `directory`.
        ValueError: no trajectory, one name twice, or as `DataSetWriter.add`.
    """
    directory = Path(directory)
    if directory.exists():
        raise FileExistsError(f"{directory} exists; name a folder that does not")
    directory.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{directory.name}.", dir=directory.parent) as folder:
        part = Path(folder) / directory.name
        writer = DataSetWriter(part, skin, indenter_step_m=indenter_step_m)
        names: set[str] = set()
        for trajectory, indenter in presses:
            if trajectory.name in names:
                raise ValueError(f"two trajectories are named {trajectory.name!r}; rename one")
            names.add(trajectory.name)
            writer.add(trajectory, indenter)
        if not names:
            raise ValueError(f"no trajectory to write to {directory}")
        for image in idle_images:
            writer.add_idle_image(image)
        os.replace(part, directory)
    return read_data_set(directory)
