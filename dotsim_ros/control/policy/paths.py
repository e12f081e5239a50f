# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reference paths of a ball on a sensor, as it feels them: closed, and free of crossings.

A path is where the indenter is in the sensor's frame, its axes held parallel to the sensor's. It is
drawn in the direction of the contact on the dome and the depth of the indentation. No two parts of
a path come close in both, so touch alone identifies where on it the indenter is and which way it
goes.

On a pad, a place of the face stands for a direction of the contact on the dome.

Depth is nominal: how far the undeformed gel and the ball overlap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from scipy.spatial import cKDTree

from dotsim_ros.geometry.pad_face import face_normal
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.specification import GelSpecification, face_drop_m

SPEED_M_S = 0.005
"""Speed on straight parts of a path."""
TURN_RATE_RAD_S = 3.0
"""The most that the direction of travel turns by: in narrow bends a path is followed slowly, since
what is commanded takes effect a tenth of a second after what was seen."""
SMALLEST_SPEED_M_S = 0.001
SAMPLE_COUNT = 1200
SMOOTHING_M = 0.3e-3
"""Length over which a path's speed is smoothed."""
TRAVEL_RADIUS_M = 0.0184
"""Radius at which the ball's centre travels, m: turns lengths into tilts."""
FARTHEST_TILT_RAD, DEEPEST_M = 0.4, 2.1e-3
"""No path goes farther from the apex, or deeper."""
DEEPEST_SHARE = 0.3
"""Of a pad's thickness; a dome of 15.75 mm is pressed to 0.22 of its gel's."""


@dataclass(frozen=True)
class DomeContact:
    """A ball on a dome whose centre is the origin of the sensor's frame; the ball's frame has its
    origin at its lowest point."""

    dome_radius_m: float = 0.01575
    ball_radius_m: float = 0.004

    def position_m(self, tilt_rad: ArrayLike, depth_m: ArrayLike) -> FloatArray:
        """Return where the indenter's frame is, (..., 3) in the sensor's frame.

        Args:
            tilt_rad: (..., 2) angle of the contact from the apex, towards +x and +y.
            depth_m: (...) nominal depth, negative before contact.
        """
        tilt = np.asarray(tilt_rad, dtype=np.float64)
        depth = np.asarray(depth_m, dtype=np.float64)[..., None]
        angle = np.linalg.norm(tilt, axis=-1, keepdims=True)
        # np.sinc(x) is sin(pi x) / (pi x), finite at 0.
        direction = np.concatenate([np.sinc(angle / np.pi) * tilt, np.cos(angle)], axis=-1)
        centre = (self.dome_radius_m + self.ball_radius_m - depth) * direction
        return centre - np.array([0.0, 0.0, self.ball_radius_m])

    def tilt_and_depth(self, position_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return tilt (..., 2) in rad and depth (...) in m of positions (..., 3)."""
        centre = np.asarray(position_m, dtype=np.float64) + np.array([0.0, 0.0, self.ball_radius_m])
        distance = np.linalg.norm(centre, axis=-1)
        sideways = np.linalg.norm(centre[..., :2], axis=-1)
        angle = np.arctan2(sideways, centre[..., 2])
        scale = np.where(sideways > 0.0, angle / np.where(sideways > 0.0, sideways, 1.0), 0.0)
        depth = self.dome_radius_m + self.ball_radius_m - distance
        return centre[..., :2] * scale[..., None], depth


@dataclass(frozen=True)
class PadContact:
    """A ball that touches a pad: as on the dome, with lengths and depths that the pad has room for.

    Raises:
        ValueError: the ball is too large for the pad.
    """

    size_m: tuple[float, float, float]
    curvature_per_m: tuple[float, float] = (0.0, 0.0)
    ball_radius_m: float = 0.004

    def __post_init__(self) -> None:
        if self.lever_m <= 0.0:
            raise ValueError(
                f"a ball of {self.ball_radius_m:g} m radius is too large for a pad of "
                f"{self.size_m[0]:g} x {self.size_m[1]:g} m, expected a pad that is wider than it"
            )

    @property
    def lever_m(self) -> float:
        """Distance from the middle of the face that stands for a tilt of 1 rad: as on the dome, or
        less where the ball would reach beyond the pad on a path."""
        room_m = 0.5 * min(self.size_m[:2]) - self.ball_radius_m
        return min(TRAVEL_RADIUS_M, room_m / FARTHEST_TILT_RAD)

    @property
    def depth_share(self) -> float:
        """By what a depth is multiplied: 1, or less where a path would press a thin gel deeper than
        `DEEPEST_SHARE` of its thickness."""
        return min(1.0, DEEPEST_SHARE * self.size_m[2] / DEEPEST_M)

    def position_m(self, tilt_rad: ArrayLike, depth_m: ArrayLike) -> FloatArray:
        """Return where the indenter's frame is, (..., 3) in the sensor's frame, for a tilt
        (..., 2) and a depth (...) on a dome, for which a place of the face stands."""
        place = self.lever_m * np.asarray(tilt_rad, dtype=np.float64)
        x, y = place[..., 0], place[..., 1]
        z = self.size_m[2] - face_drop_m(x, y, self.curvature_per_m)
        depth = np.asarray(depth_m, dtype=np.float64)
        depth = np.where(depth > 0.0, self.depth_share, 1.0) * depth
        outward = (self.ball_radius_m - depth)[..., None] * face_normal(x, y, self.curvature_per_m)
        return np.stack([x, y, z - self.ball_radius_m], axis=-1) + outward


def contact_with(gel: GelSpecification, ball_radius_m: float) -> DomeContact | PadContact:
    """Return how a ball touches a gel, dome or pad.

    Raises:
        ValueError: as `PadContact`.
    """
    if gel.shape == "dome":
        return DomeContact(gel.outer_radius_m, ball_radius_m)
    return PadContact(gel.pad_size_m, gel.face_curvature_per_m, ball_radius_m)


@dataclass(frozen=True, eq=False)
class ReferencePath:
    """A closed curve with the speed at which it is followed: places (N, 3) of the indenter in the
    sensor's frame, equally far apart, with unit directions of travel (N, 3) and speeds (N,)."""

    name: str
    position_m: FloatArray
    tangent: FloatArray
    speed_m_s: FloatArray
    spacing_m: float
    tree: cKDTree

    @property
    def length_m(self) -> float:
        """Length of one lap."""
        return self.spacing_m * len(self.position_m)

    @property
    def lap_s(self) -> float:
        """Time of one lap."""
        return float(np.sum(self.spacing_m / self.speed_m_s))

    def nearest(self, position_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the distance (...) from places (..., 3) to the curve, and how far along it (...)
        the nearest point is, both in metres."""
        position = np.asarray(position_m, dtype=np.float64)
        _, index = self.tree.query(position)
        offset = position - self.position_m[index]
        along = np.sum(offset * self.tangent[index], axis=-1)
        along = np.clip(along, -0.5 * self.spacing_m, 0.5 * self.spacing_m)
        across = offset - along[..., None] * self.tangent[index]
        arc = (index * self.spacing_m + along) % self.length_m
        return np.linalg.norm(across, axis=-1), np.asarray(arc, dtype=np.float64)

    def at(self, arc_m: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return place (..., 3), direction of travel (..., 3) and speed (...) so far along it."""
        arc = np.asarray(arc_m, dtype=np.float64) / self.spacing_m
        index = np.rint(arc).astype(np.int64)
        along = (arc - index) * self.spacing_m
        index %= len(self.position_m)
        tangent = self.tangent[index]
        return self.position_m[index] + along[..., None] * tangent, tangent, self.speed_m_s[index]

    def laps(self, position_m: FloatArray) -> float:
        """Return how many laps a motion (F, 3) has made, along the direction of travel.

        Consecutive places must be less than half a lap apart.
        """
        _, arc = self.nearest(position_m)
        step = np.diff(arc) / self.length_m
        return float(np.sum(step - np.rint(step)))


def _stadium(phase: FloatArray, half_length: float, radius: float) -> FloatArray:
    """Return (N, 2) a closed curve at phases from 0 to 1: out along -radius, back along +radius."""
    straight, bend = 2.0 * half_length, np.pi * radius
    arc = phase * 2.0 * (straight + bend)
    curve = np.empty((len(phase), 2))
    out = arc < straight
    curve[out] = np.stack([arc[out] - half_length, np.full(out.sum(), -radius)], axis=-1)
    turn = (arc >= straight) & (arc < straight + bend)
    angle = (arc[turn] - straight) / radius - 0.5 * np.pi
    curve[turn] = np.stack([half_length + radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    rest = arc >= straight + bend
    if rest.any():
        curve[rest] = -_stadium(phase[rest] - 0.5, half_length, radius)
    return curve


def _line(phase: FloatArray) -> tuple[FloatArray, FloatArray]:
    curve = _stadium(phase, 0.0066, 0.5e-3)
    tilt = np.stack([curve[:, 0] / TRAVEL_RADIUS_M, np.zeros(len(phase))], axis=-1)
    return tilt, 1.4e-3 + curve[:, 1]


def _arc(phase: FloatArray) -> tuple[FloatArray, FloatArray]:
    tilt = np.radians(18.0)
    curve = _stadium(phase, 0.0070, 0.5e-3)
    azimuth = 0.5 * np.pi + curve[:, 0] / (TRAVEL_RADIUS_M * np.sin(tilt))
    return tilt * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1), 1.4e-3 + curve[:, 1]


def _figure_eight(phase: FloatArray) -> tuple[FloatArray, FloatArray]:
    angle = 2.0 * np.pi * phase
    # The lemniscate of Gerono.
    tilt = np.radians(20.0) * np.stack([np.sin(angle), 0.5 * np.sin(2.0 * angle)], axis=-1)
    return tilt, 1.4e-3 - 0.4e-3 * np.cos(angle)


def _press(phase: FloatArray) -> tuple[FloatArray, FloatArray]:
    angle = 2.0 * np.pi * phase
    tilt = np.stack([np.zeros(len(phase)), 1.2e-3 / TRAVEL_RADIUS_M * np.sin(angle)], axis=-1)
    return tilt, 1.4e-3 - 0.7e-3 * np.cos(angle)


_CURVES: dict[str, Callable[[FloatArray], tuple[FloatArray, FloatArray]]] = {
    "line": _line,
    "arc": _arc,
    "figure_eight": _figure_eight,
    "press": _press,
}
PATHS = tuple(_CURVES)


def reference_path(name: str, contact: DomeContact | PadContact | None = None) -> ReferencePath:
    """Return a path by its name.

    - `line`: to and fro over the apex, 13 mm, out at 0.9 mm of depth and back at 1.9 mm.
    - `arc`: to and fro around the axis, 18 degrees from the apex, at the same depths.
    - `figure_eight`: a lemniscate, 12 mm wide; its branches cross at 1 mm and 1.8 mm of depth.
    - `press`: in and out at the apex between 0.7 mm and 2.1 mm; 1.2 mm aside on the way.

    Args:
        contact: of which ball on which dome or pad.

    Raises:
        ValueError: no such path.
    """
    if name not in _CURVES:
        raise ValueError(f"there is no path {name!r}; choose one of {', '.join(PATHS)}")
    contact = contact or DomeContact()
    drawn = contact.position_m(*_CURVES[name](np.linspace(0.0, 1.0, 4 * SAMPLE_COUNT + 1)))
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(drawn, axis=0), axis=1))])
    spacing = float(arc[-1]) / SAMPLE_COUNT
    wanted = spacing * np.arange(SAMPLE_COUNT)
    position = np.stack([np.interp(wanted, arc, drawn[:, axis]) for axis in range(3)], axis=-1)
    ahead, behind = np.roll(position, -1, axis=0), np.roll(position, 1, axis=0)
    tangent = ahead - behind
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    bend = np.linalg.norm(np.roll(tangent, -1, axis=0) - np.roll(tangent, 1, axis=0), axis=1)
    curvature = bend / (2.0 * spacing)
    speed = np.minimum(SPEED_M_S, TURN_RATE_RAD_S / np.maximum(curvature, 1.0))
    speed = ndimage.gaussian_filter1d(speed, SMOOTHING_M / spacing, mode="wrap")
    speed = np.maximum(speed, SMALLEST_SPEED_M_S)
    return ReferencePath(name, position, tangent, speed, spacing, cKDTree(position))


@dataclass(frozen=True)
class Expert:
    """Knows where the indenter is, and commands how the sensor goes along a path and back to it.

    Attributes:
        gain_per_s: speed towards the path over the distance from it.
        look_ahead_s: the path is followed as it is so much later: about the time from an image to
            the motion that answers it.
        fading_m: distance from the path at which half of the speed along it is left.
    """

    path: ReferencePath
    gain_per_s: float = 2.5
    look_ahead_s: float = 0.1
    fading_m: float = 1.0e-3
    largest_speed_m_s: float = 0.008

    def relative_velocity_m_s(self, position_m: ArrayLike) -> FloatArray:
        """Return velocities (..., 3) of the indenter relative to the sensor, along its axes.

        Args:
            position_m: (..., 3) places of the indenter in the sensor's frame.
        """
        position = np.asarray(position_m, dtype=np.float64)
        distance, arc = self.path.nearest(position)
        nearest, _, speed = self.path.at(arc)
        _, tangent, speed = self.path.at(arc + self.look_ahead_s * speed)
        share = 1.0 / (1.0 + np.square(distance / self.fading_m))
        velocity = (share * speed)[..., None] * tangent + self.gain_per_s * (nearest - position)
        size = np.linalg.norm(velocity, axis=-1, keepdims=True)
        return np.asarray(
            velocity * np.minimum(1.0, self.largest_speed_m_s / np.maximum(size, 1e-9))
        )

    def command(self, position_m: ArrayLike) -> FloatArray:
        """Return commands (..., 6) to the sensor, along its own axes: m/s, then rad/s.

        The indenter stands still, so the sensor moves the other way. It does not turn: a ball
        feels the same from every side, so touch does not identify an error of orientation.
        """
        linear = -self.relative_velocity_m_s(position_m)
        return np.concatenate([linear, np.zeros_like(linear)], axis=-1)
