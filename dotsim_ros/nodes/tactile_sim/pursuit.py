# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The path of the commanded poses, and how far an indenter gets on it in a frame. Needs no ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from dotsim_ros.gel.implicit.gel import LARGEST_SUBSTEP_M
from dotsim_ros.geometry.pose import Pose, interpolate

TOUCH_M = 0.01e-3
"""An indenter that is closer to the gel at rest than this counts as in contact."""
SPACING_M = 0.05e-3
"""Of the poses that are kept: what lies between two that are closer is the straight way."""
LONGEST_M = 10.0e-3
"""An indenter that is farther behind, along the path, leaves the path out, so that no slow machine
shows what was commanded long ago. It bounds the poses that are kept, too."""
ROUNDING_M = 1e-10
TRACE_COUNT = 32
"""A way that grazes the gel is looked at no more often."""


@dataclass(frozen=True)
class Move:
    """What the indenter does in a frame.

    Attributes:
        pose: where it gets.
        start: where it is put first, touching nothing; None: it goes on from where it is.
        between: poses that it is led through before it gets there.
    """

    pose: Pose
    start: Pose | None = None
    between: tuple[Pose, ...] = ()


def clear_of_gel(pose: Pose, depth_m: Callable[[Pose], float]) -> Pose:
    """Return where an indenter that leaves a pose along its z axis does not touch the gel.

    Args:
        pose: where it begins; returned itself where nothing touches there.
        depth_m: returns how deep the indenter is in the gel at rest, negative outside.
    """
    return _raised(pose, -2.0 * TOUCH_M, depth_m)


def _raised(pose: Pose, largest_m: float, depth_m: Callable[[Pose], float]) -> Pose:
    """Return a pose moved out along its z axis until it is no deeper."""
    axis = pose.rotation()[:, 2]
    for _ in range(TRACE_COUNT):
        excess_m = depth_m(pose) - largest_m
        if excess_m <= 0.0:
            break
        pose = Pose(pose.position_m + max(excess_m, ROUNDING_M) * axis, pose.quaternion_xyzw)
    return pose


class _Point:
    """A pose of the path, and how deep it is."""

    def __init__(self, pose: Pose, depth_m: Callable[[Pose], float]) -> None:
        self.pose, self._find_m = pose, depth_m
        self.is_new = True

    @cached_property
    def depth_m(self) -> float:
        return self._find_m(self.pose)

    @property
    def is_free(self) -> bool:
        return self.depth_m < -TOUCH_M


class CommandedPath:
    """Leads an indenter from one commanded pose to the next, in their order.

    In contact it moves by a limited way in a frame. Out of contact it is free: where the path has
    left the gel, the indenter goes at once to where it did so last. It is never deeper in the gel
    at rest than the deepest pose that was commanded since the last frame: where the path was, it
    goes on to the next pose that is not.

    Args:
        way_m: returns how far the indenter moves between two poses.
        depth_m: returns how deep it is in the gel at rest, negative outside.
    """

    def __init__(
        self, *, way_m: Callable[[Pose, Pose], float], depth_m: Callable[[Pose], float]
    ) -> None:
        self._way_m, self._depth_m = way_m, depth_m
        self._here: _Point | None = None
        self._ahead: list[_Point] = []

    def forget(self) -> None:
        """Begin with the next pose, which the indenter comes to along its own axis."""
        self._here, self._ahead = None, []

    def add(self, pose: Pose) -> None:
        """Take the next commanded pose."""
        known = [self._here, *self._ahead]
        before = known[-2] if self._ahead else None
        if before is not None and self._way_m(before.pose, self._ahead[-1].pose) < SPACING_M:
            self._ahead.pop()
        self._ahead.append(self._point(pose))

    @property
    def here(self) -> Pose | None:
        """Return where the indenter is; None before the first frame."""
        return None if self._here is None else self._here.pose

    @property
    def newest(self) -> Pose | None:
        """Return the newest commanded pose; None where there is none."""
        return self._ahead[-1].pose if self._ahead else self.here

    @property
    def is_reached(self) -> bool:
        """Return whether the indenter is at the newest pose."""
        return not self._ahead

    @property
    def lag_m(self) -> float:
        """Return how far the indenter is from the newest pose, straight."""
        if self._here is None or not self._ahead:
            return 0.0
        return self._way_m(self._here.pose, self._ahead[-1].pose)

    def advance(self, limit_m: float) -> Move:
        """Go on by one frame, and return what the indenter does in it.

        Args:
            limit_m: how far it may move in contact; infinite for as far as the path leads.
        """
        if not self._ahead:
            assert self._here is not None
            return Move(self._here.pose)
        is_straight = len(self._ahead) == 1
        if np.isinf(limit_m) and is_straight:
            return self._goes_to_newest()
        if self._ahead[-1].is_free:
            return self._goes_to_newest(start=self._ahead[-1].pose)
        here = self._here or self._point(clear_of_gel(self._ahead[0].pose, self._depth_m))
        points = [here, *self._ahead]
        start: Pose | None = None
        free = [index for index, point in enumerate(points) if point.is_free]
        if free:
            start = self._first_touch(*points[free[-1] : free[-1] + 2])
            points = [self._point(start), *points[free[-1] + 1 :]]
        elif self._way_m(here.pose, points[-1].pose) <= limit_m and not np.isinf(limit_m):
            return self._goes_to_newest()
        if np.isinf(limit_m):
            return self._goes_to_newest(start=start, between=self._between(points))
        ways_m = [self._way_m(a.pose, b.pose) for a, b in pairwise(points)]
        if sum(ways_m) <= limit_m:
            return self._goes_to_newest(start=start)
        if sum(ways_m) > LONGEST_M:
            return self._goes_to_newest(start=clear_of_gel(points[-1].pose, self._depth_m))
        reached, ahead = self._walked(points, ways_m, limit_m)
        if self._way_m(points[0].pose, reached.pose) > limit_m + SPACING_M:
            start = clear_of_gel(reached.pose, self._depth_m)
        return self._goes_to(reached, ahead, start=start)

    def _walked(
        self, points: list[_Point], ways_m: list[float], limit_m: float
    ) -> tuple[_Point, list[_Point]]:
        """Return the point of a path in contact that is a way from its beginning, or the next one
        that may be shown, and what lies ahead of it."""
        index, left_m = 1, limit_m
        while left_m > ways_m[index - 1]:
            left_m -= ways_m[index - 1]
            index += 1
        before, after = points[index - 1], points[index]
        pose = interpolate(before.pose, after.pose, left_m / ways_m[index - 1])
        # The straight way between two poses on a dome lies deeper than both.
        shallow = _raised(pose, max(before.depth_m, after.depth_m), self._depth_m)
        reached, ahead = self._point(shallow), points[index:]
        allowed_m = self._deepest_new_m(points[-1])
        while reached.depth_m > allowed_m + ROUNDING_M:
            reached, ahead = ahead[0], ahead[1:]
        return reached, ahead

    def _deepest_new_m(self, newest: _Point) -> float:
        return max(point.depth_m for point in self._ahead if point.is_new or point is newest)

    def _first_touch(self, free: _Point, touching: _Point) -> Pose:
        """Return the last pose on the straight way between two points that touches nothing."""
        length_m = self._way_m(free.pose, touching.pose)
        pose, gap_m, passed_m = free.pose, -free.depth_m, 0.0
        for _ in range(TRACE_COUNT):
            step_m = gap_m - TOUCH_M
            if step_m < 0.5 * TOUCH_M or passed_m + step_m >= length_m:
                break
            passed_m += step_m
            pose = interpolate(free.pose, touching.pose, passed_m / length_m)
            gap_m = -self._depth_m(pose)
        return pose

    def _between(self, points: list[_Point]) -> tuple[Pose, ...]:
        """Return poses between the ends of a path, so that no straight way leaves out more of it
        than the gel's own steps do."""
        kept = [points[0]]
        for point in points[1:-1]:
            if self._way_m(kept[-1].pose, point.pose) >= LARGEST_SUBSTEP_M:
                kept.append(point)
        return tuple(point.pose for point in kept[1:])

    def _goes_to_newest(self, *, start: Pose | None = None, between: tuple[Pose, ...] = ()) -> Move:
        return self._goes_to(self._ahead[-1], [], start=start, between=between)

    def _goes_to(
        self,
        reached: _Point,
        ahead: list[_Point],
        *,
        start: Pose | None,
        between: tuple[Pose, ...] = (),
    ) -> Move:
        self._here, self._ahead = reached, ahead
        for point in ahead:
            point.is_new = False
        return Move(reached.pose, start, between)

    def _point(self, pose: Pose) -> _Point:
        return _Point(pose, self._depth_m)
