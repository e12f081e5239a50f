# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A press on the dome, as the input of CalculiX."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dotsim_ros.data.scripted import Site
from dotsim_ros.gel.make import law_of
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.geometry.surface import indenter_surface
from dotsim_ros.specification import SensorSpecification
from studies.reference.axisymmetric import AxisymmetricSettings
from studies.reference.blocks import StepControl
from studies.reference.deck import Deck, near_part
from studies.reference.mesh import GROWTH, dome_mesh, pressed_place

START_GAP_M = 20e-6
"""Gap between skin and tip in the first frame, so that it is one without contact."""

SHEAR_STEP_M = 0.25e-3
"""The indenter is dragged at most this far in a frame."""


@dataclass(frozen=True)
class ReferenceSettings:
    """Resolution and effort of the reference.

    Attributes:
        spacing_m: size of the gel's elements where it is pressed; their nodes lie half as far
            apart.
        surface_step_m: length of the edges of the indenter's surface in contact. Its triangles
            are chords: on a sphere of 4 mm those of 0.2 mm lie at most 1.3 um inside.
        reach_m: the part of the indenter this close to the gel at rest can touch it.
        control: of the increments of moves along the indenter's axis.
        drag_control: of moves across it and of turns, where much of the contact begins to slip at
            once.
        drag_increment_m: the indenter moves at most so far across its axis, or turns so far at half
            the radius of the place, in an increment. CalculiX keeps for all of it the face that
            was opposite in its beginning: after a move by s the pressure of a ball of radius R
            leans by s / R against the way, as if there were so much more friction.
        growth: largest ratio of the sizes of two neighbouring elements.
    """

    spacing_m: float = 1.0e-3
    surface_step_m: float = 0.2e-3
    reach_m: float = 1.5e-3
    control: StepControl = field(default_factory=StepControl)
    drag_control: StepControl = field(
        default_factory=lambda: StepControl(first=0.1, smallest=1e-4, largest=0.5)
    )
    drag_increment_m: float = 50e-6
    growth: float = GROWTH

    def control_of(self, start: Pose, end: Pose, radius_m: float) -> StepControl:
        """Return the increments of a step between two poses, on a place of a radius."""
        move = end.position_m - start.position_m
        along = float(move @ end.rotation()[:, 2])
        turn = Rotation.from_matrix(end.rotation() @ start.rotation().T).magnitude()
        across = math.sqrt(max(0.0, float(move @ move) - along**2)) + 0.5 * radius_m * float(turn)
        control = self.drag_control if across > abs(along) else self.control
        largest = min(control.largest, self.drag_increment_m / max(across, 1e-12))
        return replace(control, first=min(control.first, largest), largest=largest)


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
        raise ValueError(f"the reference is for domes only, not for gel.shape {gel.shape!r}")
    place = pressed_place(skin.rest_position_m, indenter, poses)
    mesh = dome_mesh(
        core_radius_m=gel.core_radius_m,
        outer_radius_m=gel.outer_radius_m,
        press=place,
        spacing_m=settings.spacing_m,
        growth=settings.growth,
    )
    surface = indenter_surface(indenter, settings.surface_step_m)
    clearance = np.min(
        [np.linalg.norm(pose.apply(surface.vertices_m), axis=1) for pose in poses], axis=0
    )
    surface = near_part(surface, clearance < gel.outer_radius_m + settings.reach_m)
    controls = [settings.control_of(*way, place.radius_m) for way in pairwise(poses)]
    return Deck(
        mesh,
        surface,
        poses,
        law_of(specification.material),
        specification.contact,
        controls,
    )


@dataclass(frozen=True)
class ReferencePress:
    """A press, and a drag at its end.

    Attributes:
        specification: the sensor.
        indenter: the rigid shape.
        depth_m: of the tip below the skin at rest.
        frame_count: equal moves to that depth, one a frame.
        tilt_deg, azimuth_deg: the place, from the apex and about +z from +x.
        shear_m: how far the indenter is dragged along its own +x.
        settings: resolution and effort; those of an axisymmetric problem solve it in two
            dimensions.

    Raises:
        ValueError: a tilt or a drag in two dimensions.
    """

    specification: SensorSpecification
    indenter: Indenter
    depth_m: float
    frame_count: int
    tilt_deg: float = 0.0
    azimuth_deg: float = 0.0
    shear_m: float = 0.0
    settings: ReferenceSettings | AxisymmetricSettings = field(default_factory=ReferenceSettings)

    def __post_init__(self) -> None:
        is_aside = self.tilt_deg != 0.0 or self.shear_m != 0.0
        if is_aside and isinstance(self.settings, AxisymmetricSettings):
            raise ValueError(
                f"a tilt of {self.tilt_deg:g} degrees and a drag of {1e3 * self.shear_m:g} mm are "
                "not axisymmetric; solve it in three dimensions"
            )

    @property
    def name(self) -> str:
        """Name of its trajectory; what the name leaves out is in the notes."""
        friction = self.specification.contact.friction_coefficient
        return (
            f"{self.specification.name}_{self.indenter.name}_depth{1e3 * self.depth_m:g}"
            f"_tilt{self.tilt_deg:g}_shear{1e3 * self.shear_m:g}_friction{friction:g}"
            f"_spacing{1e3 * self.settings.spacing_m:g}"
            + ("_axisymmetric" if isinstance(self.settings, AxisymmetricSettings) else "")
        )

    def poses(self) -> list[Pose]:
        """Return the poses of the indenter's frame in the base frame."""
        site = Site(
            outer_radius_m=self.specification.gel.outer_radius_m,
            tilt_rad=math.radians(self.tilt_deg),
            azimuth_rad=math.radians(self.azimuth_deg),
        )
        return press_poses(
            site, depth_m=self.depth_m, frame_count=self.frame_count, shear_m=self.shear_m
        )

    def notes(self) -> dict[str, Any]:
        """Return what the trajectory depends on next to the indenter's shape, as plain values."""
        return {
            **notes_of(self.specification, self.settings),
            "press": {
                "depth_m": self.depth_m,
                "frame_count": self.frame_count,
                "tilt_deg": self.tilt_deg,
                "azimuth_deg": self.azimuth_deg,
                "shear_m": self.shear_m,
            },
        }


def notes_of(
    specification: SensorSpecification, settings: ReferenceSettings | AxisymmetricSettings
) -> dict[str, Any]:
    """Return what every trajectory of a sensor and settings depends on, as plain values."""
    s = specification
    sections = {"gel": s.gel, "material": s.material, "contact": s.contact}
    sensor = {"name": s.name} | {name: _plain(part) for name, part in sections.items()}
    return {"sensor": sensor, "settings": _plain(settings)}


def _plain(part: Any) -> dict[str, Any]:
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in asdict(part).items()
    }
