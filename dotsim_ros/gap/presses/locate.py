# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where simulation and measurement disagree: by channel, trajectory, phase and region, before and
after effects are added."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import ALL, ChannelGap, ResidualPlace, WorstFrame
from dotsim_ros.gap.presses.covariance import ChannelNoise, Discrepancy, amplitude, white_variance
from dotsim_ros.gap.presses.evidence import Case, EvidenceTrajectory
from dotsim_ros.gap.presses.inference import Fit, fit_nuisances
from dotsim_ros.gap.presses.observables import CHANNELS, regions_of_observables
from dotsim_ros.gap.presses.search_state import Ranked, Search
from dotsim_ros.io.arrays import FloatArray

UNITS = {"skin": "m", "force": "N"}
RESAMPLED = 200
FOOTPRINT = 0.3
"""Effects that move an observable by fewer of its deviations hardly act on it."""


@dataclass(frozen=True)
class Residuals:
    """What is left of the observables of each trajectory, (F, SIZE) each.

    Attributes:
        before: measured minus the twin as it was.
        recalibrated: with the nuisances fitted.
        after: with the effects as well.
        deviation: what noise and discrepancy are expected to leave.
    """

    before: list[FloatArray]
    recalibrated: list[FloatArray]
    after: list[FloatArray]
    deviation: list[FloatArray]


def expected_deviation(
    t: EvidenceTrajectory, noise: ChannelNoise, discrepancy: Discrepancy
) -> FloatArray:
    """Return (F, SIZE) one standard deviation of each observable where no effect is missing."""
    relative = np.diag(discrepancy.between) + np.diag(discrepancy.within)
    scale = amplitude(t.recording, t.recording.press.force_n)
    return np.sqrt(scale**2 * relative + white_variance(noise, t.places))


def residuals_of(
    case: Case,
    *,
    recalibrated: FloatArray,
    refitted: FloatArray,
    change: Sequence[FloatArray],
    noise: ChannelNoise,
    discrepancy: Discrepancy,
) -> Residuals:
    """Return the residuals of every trajectory of a case.

    Args:
        case: the data.
        recalibrated, refitted: nuisances (columns,) of the evidence, alone and next to the effects.
        change: (F, SIZE) of each trajectory by the effects.
        noise, discrepancy: what is expected to be left.
    """
    before, alone, after, deviation = [], [], [], []
    for number, t in enumerate(case.trajectories):
        left = t.observed - t.predicted
        before.append(left)
        alone.append(left - case.moved(number, recalibrated))
        after.append(left - case.moved(number, refitted) - change[number])
        deviation.append(expected_deviation(t, noise, discrepancy))
    return Residuals(before, alone, after, deviation)


def with_effects(search: Search, named: Sequence[Ranked]) -> tuple[Residuals, Fit]:
    """Return what effects leave, and the nuisances next to them."""
    change = change_by_trajectory(search, named)
    refitted = fit_nuisances(search.evidence.without(search.case.whitened(change, search.chosen)))
    residuals = residuals_of(
        search.case,
        recalibrated=search.base.nuisance,
        refitted=refitted.nuisance,
        change=change,
        noise=search.noise,
        discrepancy=search.discrepancy,
    )
    return residuals, refitted


def change_by_trajectory(search: Search, entries: Sequence[Ranked]) -> list[FloatArray]:
    """Return (F, SIZE) of each trajectory by effects at the sizes found."""
    total = [np.zeros_like(t.predicted) for t in search.case.trajectories]
    for entry in entries:
        change, failures = search.case.change_everywhere(entry.trial.variant, entry.trial.size)
        search.warnings += [f"an effect could not be simulated: {text}" for text in failures]
        total = [before + part for before, part in zip(total, change, strict=True)]
    return total


def is_at_floor(search: Search, entries: Sequence[Ranked]) -> bool:
    """Return whether effects leave nothing of the held-out trajectories, by `decision.AT_FLOOR`, in
    any channel, phase and region; they do not where they cannot be simulated there."""
    known = len(search.warnings)
    residuals, _ = with_effects(search, entries)
    if len(search.warnings) > known:
        return False
    places = places_of_gap(search.case, residuals, search.held_out, search.random)
    return all(place.after < decision.AT_FLOOR for place in places)


def is_off(search: Search, entries: Sequence[Ranked]) -> bool:
    """Return whether held-out trajectories have a clear gap, by `decision.FAR`, where effects
    act."""
    closed = share_closed(with_effects(search, entries)[0], search.held_out, search.random)
    return closed is not None and closed.before >= decision.FAR


def channel_gaps(residuals: Residuals, chosen: Sequence[int]) -> tuple[ChannelGap, ...]:
    """Return each channel's RMS over some trajectories."""
    gaps = []
    for channel, part in CHANNELS.items():
        rms = [
            _rms([each[t][:, part] for t in chosen])
            for each in (
                residuals.before,
                residuals.recalibrated,
                residuals.after,
                [
                    np.where(np.isfinite(left), deviation, np.nan)
                    for left, deviation in zip(residuals.before, residuals.deviation, strict=True)
                ],
            )
        ]
        if np.isfinite(rms[0]):
            gaps.append(ChannelGap(channel, UNITS[channel], *rms))
    return tuple(gaps)


def _rms(parts: Sequence[FloatArray]) -> float:
    values = np.concatenate([part[np.isfinite(part)] for part in parts])
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


@dataclass(frozen=True)
class Closed:
    """How much of the gap of some trajectories the effects close.

    Attributes:
        share: (RMS0^2 - RMS1^2) / (RMS0^2 - floor^2) in units of the expected deviation; RMS0 is
            that of the recalibrated twin. 1 where what is left is below the floor.
        low, high: its interval of 95 % by a bootstrap over trajectories; None for a single one, of
            which there is none.
        before: RMS0 over the floor.
        trajectories: on how many of them the recalibrated twin is off by more than the floor where
            the effects show.
    """

    share: float
    low: float | None
    high: float | None
    before: float
    trajectories: int


def share_closed(
    residuals: Residuals, chosen: Sequence[int], random: np.random.Generator
) -> Closed | None:
    """Return how much of the gap of trajectories the effects close, None where there was nothing to
    close.

    Observables that the effects hardly move are left out: they say nothing of the effects.
    """
    sums = np.array([_squares(residuals, t) for t in chosen])
    drawn = random.integers(len(chosen), size=(RESAMPLED, len(chosen)))
    shares = [_share(sums[rows].sum(axis=0)) for rows in drawn]
    finite = [share for share in shares if np.isfinite(share)]
    low, high = None, None
    if len(chosen) > 1 and finite:
        low, high = np.percentile(finite, [2.5, 97.5]).tolist()
    before, _, floor = whole = sums.sum(axis=0)
    share = _share(whole)
    if not np.isfinite(share):
        return None
    off = int(np.count_nonzero(sums[:, 0] > sums[:, 2]))
    return Closed(share, low, high, float(np.sqrt(before / floor)), off)


def _squares(residuals: Residuals, t: int) -> tuple[float, float, float]:
    """Return squares of the recalibrated twin, of that with effects, and their number; the skin and
    the force count alike, whatever the number of their observables."""
    result = np.zeros(3)
    for part in CHANNELS.values():
        deviation = residuals.deviation[t][:, part]
        # NaN, where nothing was observed, is not part of a footprint.
        before = residuals.recalibrated[t][:, part] / deviation
        after = residuals.after[t][:, part] / deviation
        there = np.abs(before - after) > FOOTPRINT
        if there.any():
            result += np.array([np.mean(before[there] ** 2), np.mean(after[there] ** 2), 1.0])
    return float(result[0]), float(result[1]), float(result[2])


def _share(sums: FloatArray) -> float:
    before, after, floor = sums
    # The floor is what is expected: less than that is no more than all of the gap.
    return min(1.0, (before - after) / (before - floor)) if before > floor else float("nan")


def places_of_gap(
    case: Case, residuals: Residuals, chosen: Sequence[int], random: np.random.Generator
) -> tuple[ResidualPlace, ...]:
    """Return the RMS in units of the expected deviation, by trajectory and over all of them."""
    region = np.array(regions_of_observables())
    sums: dict[tuple[str, str, str], dict[str, FloatArray]] = {}
    for t in chosen:
        trajectory = case.trajectories[t]
        phase = np.array([p.value for p in trajectory.recording.phase])
        for channel, part in CHANNELS.items():
            for name in dict.fromkeys(region[part]):
                for step in dict.fromkeys(phase):
                    members = np.ix_(phase == step, np.flatnonzero(region == name))
                    left = residuals.before[t][members] / residuals.deviation[t][members]
                    after = residuals.after[t][members] / residuals.deviation[t][members]
                    there = np.isfinite(left)
                    if there.any():
                        square = np.array(
                            [np.sum(left[there] ** 2), np.sum(after[there] ** 2), there.sum()]
                        )
                        key = (channel, str(step), str(name))
                        sums.setdefault(key, {})[trajectory.recording.name] = square
    places = []
    for key, by_trajectory in sums.items():
        for trajectory_name, square in by_trajectory.items():
            places.append(_place(key, trajectory_name, square))
        every = np.stack(list(by_trajectory.values()))
        places.append(_place(key, ALL, every.sum(axis=0), *_interval(every, random)))
    return tuple(places)


def _place(
    key: tuple[str, str, str],
    trajectory: str,
    square: FloatArray,
    low: float = 0.0,
    high: float = 0.0,
) -> ResidualPlace:
    channel, phase, region = key
    before, after = np.sqrt(square[:2] / square[2]).tolist()
    return ResidualPlace(
        channel, trajectory, phase, region, before, after, low, high, int(square[2])
    )


def _interval(squares: FloatArray, random: np.random.Generator) -> tuple[float, float]:
    if len(squares) < 2:
        return 0.0, 0.0
    drawn = squares[random.integers(len(squares), size=(RESAMPLED, len(squares)))].sum(axis=1)
    low, high = np.percentile(np.sqrt(drawn[:, 0] / drawn[:, 2]), [2.5, 97.5])
    return float(low), float(high)


def worst_place(residuals: Residuals, chosen: Sequence[int]) -> tuple[int, int] | None:
    """Return which trajectory, and which frame of it, has the largest residual before; None where
    nothing was observed."""
    worst, place = -1.0, None
    for t in chosen:
        scaled = (residuals.before[t] / residuals.deviation[t]) ** 2
        for frame, row in enumerate(scaled):
            there = np.isfinite(row)
            size = float(np.mean(row[there])) if there.any() else -1.0
            if size > worst:
                worst, place = size, (t, frame)
    return place


def frame_of(
    case: Case,
    residuals: Residuals,
    t: int,
    frame: int,
    skins: tuple[FloatArray, FloatArray] | None,
) -> WorstFrame:
    """Return what a trajectory shows in a frame, with its skins, simulated without and with the
    effects, (F, V, 3); None where they are not known."""
    trajectory = case.trajectories[t]
    press = trajectory.recording.press
    load = CHANNELS["force"]
    forces = [
        ((trajectory.observed - left)[frame, load] @ trajectory.places.axes).tolist()
        for left in (residuals.before[t], residuals.after[t])
    ]
    has_force = press.force_n is not None
    return WorstFrame(
        trajectory.recording.name,
        frame,
        float(press.stamp_s[frame]),
        _rounded(case.rest_m) if skins is not None else [],
        _rounded(press.skin_position_m[frame]) if press.skin_position_m is not None else [],
        _rounded(skins[0][frame]) if skins is not None else [],
        _rounded(skins[1][frame]) if skins is not None else [],
        press.force_n[frame].tolist() if press.force_n is not None else [],
        *(forces if has_force else ([], [])),
    )


def _rounded(points_m: FloatArray) -> list[list[float]]:
    rounded: list[list[float]] = np.round(points_m, 6).tolist()
    return rounded
