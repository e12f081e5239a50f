# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Named frames that move in one another, as TF carries them: where one is in another, and when.

The semantics are those of tf2's buffer: each frame has one parent, two frames are compared at the
newest time that every moving transform between them has reached, and a transform is interpolated
between its two samples around that time.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import reduce

from dotsim_ros.geometry.pose import Pose, compose, interpolate, inverse
from dotsim_ros.io.documents import value_text

NANOSECONDS_PER_SECOND = 1_000_000_000
MOST_SAMPLES = 1000
"""Of one transform: a second at 1 kHz."""
MOST_FRAMES = 10_000
NAMED_FRAMES = 12


class OutOfOrderError(ValueError):
    """A transform is stamped before the last one of its frame."""


@dataclass
class _Edge:
    """A frame in its parent: the newest sample as it came, and those that were read."""

    parent: str
    is_static: bool
    stamp_ns: int
    read: Callable[[], Pose]
    stamps_ns: list[int] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)

    def load(self) -> None:
        """Read the newest sample, once; errors as of `read`."""
        if not self.stamps_ns or self.stamps_ns[-1] != self.stamp_ns:
            self.poses.append(self.read())
            self.stamps_ns.append(self.stamp_ns)
            del self.stamps_ns[:-MOST_SAMPLES], self.poses[:-MOST_SAMPLES]

    def at(self, time_ns: int) -> Pose:
        """Return the pose at a time between the first and the last sample."""
        if self.is_static:
            return self.poses[-1]
        index = bisect_left(self.stamps_ns, time_ns)
        after_ns, after = self.stamps_ns[index], self.poses[index]
        if after_ns == time_ns:
            return after
        before_ns = self.stamps_ns[index - 1]
        share = (time_ns - before_ns) / (after_ns - before_ns)
        return interpolate(self.poses[index - 1], after, share)


class FrameTree:
    """Takes transforms, and tells where one frame is in another.

    Args:
        pairs: the frames that are compared, (target, source). Only transforms between them are
            read: a robot has many more.
        maximum_step_s: a stamp that steps back by more means that time begins again: what moved is
            forgotten.
    """

    def __init__(self, pairs: Sequence[tuple[str, str]], *, maximum_step_s: float) -> None:
        self._pairs = tuple(pairs)
        self.maximum_step_s = maximum_step_s
        self._edges: dict[str, _Edge] = {}
        self._between: frozenset[str] = frozenset()

    def put(
        self, parent: str, child: str, stamp_ns: int, read: Callable[[], Pose], *, is_static: bool
    ) -> None:
        """Take the pose of a frame in its parent.

        Args:
            parent: name of the frame that the pose is given in.
            child: name of the frame.
            stamp_ns: its time; of no meaning where it is static.
            read: returns the pose; called only where the frame lies between two that are compared.
            is_static: it holds at all times.

        Raises:
            OutOfOrderError: it is stamped before the last one. What came before stays.
            ValueError: the frame would be in itself, there are too many, or what `read` raises.
        """
        known = self._edges.get(child)
        if known is not None and not (is_static or known.is_static):
            step_s = (stamp_ns - known.stamp_ns) / NANOSECONDS_PER_SECOND
            if step_s < -self.maximum_step_s:
                self.forget_motion()
                known = None
            elif step_s < 0.0:
                raise OutOfOrderError(
                    f"the transform of {value_text(child)} is stamped {-step_s:.6f} s before its "
                    "last one, expected after it"
                )
            elif step_s == 0.0 and known.parent == parent:
                return
        is_new = known is None or (known.parent, known.is_static) != (parent, is_static)
        if is_new:
            self._check_place(parent, child)
        edge = _Edge(parent, is_static, stamp_ns, read)
        if known is not None and not is_new and not is_static:
            edge.stamps_ns, edge.poses = known.stamps_ns, known.poses
        if child in self._between:
            edge.load()
        self._edges[child] = edge
        if is_new:
            self._find_between()

    def forget_motion(self) -> None:
        """Forget all that moves: time begins again. What is static stays."""
        self._edges = {name: edge for name, edge in self._edges.items() if edge.is_static}
        self._find_between()

    def locate(self, target: str, source: str) -> tuple[Pose, int] | None:
        """Return the pose of the source in the target and its time in nanoseconds, or None where
        they are not connected, or not at one time; `missing` says why."""
        path = self._path(target, source)
        if path is None:
            return None
        moving = [self._edges[name] for name in (*path[0], *path[1])]
        if any(not edge.poses for edge in moving):
            return None
        fixed_ns = max((edge.stamp_ns for edge in moving), default=0)
        moving = [edge for edge in moving if not edge.is_static]
        time_ns = min((edge.stamp_ns for edge in moving), default=fixed_ns)
        if any(edge.stamps_ns[0] > time_ns for edge in moving):
            return None
        to_target, to_source = (
            [self._edges[name].at(time_ns) for name in reversed(names)] for names in path
        )
        # No identity in between, which would round.
        places = [inverse(reduce(compose, to_target))] if to_target else []
        places += to_source
        return reduce(compose, places) if places else Pose(), time_ns

    def missing(self, target: str, source: str) -> str:
        """Return why the source cannot be placed in the target, in words; empty where it can."""
        parents = {edge.parent for edge in self._edges.values()}
        known = sorted(parents | set(self._edges))
        if not known:
            return "no transform has come"
        named = ", ".join(value_text(name) for name in known[:NAMED_FRAMES])
        if len(known) > NAMED_FRAMES:
            named += f" and {len(known) - NAMED_FRAMES} more"
        for frame in (target, source):
            if frame not in known:
                return f"there is no frame {value_text(frame)}; known are {named}"
        if self._path(target, source) is None:
            roots = [value_text([name, *self._above(name)][-1]) for name in (target, source)]
            return (
                f"{value_text(target)} and {value_text(source)} are in two trees, below "
                f"{roots[0]} and {roots[1]}: publish a transform that joins them"
            )
        if self.locate(target, source) is None:
            return f"{value_text(target)} and {value_text(source)} have no common time so far"
        return ""

    def _check_place(self, parent: str, child: str) -> None:
        if not parent or not child:
            raise ValueError(
                f"a transform is of {value_text(child)} in {value_text(parent)}, expected two "
                "names of frames"
            )
        if child in (parent, *self._above(parent)):
            raise ValueError(
                f"a transform puts {value_text(child)} into {value_text(parent)}, which is in "
                f"{value_text(child)} itself: expected a tree of frames"
            )
        if len(self._edges) >= MOST_FRAMES and child not in self._edges:
            raise ValueError(f"{value_text(child)} would be more than {MOST_FRAMES} frames")

    def _above(self, frame: str) -> list[str]:
        """Return the frames that a frame is in, the nearest first."""
        found: list[str] = []
        while frame in self._edges:
            frame = self._edges[frame].parent
            found.append(frame)
        return found

    def _path(self, target: str, source: str) -> tuple[list[str], list[str]] | None:
        """Return the frames from the target and from the source up to below their common one."""
        above_target, above_source = ([name, *self._above(name)] for name in (target, source))
        common = next((name for name in above_source if name in above_target), None)
        if common is None:
            return None
        return (
            above_target[: above_target.index(common)],
            above_source[: above_source.index(common)],
        )

    def _find_between(self) -> None:
        paths = [self._path(*pair) for pair in self._pairs]
        self._between = frozenset(
            name for path in paths if path is not None for names in path for name in names
        )
        for name in self._between:
            try:
                self._edges[name].load()
            except ValueError:
                # It cannot be read now nor later.
                del self._edges[name]
                self._between = frozenset()
                raise
