# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Trajectories that can be recorded next: paths of an indenter at places of the gel, no deeper than
the data set went."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dotsim_ros.data.scripted import Site, turned
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.specification import GelSpecification

CLEARANCE_M = 0.5e-3
SLOW_M_S, FAST_M_S = 0.005, 0.03
SHORT_S, LONG_S = 1.0, 10.0
REST_S = 0.2
"""What is late by less catches up in it: a force that does not follow the press would be refused as
another press's."""
SHALLOWEST_M = 1.2e-3
"""The skin of a shallower contact is not used."""
SLIDE_M = 4.0e-3
PAD_SHARE = 0.25
"""A slide covers at most this share of a pad's length."""
TURN_RAD = np.deg2rad(30.0)
TURN_RATE_RAD_S = 0.5
REVERSAL_M = 0.3e-3
NECK_M = 0.1e-3
"""Step of a slow release where it leaves the skin."""


@dataclass(frozen=True)
class Planned:
    """A trajectory to record.

    Attributes:
        kind: in a word, for its name.
        indenter: name of what presses.
        path: where, how deep and how fast, in words.
        stamp_s: (F,) from its begin.
        poses: F of the indenter, base frame; between two of them it goes straight.
    """

    kind: str
    indenter: str
    path: str
    stamp_s: FloatArray
    poses: tuple[Pose, ...]

    @property
    def duration_s(self) -> float:
        """From the first pose to the last."""
        return float(self.stamp_s[-1])


@dataclass(frozen=True)
class _Stop:
    """Where a path leads next: evenly, in so many frames, and in how long."""

    depth_m: float
    seconds: float
    frames: int
    along_m: float = 0.0
    turn_rad: float = 0.0


@dataclass(frozen=True)
class _Place:
    """A place of the gel, in words, and as that of a dome; a pad has its middle alone."""

    words: str
    tilt_rad: float = 0.0
    azimuth_rad: float = 0.0

    def pose(self, gel: GelSpecification, depth_m: float, along_m: float, turn_rad: float) -> Pose:
        is_dome = gel.shape == "dome"
        radius_m = gel.outer_radius_m if is_dome else gel.thickness_m
        site = Site(radius_m, self.tilt_rad, self.azimuth_rad, turn_rad)
        pose = site.pose(depth_m)
        # To the side of the tilt, so that a slide stays at its height on the dome.
        side = np.array([-np.sin(self.azimuth_rad), np.cos(self.azimuth_rad), 0.0])
        if is_dome:
            return turned(pose, np.cross(site.direction(), side), along_m / radius_m)
        return Pose(pose.position_m + along_m * side, pose.quaternion_xyzw)


def catalogue(gel: GelSpecification, depths_m: Mapping[str, float]) -> list[Planned]:
    """Return trajectories of some ten frames each.

    Args:
        gel: of the sensor.
        depths_m: how deep the data set has pressed, by the name of its indenter; of two indenters
            at most, the first being the usual one.
    """
    is_dome = gel.shape == "dome"
    apex = _Place("at the apex" if is_dome else "in the middle")
    tilted = [_Place("20 degrees from the apex", np.deg2rad(20.0))] if is_dome else []
    steep = [_Place("40 degrees from the apex", np.deg2rad(40.0), np.pi / 2)] if is_dome else []
    slide_m = SLIDE_M if is_dome else min(SLIDE_M, PAD_SHARE * gel.pad_size_m[1])
    found: list[Planned] = []
    for number, (indenter, deep_m) in enumerate(depths_m.items()):
        shallow_m = max(0.5 * deep_m, min(SHALLOWEST_M, deep_m))

        def add(
            kind: str, words: str, place: _Place, stops: list[_Stop], name: str = indenter
        ) -> None:
            stamp_s, poses = _frames(gel, place, stops)
            found.append(Planned(kind, name, f"{words} {place.words}", stamp_s, poses))

        for place, depth_m, speed_m_s, hold_s in (
            (apex, deep_m, SLOW_M_S, SHORT_S),
            (apex, deep_m, FAST_M_S, LONG_S),
            (apex, shallow_m, SLOW_M_S, SHORT_S),
            *((one, deep_m, SLOW_M_S, SHORT_S) for one in (*tilted, *steep)),
        )[: 2 if number else None]:
            words = f"a press {_mm(depth_m)} deep at {_mm(speed_m_s)}/s, held for {hold_s:g} s,"
            add("press", words, place, _press(depth_m, speed_m_s, hold_s))
        if number:
            continue
        for place, depth_m in ((apex, shallow_m), *((one, deep_m) for one in (apex, *tilted))):
            words = f"a slide of {_mm(slide_m)}, {_mm(depth_m)} deep, at {_mm(SLOW_M_S)}/s"
            add("slide", words, place, _slide(depth_m, slide_m, is_back=False))
        words = f"a slide of {_mm(slide_m)} there and back, {_mm(deep_m)} deep, at"
        words += f" {_mm(SLOW_M_S)}/s"
        add("slide_back", words, apex, _slide(deep_m, slide_m, is_back=True))
        words = f"a turn of {np.rad2deg(TURN_RAD):.0f} degrees and back, {_mm(deep_m)} deep,"
        add("twist", words, apex, _twist(deep_m))
        words = f"two presses to {_mm(shallow_m)} and two to {_mm(deep_m)} at {_mm(SLOW_M_S)}/s"
        add("cycles", words, apex, _presses([shallow_m, shallow_m, deep_m, deep_m], SLOW_M_S))
        words = f"two presses to {_mm(deep_m)} at {_mm(FAST_M_S)}/s, {REST_S:g} s between strokes,"
        add("fast", words, apex, _presses([deep_m, deep_m], FAST_M_S, REST_S))
        words = f"moves of {_mm(REVERSAL_M)} back and forth, {_mm(deep_m)} deep,"
        add("reversals", words, apex, _reversals(deep_m))
        words = f"a slow release from {_mm(shallow_m)}, a frame every {_mm(NECK_M)} at the end,"
        add("release", words, apex, _release(shallow_m))
    return found


def _mm(length_m: float) -> str:
    return f"{1e3 * length_m:.3g} mm"


def _to(depth_m: float, from_m: float, speed_m_s: float, frames: int, along_m: float = 0) -> _Stop:
    return _Stop(depth_m, abs(depth_m - from_m) / speed_m_s, frames, along_m)


def _press(depth_m: float, speed_m_s: float, hold_s: float) -> list[_Stop]:
    return [
        _Stop(-CLEARANCE_M, 0.0, 1),
        _to(depth_m, -CLEARANCE_M, speed_m_s, 4),
        _Stop(depth_m, hold_s, 2),
        _to(-CLEARANCE_M, depth_m, speed_m_s, 3),
    ]


def _slide(depth_m: float, distance_m: float, *, is_back: bool) -> list[_Stop]:
    near, far = -0.5 * distance_m, 0.5 * distance_m
    along = [_Stop(depth_m, distance_m / SLOW_M_S, 4, far)]
    if is_back:
        along.append(_Stop(depth_m, distance_m / SLOW_M_S, 3, near))
    return [
        _Stop(-CLEARANCE_M, 0.0, 1, near),
        _to(depth_m, -CLEARANCE_M, SLOW_M_S, 3, near),
        *along,
        _to(-CLEARANCE_M, depth_m, SLOW_M_S, 2, along[-1].along_m),
    ]


def _twist(depth_m: float) -> list[_Stop]:
    seconds = TURN_RAD / TURN_RATE_RAD_S
    return [
        _Stop(-CLEARANCE_M, 0.0, 1),
        _to(depth_m, -CLEARANCE_M, SLOW_M_S, 3),
        _Stop(depth_m, seconds, 3, turn_rad=TURN_RAD),
        _Stop(depth_m, seconds, 2),
        _to(-CLEARANCE_M, depth_m, SLOW_M_S, 2),
    ]


def _presses(depths_m: list[float], speed_m_s: float, rest_s: float = 0.0) -> list[_Stop]:
    rest = 1 if rest_s else 0
    stops = [_Stop(-CLEARANCE_M, 0.0, 1)]
    for depth_m in depths_m:
        stops += [
            _to(depth_m, -CLEARANCE_M, speed_m_s, 2),
            _Stop(depth_m, rest_s, rest),
            _to(-CLEARANCE_M, depth_m, speed_m_s, 1 + rest),
            _Stop(-CLEARANCE_M, rest_s, rest),
        ]
    return stops


def _reversals(depth_m: float) -> list[_Stop]:
    up, down = (_Stop(depth, REVERSAL_M / SLOW_M_S, 1) for depth in (depth_m - REVERSAL_M, depth_m))
    return [
        _Stop(-CLEARANCE_M, 0.0, 1),
        _to(depth_m, -CLEARANCE_M, SLOW_M_S, 3),
        *(up, down, up, down),
        _to(-CLEARANCE_M, depth_m, SLOW_M_S, 2),
    ]


def _release(depth_m: float) -> list[_Stop]:
    return [
        _Stop(-CLEARANCE_M, 0.0, 1),
        _to(depth_m, -CLEARANCE_M, SLOW_M_S, 3),
        _to(2.0 * NECK_M, depth_m, SLOW_M_S, 2),
        _to(-3.0 * NECK_M, 2.0 * NECK_M, 0.1 * SLOW_M_S, 5),
    ]


def _frames(
    gel: GelSpecification, place: _Place, stops: list[_Stop]
) -> tuple[FloatArray, tuple[Pose, ...]]:
    """Return the times (F,) and poses of a path that begins at its first stop."""
    at = np.array([(stop.depth_m, stop.along_m, stop.turn_rad) for stop in stops])
    ends_s = np.cumsum([stop.seconds for stop in stops])
    times, ways = [0.0], [at[0]]
    for number, stop in enumerate(stops[1:], start=1):
        for share in (1.0 + np.arange(stop.frames)) / stop.frames:
            times.append(ends_s[number] - (1.0 - share) * stop.seconds)
            ways.append(at[number] - (1.0 - share) * (at[number] - at[number - 1]))
    return np.array(times), tuple(place.pose(gel, *way.tolist()) for way in ways)
