# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The profile that a session runs with: fixed, or changed as the machine affords. Needs no ROS."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dotsim_ros.gel.implicit.handover import SkinJumpError
from dotsim_ros.geometry.pose import Pose
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
REFUSAL_LOGGED_S = 5.0
"""Between two lines of the log about changes that were refused."""
WINDOW = 10
MISSES = 3
"""So many of the last `WINDOW` frames over their period are too many."""
HEADROOM = 0.8
"""A finer profile shall leave this share of the period unused in 95 % of its frames..."""
SEEN_FRAMES = 100
"""...by so many frames of the present one, the newest..."""
HOLD_S = 10.0
"""...and not sooner than this after the last change."""
PROBATION_S = 60.0
"""A finer profile that has to be left within this was too fine: its hold doubles..."""
LONGEST_HOLD_S = 640.0
"""...up to this; one that lasted longer halves it."""
REFUSED_S = 2.0
"""Before this nothing is tried again that was refused: a try costs about two frames."""


@dataclass(frozen=True)
class Rung:
    """A profile with the solver that it makes of a sensor's own."""

    profile: Profile
    solver: SolverSpecification


def ladder_of(name: str, sensor: SensorSpecification, *, grid_spacing_m: float = 0.0) -> list[Rung]:
    """Return the profiles that a node may run with, from the finest to the coarsest: one, or for
    `auto` all that differ. A gel that remembers keeps one, since no other could go on with it.

    A grid spacing other than 0 takes the place of the sensor's own in every profile.
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


class ProfileKeeper:
    """Proposes the next profile, from the times of frames: down at once, up with care.

    A few frames that miss their deadline are enough for the next coarser profile; the next finer
    one must have been affordable for long, and after it was not, for twice as long. What becomes of
    a proposal is reported by `moved` or `refused`. All times are steady.

    Args:
        frame_time_s: of each profile on this machine, from the finest profile to the coarsest. Only
            their ratios count once `note` has been called.
        period_s: time between two frames.

    Attributes:
        name: the present profile.
        changes: how many there were.
        reason: of the last one.
    """

    def __init__(self, frame_time_s: Mapping[str, float], *, period_s: float) -> None:
        self._frame_time_s = dict(frame_time_s)
        self._names = tuple(frame_time_s)
        fitting = [n for n, t in frame_time_s.items() if t <= HEADROOM * period_s]
        self.name = fitting[0] if fitting else self._names[-1]
        self.changes = 0
        self.reason = (
            f"a frame took {1e3 * self._frame_time_s[self.name]:.0f} of {1e3 * period_s:.0f} ms "
            "when warming up"
        )
        self._proposed_reason = ""
        self._hold_s = dict.fromkeys(self._names, HOLD_S)
        self._changed_s: float | None = None
        self._went_up = False
        self._not_before_s = -np.inf
        self._recent: deque[bool] = deque(maxlen=WINDOW)
        self._share: deque[float] = deque(maxlen=SEEN_FRAMES)

    def note(self, spent_s: float, now_s: float, *, period_s: float) -> str | None:
        """Return the profile to change to after a frame for which the gel was solved, if any; it
        took `spent_s` from its beginning to its publication."""
        if self._changed_s is None:
            self._changed_s = now_s
        self._recent.append(spent_s > period_s)
        self._share.append(spent_s / period_s)
        if now_s < self._not_before_s:
            return None
        place = self._names.index(self.name)
        misses = sum(self._recent)
        if misses >= MISSES:
            if place + 1 == len(self._names):
                return None
            self._proposed_reason = (
                f"{misses} of {len(self._recent)} frames took more than {1e3 * period_s:.0f} ms"
            )
            return self._names[place + 1]
        if place == 0 or len(self._share) < SEEN_FRAMES:
            return None
        finer = self._names[place - 1]
        if now_s - self._changed_s >= self._hold_s[finer]:
            ratio = self._frame_time_s[finer] / self._frame_time_s[self.name]
            expected = max(1.0, ratio) * float(np.percentile(self._share, 95))
            if expected <= HEADROOM:
                self._proposed_reason = (
                    f"95 % of its frames are expected within {1e3 * expected * period_s:.0f} of "
                    f"{1e3 * period_s:.0f} ms"
                )
                return finer
        return None

    def moved(self, name: str, now_s: float) -> None:
        """Note that the proposed profile is in force."""
        goes_up = self._names.index(name) < self._names.index(self.name)
        if self._went_up and not goes_up and self._changed_s is not None:
            factor = 2.0 if now_s - self._changed_s < PROBATION_S else 0.5
            hold_s = factor * self._hold_s[self.name]
            self._hold_s[self.name] = min(max(hold_s, HOLD_S), LONGEST_HOLD_S)
        self.name, self.reason = name, self._proposed_reason
        self.changes += 1
        self._changed_s, self._went_up = now_s, goes_up
        self._recent.clear()
        self._share.clear()

    def refused(self, now_s: float) -> None:
        """Note that the proposed profile could not be taken up now."""
        self._not_before_s = now_s + REFUSED_S
        self._recent.clear()


class ActiveProfile:
    """The profile of a session, which a keeper changes between two frames.

    Args:
        ladder: the profiles, from the finest to the coarsest; the session runs with the first.
        session: to change.
        keeper: decides; None keeps the first profile.
        why: the reason of the first profile.
        report: writes a line to the log.
    """

    def __init__(
        self,
        ladder: Sequence[Rung],
        session: SensorSession,
        *,
        keeper: ProfileKeeper | None,
        why: str,
        report: Callable[[str], None],
    ) -> None:
        self._rungs = {rung.profile.name: rung for rung in ladder}
        self._session, self._keeper, self._why, self._report = session, keeper, why, report
        self._rung = ladder[0]
        self._seen: SensorMoment | None = None
        self._largest_jump_m = 0.0
        self._refused = 0
        self._logged_s = -np.inf
        if keeper is not None and keeper.name != self.name:
            self._take_up(self._rungs[keeper.name])

    @property
    def name(self) -> str:
        """The present profile."""
        return self._rung.profile.name

    def values(self) -> dict[str, str]:
        """Return what /diagnostics reports."""
        if self._keeper is None:
            return {"profile": self.name, "profile_reason": self._why}
        return {
            "profile": self.name,
            "profile_reason": self._keeper.reason,
            "profile_changes": str(self._keeper.changes),
            "profile_changes_refused": str(self._refused),
            "profile_largest_jump_mm": f"{1e3 * self._largest_jump_m:.3f}",
        }

    def end_frame(self, begun_s: float, *, period_s: float) -> None:
        """Note a frame that began at a steady time and has been published; change the profile for
        the next one where needed."""
        if self._keeper is None or self._session.moment is self._seen:
            return
        self._seen = self._session.moment
        # A frame in which nothing touches is as fast in each profile, and shows nothing.
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
            if now_s - self._logged_s > REFUSAL_LOGGED_S:
                self._logged_s = now_s
                self._report(f"profile {before} stays for now, {name} would be next: {error}")
            return
        self._keeper.moved(name, now_s)
        self._largest_jump_m = max(self._largest_jump_m, jump_m)
        self._report(
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
    report: Callable[[str], None],
) -> ActiveProfile:
    """Return the profile of a session of a sensor that is warmed up, given the one that the user
    asked for; where there are several, their gels are made and timed. Else as `ActiveProfile`."""
    if len(ladder) == 1:
        why = _why_one(asked, sensor)
        if asked == AUTO:
            report(f"profile {ladder[0].profile.name}: {why}")
        return ActiveProfile(ladder, session, keeper=None, why=why, report=report)
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
    report(
        f"profile {keeper.name} of auto: a frame takes {times}; made and timed in "
        f"{time.monotonic() - begun_s:.1f} s"
    )
    return ActiveProfile(ladder, session, keeper=keeper, why="", report=report)
