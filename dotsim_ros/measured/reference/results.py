"""Presses of a sensor solved by CalculiX, as the trajectories of a data set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.geometry.specification import SensorSpecification
from dotsim_ros.measured.data_set import INDEX
from dotsim_ros.measured.reference.deck import Deck, StepControl, near_part
from dotsim_ros.measured.reference.mesh import dome_mesh, interpolate_skin, pressed_place
from dotsim_ros.measured.reference.run import Solution
from dotsim_ros.measured.reference.surface import indenter_surface
from dotsim_ros.measured.scripted import Site
from dotsim_ros.measured.trajectory import (
    PoseChannel,
    SkinChannel,
    Trajectory,
    WrenchChannel,
    write_trajectory,
)
from dotsim_ros.sensor import law_of

FloatArray = NDArray[np.float64]

START_GAP_M = 20e-6
"""Between skin and tip in the first frame, so that it is one without contact."""

SHEAR_STEP_M = 0.25e-3
"""The indenter is dragged at most this far in a frame."""

SPEED_M_S = 0.005
FIRST_STAMP_NS = 1_000_000_000
FINE_STEP_M = 50e-6
"""Length of the edges in the indenter's written mesh."""


@dataclass(frozen=True)
class ReferenceSettings:
    """Resolution and effort of the reference.

    Attributes:
        spacing_m: size of the gel's elements where it is pressed; their nodes lie half as far
            apart.
        surface_step_m: length of the edges of the indenter's surface in contact.
        reach_m: the part of the indenter this close to the gel at rest can touch it.
        control: of the increments.
    """

    spacing_m: float = 1.0e-3
    surface_step_m: float = 0.4e-3
    reach_m: float = 1.5e-3
    control: StepControl = field(default_factory=StepControl)


def press_poses(
    site: Site, *, depth_m: float, frame_count: int, shear_m: float = 0.0
) -> list[Pose]:
    """Return poses without contact, of a press along the skin's normal, and of a drag at its end.

    Args:
        site: where.
        depth_m: of the tip below the skin at rest, reached after `frame_count` equal moves.
        frame_count: at least 1.
        shear_m: how far the indenter then moves along its own +x, in moves of at most 0.25 mm.

    Raises:
        ValueError: a depth or count that is not positive.
    """
    if not (depth_m > 0.0 and frame_count >= 1):
        raise ValueError(
            f"a press of {depth_m} m in {frame_count} frames: expected a positive depth and at "
            "least 1 frame"
        )
    poses = [site.pose(-START_GAP_M)]
    poses += [site.pose(depth_m * k / frame_count) for k in range(1, frame_count + 1)]
    count = int(np.ceil(abs(shear_m) / SHEAR_STEP_M - 1e-9))
    pressed = poses[-1]
    sideways = pressed.rotation()[:, 0]
    poses += [
        Pose(pressed.position_m + shear_m * k / count * sideways, pressed.quaternion_xyzw)
        for k in range(1, count + 1)
    ]
    return poses


def reference_deck(
    specification: SensorSpecification,
    skin: SkinMesh,
    indenter: Indenter,
    poses: Sequence[Pose],
    settings: ReferenceSettings,
) -> Deck:
    """Return what CalculiX is to compute.

    Args:
        specification: the sensor: shape, law, friction.
        skin: at rest.
        indenter: the rigid shape.
        poses: of its frame in the base frame; the first without contact.
        settings: resolution and effort.

    Raises:
        ValueError: the gel is no dome around a core, or is not touched.
    """
    gel = specification.gel
    if gel.shape != "dome":
        raise ValueError(f"the reference knows domes alone, not gel.shape {gel.shape!r}")
    place = pressed_place(skin.rest_position_m, indenter, poses)
    mesh = dome_mesh(
        core_radius_m=gel.core_radius_m,
        outer_radius_m=gel.outer_radius_m,
        press=place,
        spacing_m=settings.spacing_m,
    )
    surface = indenter_surface(indenter, settings.surface_step_m)
    clearance = np.min(
        [np.linalg.norm(pose.apply(surface.vertices_m), axis=1) for pose in poses], axis=0
    )
    surface = near_part(surface, clearance < gel.outer_radius_m + settings.reach_m)
    return Deck(
        mesh,
        surface,
        poses,
        law_of(specification.material),
        specification.contact,
        settings.control,
    )


def stamps_ns(poses: Sequence[Pose]) -> NDArray[np.int64]:
    """Return (F,) stamps of poses that follow each other at 5 mm/s, from 1 s."""
    position = np.array([pose.position_m for pose in poses])
    moved = np.linalg.norm(np.diff(position, axis=0), axis=1)
    time = np.concatenate([[0.0], np.cumsum(moved)]) / SPEED_M_S
    return FIRST_STAMP_NS + np.round(1e9 * time).astype(np.int64)


def trajectory_of(deck: Deck, solution: Solution, skin: SkinMesh, *, name: str) -> Trajectory:
    """Return the solved frames, the first one without contact included."""
    poses = deck.poses[: len(solution.steps) + 1]
    stamp_ns = stamps_ns(poses)
    at = interpolate_skin(deck.gel, skin.rest_position_m)
    rest = skin.rest_position_m
    position = [rest] + [rest + at.of(step.displacement_m) for step in solution.steps]
    nothing = np.zeros(3)
    return Trajectory(
        pose=PoseChannel(
            stamp_ns,
            np.array([pose.position_m for pose in poses]),
            np.array([pose.quaternion_xyzw for pose in poses]),
        ),
        wrench=WrenchChannel(
            stamp_ns,
            np.array([nothing, *(step.force_n for step in solution.steps)]),
            np.array([nothing, *(step.torque_nm for step in solution.steps)]),
        ),
        skin=SkinChannel(stamp_ns, np.array(position, dtype=np.float32)),
        name=name,
    )


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
            np.savez_compressed(
                path,
                rest_position_m=skin.rest_position_m,
                triangles=skin.triangles,
                on_base=skin.on_base,
            )

    def bag(self, name: str) -> Path:
        """Return where the trajectory of a name lies or will lie."""
        return self.directory / "bags" / name

    def add(self, trajectory: Trajectory, indenter: Indenter, notes: Mapping[str, Any]) -> None:
        """Write a trajectory, its indenter's mesh and its entry in the index.

        Args:
            trajectory: its name becomes the bag's.
            indenter: its name becomes the mesh's.
            notes: entered into the index beside what a data set needs.

        Raises:
            FileExistsError: there is such a bag.
        """
        self._write_indenter(indenter)
        write_trajectory(self.bag(trajectory.name), trajectory)
        index = self.directory / INDEX
        content = yaml.safe_load(index.read_text(encoding="utf-8")) if index.is_file() else {}
        frame_count = 0 if trajectory.pose is None else len(trajectory.pose.stamp_ns)
        entry = {
            "bag": f"bags/{trajectory.name}",
            "indenter": indenter.name,
            "frames": frame_count,
            "images": False,
            **notes,
        }
        records = [*content.get("trajectories", []), entry]
        temporary = index.with_name(f".{INDEX}.part")
        temporary.write_text(
            yaml.safe_dump({"trajectories": records}, sort_keys=False), encoding="utf-8"
        )
        temporary.replace(index)

    def _write_indenter(self, indenter: Indenter) -> None:
        import trimesh  # half a second

        path = self.directory / "indenters" / f"{indenter.name}.stl"
        if path.is_file():
            return
        path.parent.mkdir(exist_ok=True)
        surface = indenter_surface(indenter, FINE_STEP_M)
        trimesh.Trimesh(surface.vertices_m, surface.triangles, process=False).export(path)


def settings_notes(settings: ReferenceSettings) -> dict[str, Any]:
    """Return the settings as plain values for the index."""
    return asdict(settings)
