# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The profile that a session runs with: fixed, or changed as the machine affords. Needs no ROS."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dotsim_ros.gel.implicit.handover import SkinJumpError
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.nodes.tactile_sim.profile_keeper import ProfileKeeper
from dotsim_ros.nodes.tactile_sim.profiles import (
    AUTO,
    BY_CLOCK,
    PROFILES,
    REALTIME,
    Profile,
    solver_of,
)
from dotsim_ros.nodes.tactile_sim.session import WARM_UP_DEPTH_M, SensorMoment, SensorSession
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import SensorSpecification, SolverSpecification

TIMED_STEP_M = 0.3e-3
TIMED_FRAMES = 8
"""A slide of 2.4 mm."""
REFUSAL_TOLD_S = 5.0
"""Between two lines of the log about changes that were refused."""


@dataclass(frozen=True)
class Rung:
    """A profile with the solver that it makes of a sensor's own."""

    profile: Profile
    solver: SolverSpecification


def ladder_of(name: str, sensor: SensorSpecification, *, grid_spacing_m: float = 0.0) -> list[Rung]:
    """Return the profiles that a node may run with, from the finest to the coarsest: one, or for
    `auto` all that differ. A gel that remembers keeps one, since no other could go on with it.

    Args:
        name: as `resolve_profile` returns it.
        sensor: what is simulated.
        grid_spacing_m: in place of the sensor's own, in every profile; 0: none.
    """
    if name == AUTO and sensor.remembers:
        name = REALTIME.name
    rungs: list[Rung] = []
    for profile in PROFILES.values() if name == AUTO else (PROFILES[name],):
        solver = solver_of(profile, sensor, grid_spacing_m=grid_spacing_m)
        # A grid that cannot be coarser makes the coarser profile no faster.
        if not any((r.solver, r.profile.move_m) == (solver, profile.move_m) for r in rungs):
            rungs.append(Rung(profile, solver))
    return rungs


def frame_time_s(sensor: TactileSensor, dt_s: float) -> float:
    """Return the time of a frame, camera included, of a slide at the apex; the sensor is at rest
    afterwards."""
    sensor.reset()
    top_m = float(sensor.skin.rest_position_m[:, 2].max())
    spent_s = []
    for frame in range(TIMED_FRAMES):
        position_m = np.array([frame * TIMED_STEP_M, 0.0, top_m - WARM_UP_DEPTH_M])
        begun_s = time.perf_counter()
        sensor.step(Pose(position_m), dt_s)
        spent_s.append(time.perf_counter() - begun_s)
    sensor.reset()
    return float(np.median(spent_s))


class ActiveProfile:
    """Tells a session's profile and, with a keeper, changes it between two frames.

    Args:
        ladder: the profiles, from the finest to the coarsest; the session runs with the first.
        session: to change.
        keeper: decides; None keeps the first profile.
        why: the reason of the first profile.
        tell: writes a line to the log.
    """

    def __init__(
        self,
        ladder: Sequence[Rung],
        session: SensorSession,
        *,
        keeper: ProfileKeeper | None,
        why: str,
        tell: Callable[[str], None],
    ) -> None:
        self._rungs = {rung.profile.name: rung for rung in ladder}
        self._session, self._keeper, self._why, self._tell = session, keeper, why, tell
        self._rung = ladder[0]
        self._seen: SensorMoment | None = None
        self._largest_jump_m = 0.0
        self._refused = 0
        self._told_s = -np.inf
        if keeper is not None and keeper.name != self.name:
            self._take_up(self._rungs[keeper.name])

    @property
    def name(self) -> str:
        """The present profile."""
        return self._rung.profile.name

    def values(self) -> dict[str, str]:
        """Return what /diagnostics tells."""
        told = {"profile": self.name, "profile_reason": self._why}
        if self._keeper is None:
            return told
        return {
            "profile": self.name,
            "profile_reason": self._keeper.reason,
            "profile_changes": str(self._keeper.changes),
            "profile_changes_refused": str(self._refused),
            "profile_largest_jump_mm": f"{1e3 * self._largest_jump_m:.3f}",
        }

    def end_frame(self, begun_s: float, *, period_s: float) -> None:
        """Hear that a frame has been published; change the profile for the next one where needed.

        Args:
            begun_s: when the frame began, steady time.
            period_s: time between two frames.
        """
        if self._keeper is None or self._session.moment is self._seen:
            return
        self._seen = self._session.moment
        # A frame in which nothing touches is as fast in each profile, and tells nothing.
        if not self._session.is_touched():
            return
        now_s = time.monotonic()
        name = self._keeper.note(now_s - begun_s, now_s, period_s=period_s)
        if name is not None:
            self._change(name, now_s)

    def _change(self, name: str, now_s: float) -> None:
        assert self._keeper is not None
        before = self.name
        try:
            jump_m = self._take_up(self._rungs[name])
        except SkinJumpError as error:
            self._keeper.refused(now_s)
            self._refused += 1
            if now_s - self._told_s > REFUSAL_TOLD_S:
                self._told_s = now_s
                self._tell(f"profile {before} stays for now, {name} would be next: {error}")
            return
        self._keeper.moved(name, now_s)
        self._largest_jump_m = max(self._largest_jump_m, jump_m)
        self._tell(
            f"profile {before} -> {name}: {self._keeper.reason}; the skin moves by "
            f"{1e3 * jump_m:.2f} mm"
        )

    def _take_up(self, rung: Rung) -> float:
        # By the change alone the skin is off by no more than what is documented of the coarser one.
        both = (self._rung.profile, rung.profile)
        jump_m = self._session.change_solver(
            rung.solver,
            limit_m=rung.profile.move_m,
            largest_jump_m=max(each.skin_error_m for each in both),
        )
        self._rung = rung
        return jump_m


def _why_one(asked: str, sensor: TactileSensor) -> str:
    if asked == AUTO:
        return (
            "auto changes nothing here: what the gel remembers would be lost"
            if sensor.remembers
            else "in simulated time frames must not depend on the machine"
        )
    return "by the clock" if asked == BY_CLOCK else "as set"


def make_active_profile(
    ladder: Sequence[Rung],
    sensor: TactileSensor,
    session: SensorSession,
    *,
    asked: str,
    period_s: float,
    tell: Callable[[str], None],
) -> ActiveProfile:
    """Return the profile of a session, whose gels are made and timed where there are several.

    Args:
        ladder: the profiles, from the finest to the coarsest; the session runs with the first.
        sensor: of the session, warmed up.
        session: of the sensor.
        asked: the profile that the user named.
        period_s: time between two frames.
        tell: writes a line to the log.
    """
    if len(ladder) == 1:
        why = _why_one(asked, sensor)
        if asked == AUTO:
            tell(f"profile {ladder[0].profile.name}: {why}")
        return ActiveProfile(ladder, session, keeper=None, why=why, tell=tell)
    begun_s = time.monotonic()
    spent_s = {}
    for rung in ladder:
        sensor.set_solver(rung.solver)
        # The first slide compiles and fills caches.
        frame_time_s(sensor, period_s)
        spent_s[rung.profile.name] = frame_time_s(sensor, period_s)
    sensor.set_solver(ladder[0].solver)
    session.reset()
    keeper = ProfileKeeper(spent_s, period_s=period_s)
    times = ", ".join(f"{name} {1e3 * each:.0f} ms" for name, each in spent_s.items())
    tell(
        f"profile {keeper.name} of auto: a frame takes {times}; made and timed in "
        f"{time.monotonic() - begun_s:.1f} s"
    )
    return ActiveProfile(ladder, session, keeper=keeper, why="", tell=tell)
