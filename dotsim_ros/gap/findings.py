# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a search for a gap found: the currency between the search and its report, all plain numbers.

`as_record` and `findings_of` turn it into what JSON holds, and back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, is_dataclass
from enum import Enum
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

from dotsim_ros.effects.effect import Effect
from dotsim_ros.effects.overlay import Estimate

VERSION = 1
ALL = "all"
"""The trajectory of a place whose residuals are those of all."""


class Verdict(Enum):
    """The answers; `exit_status` of each is what the command ends with."""

    NO_GAP = "no_gap"
    NAMED = "named"
    SET = "set"
    UNKNOWN = "unknown"
    UNUSABLE = "unusable"

    @property
    def exit_status(self) -> int:
        """0 no gap, 10 named, 11 a set, 12 unknown, 20 unusable data."""
        return {"no_gap": 0, "named": 10, "set": 11, "unknown": 12, "unusable": 20}[self.value]


@dataclass(frozen=True)
class Candidate:
    """An effect that was tried.

    Attributes:
        name, title: of the effect.
        is_excited: whether the data excite it; if not, nothing else is known.
        score: (s . r)^2 / |s|^2 of its best probe.
        size: predicted value of its first parameter at that score, within its range.
        explained: share of the removable gap that it explains once refitted; None if it was not.
        held_out_gain: gain of the log score on trajectories left out, in nats; None likewise.
        estimates: its parameters once refitted.
        limit: what its score must pass; 0 where it has none of its own.
    """

    name: str
    title: str
    is_excited: bool
    score: float
    size: float
    explained: float | None = None
    held_out_gain: float | None = None
    estimates: tuple[Estimate, ...] = ()
    limit: float = 0.0


def candidate_of(effect: Effect) -> Candidate:
    """Return an effect that the data do not excite."""
    return Candidate(effect.name, effect.title, False, 0.0, effect.parameters[0].none or 0.0)


@dataclass(frozen=True)
class ResidualPlace:
    """Residuals in one place: RMS in units of their expected deviation.

    Attributes:
        channel, trajectory, phase, region: of the place; the trajectory `ALL` sums over them.
        before, after: RMS with the calibrated twin, and with the named effects.
        low, high: interval of 95 % of `before`, by a bootstrap over trajectories; 0 where there is
            one trajectory alone.
        count: observables in it.
    """

    channel: str
    trajectory: str
    phase: str
    region: str
    before: float
    after: float
    low: float
    high: float
    count: int


@dataclass(frozen=True)
class ShearGap:
    """What a trajectory shows as a whole of shear, or of what is left after it.

    Attributes:
        name, unit: of the quantity.
        trajectory: that shows it.
        measured, before, after: its values, the latter with the calibrated twin and with the named
            effects.
        deviation: that is expected where no effect is missing.
    """

    name: str
    unit: str
    trajectory: str
    measured: float
    before: float
    after: float
    deviation: float


@dataclass(frozen=True)
class ChannelGap:
    """A channel's RMS on the held-out trajectories, in its own unit.

    Attributes:
        channel, unit: "skin" in m, "force" in N, "image" in grey levels.
        before, recalibrated, after: RMS of measured minus simulated with the twin as it was, once
            recalibrated, and with the named effects.
        floor: what noise and discretisation alone leave.
    """

    channel: str
    unit: str
    before: float
    recalibrated: float
    after: float
    floor: float


@dataclass(frozen=True)
class UserGap:
    """What the named effects do for a user, on the held-out trajectories.

    Attributes:
        channel, unit: "image" in dB (peak signal-to-noise ratio), "force" in N, "skin" in mm (RMS
            error).
        before, recalibrated: with the twin as it was, and once recalibrated.
        after: with the named effects; None where none is.
        floor: what noise and discretisation alone leave; None where it is not known.
    """

    channel: str
    unit: str
    before: float
    recalibrated: float
    after: float | None
    floor: float | None


@dataclass(frozen=True)
class WorstFrame:
    """The frame with the largest residual before.

    Attributes:
        trajectory, frame, stamp_s: which.
        rest_m, measured_m, before_m, after_m: (V, 3) skins as lists; empty without skin.
        force_measured_n, force_before_n, force_after_n: (3,); empty without force.
    """

    trajectory: str
    frame: int
    stamp_s: float
    rest_m: list[list[float]]
    measured_m: list[list[float]]
    before_m: list[list[float]]
    after_m: list[list[float]]
    force_measured_n: list[float]
    force_before_n: list[float]
    force_after_n: list[float]


@dataclass(frozen=True)
class Pair:
    """Two effects that the protocols hardly distinguish.

    Attributes:
        first, second: their names.
        cosine: rho of their signatures.
        separation: d = delta sqrt((1 - |rho|) / 2).
        remedy: what to record to separate them.
        best_trajectory, best_per_s: the one that separates them most in a second of the robot's
            time, and by how much; repeat it to separate them.
    """

    first: str
    second: str
    cosine: float
    separation: float
    remedy: str
    best_trajectory: str = ""
    best_per_s: float = 0.0


@dataclass(frozen=True)
class Explanation:
    """What may still explain the presses.

    Attributes:
        name: of an effect, of two that act together joined by "+", "no_gap" or "unknown".
        title: the same within a sentence.
        weight: its probability among all that are listed, by the present data.
    """

    name: str
    title: str
    weight: float


APART_NATS = 2.3
"""From this distance on two explanations are told apart: with an error of at most 5 %."""


@dataclass(frozen=True)
class Question:
    """A trajectory to record next.

    Attributes:
        name: for its bag; one of this name is searched, never held out.
        indenter: name of what presses.
        path: where, how deep and how fast, in words.
        seconds: of the robot's time, the way there included.
        information_nats: that it gives, at least, of which explanation is right, next to the
            questions before it.
        apart_nats: how far the most probable explanation and each other one, by name, expect
            different recordings: the Bhattacharyya distance of this question alone.
        stamp_s: (F,) from its begin.
        poses: (F, 7) of the indenter, base frame: position in m, quaternion with the scalar last.
    """

    name: str
    indenter: str
    path: str
    seconds: float
    information_nats: float
    apart_nats: dict[str, float]
    stamp_s: list[float]
    poses: list[list[float]]

    @property
    def separates(self) -> list[str]:
        """Names of the explanations that it tells from the most probable one."""
        return [name for name, nats in self.apart_nats.items() if nats >= APART_NATS]


@dataclass(frozen=True)
class TileGap:
    """Residuals in one tile of the image: RMS of its observables in expected deviations.

    Attributes:
        x, y: its centre, shares of the image's width and height.
        before, after: with the twin as it is, and with the named effects.
    """

    x: float
    y: float
    before: float
    after: float


@dataclass(frozen=True)
class OpticalFindings:
    """What was found in the images.

    Attributes:
        verdict, sentence: the answer, and in words.
        named, alternatives: effects that are added, and those not distinguished from the first.
        statistic, threshold: the largest score, and what 1 - alpha of data without any effect stay
            below.
        explained: share of what could be removed that the best effects take away.
        excess, largest_excess: mean square of the whitened residuals without effects, and what
            1 - alpha of data without any effect stay below.
        candidates: in the order of their rank; the score is the statistic, `explained` is of the
            signature at the probe.
        gap: of the tiles' colours on the held-out trajectories, in grey levels.
        psnr_db: of their images with the twin as it was, with the camera's gain and black level
            fitted, and with the named effects, those of skin and force too; empty in older records.
        share_closed, share_closed_low, share_closed_high: of the gap of all observables of tiles,
            in expected deviations, with its interval; None if nothing was added.
        stability: share of bootstrap repetitions that gave the same name, or one of the set; None
            if nothing was named.
        tiles: where in the image the gap is.
        warnings: what cannot be concluded, and why.
        trajectories, locked: names used for the search, and held out.
        frame_count: images.
        noise_source: where the thresholds come from.
        not_tried: effects whose sizes in images without any effect are not known.
    """

    verdict: Verdict
    sentence: str
    named: tuple[str, ...] = ()
    alternatives: tuple[str, ...] = ()
    statistic: float = 0.0
    threshold: float = 0.0
    explained: float = 0.0
    excess: float = 0.0
    largest_excess: float = 0.0
    candidates: tuple[Candidate, ...] = ()
    gap: ChannelGap | None = None
    psnr_db: tuple[float, ...] = ()
    share_closed: float | None = None
    share_closed_low: float | None = None
    share_closed_high: float | None = None
    stability: float | None = None
    tiles: tuple[TileGap, ...] = ()
    warnings: tuple[str, ...] = ()
    trajectories: tuple[str, ...] = ()
    locked: tuple[str, ...] = ()
    frame_count: int = 0
    noise_source: str = ""
    not_tried: tuple[str, ...] = ()


@dataclass(frozen=True)
class Findings:
    """The whole result.

    Attributes:
        verdict: the answer.
        sentence: the answer in words.
        named: effects that are added to the model; several where several act.
        alternatives: effects that the data cannot distinguish from the first named one.
        statistic, threshold, alpha: the largest score, what 1 - alpha of data without any effect
            stay below, and alpha.
        p_value: share of simulated nulls with a larger score.
        mode: "absolute" or "differential".
        candidates: in the order of their rank.
        calibrated: the nuisances as fitted, with their prior's range of 95 % as `low` to `high`.
        places: where the gap is.
        shear: slides and unloadings as a whole, what is farthest off first.
        gaps: by channel on the held-out trajectories; on all where none is held out.
        share_closed, share_closed_low, share_closed_high: of the gap, with its interval; None if
            nothing was added.
        fallback: of an unknown effect, the gaps of the held-out trajectories with a smooth
            correction that is not physics in place of effects; empty otherwise.
        stability: share of bootstrap repetitions that gave the same name, or one of the set; of
            what too few of them gave to be named, too; None where nothing came so near.
        pairs: effects that cannot be distinguished.
        worst: the worst frame.
        warnings: what cannot be concluded, and why.
        trajectories, locked: names used for the search, and held out.
        solve_count, seconds: the cost.
        data_hash: of the measured data.
        sensor: name of the sensor's file.
        explanations: what may still explain the presses, the most probable first; empty where it
            was not asked for, or the answer is sure.
        questions: what to record next, the most information in a second first; empty likewise.
        optical: findings in the images, whose names, sentence and warnings are among those above;
            None where none were searched.
    """

    verdict: Verdict
    sentence: str
    named: tuple[str, ...] = ()
    alternatives: tuple[str, ...] = ()
    statistic: float = 0.0
    threshold: float = 0.0
    alpha: float = 0.02
    p_value: float = 1.0
    mode: str = "absolute"
    candidates: tuple[Candidate, ...] = ()
    calibrated: tuple[Estimate, ...] = ()
    places: tuple[ResidualPlace, ...] = ()
    shear: tuple[ShearGap, ...] = ()
    gaps: tuple[ChannelGap, ...] = ()
    share_closed: float | None = None
    share_closed_low: float | None = None
    share_closed_high: float | None = None
    fallback: tuple[ChannelGap, ...] = ()
    stability: float | None = None
    pairs: tuple[Pair, ...] = ()
    worst: WorstFrame | None = None
    warnings: tuple[str, ...] = ()
    trajectories: tuple[str, ...] = ()
    locked: tuple[str, ...] = ()
    solve_count: int = 0
    seconds: float = 0.0
    data_hash: str = ""
    sensor: str = ""
    explanations: tuple[Explanation, ...] = ()
    questions: tuple[Question, ...] = ()
    optical: OpticalFindings | None = None

    def user_gaps(self) -> tuple[UserGap, ...]:
        """Return what a user gains, by channel, in the units that users think in."""
        gaps = []
        if self.optical is not None and self.optical.psnr_db:
            before, alone, after = self.optical.psnr_db
            gaps.append(UserGap("image", "dB", before, alone, after if self.named else None, None))
        own = () if self.optical is None else self.optical.named
        is_added = any(name not in own for name in self.named)
        for gap in self.gaps:
            unit, scale = ("mm", 1e3) if gap.unit == "m" else (gap.unit, 1.0)
            stages = [scale * one for one in (gap.before, gap.recalibrated, gap.after, gap.floor)]
            before, alone, after, floor = stages
            gaps.append(
                UserGap(gap.channel, unit, before, alone, after if is_added else None, floor)
            )
        return tuple(gaps)


def as_record(findings: Findings) -> dict[str, Any]:
    """Return findings as what JSON can hold, with `user_gaps` as a table."""
    record = {"version": VERSION, **asdict(findings), "verdict": findings.verdict.value}
    record["user_gaps"] = [asdict(gap) for gap in findings.user_gaps()]
    if findings.optical is not None:
        record["optical"] = {
            **record["optical"],
            "verdict": findings.optical.verdict.value,
        }
    return record


def findings_of(record: Mapping[str, Any]) -> Findings:
    """Return findings that `as_record` turned into a record; what an older one lacks is absent.

    Raises:
        ValueError: a record of another version.
    """
    if record.get("version") != VERSION:
        raise ValueError(f"findings of version {record.get('version')!r}, expected {VERSION}")
    found: Findings = _read(Findings, record)
    return found


def _read(kind: Any, value: Any) -> Any:
    """Return a value of an annotated type from what `asdict` and JSON make of it."""
    if get_origin(kind) is tuple:
        return tuple(_read(get_args(kind)[0], one) for one in value)
    if get_origin(kind) is UnionType:
        return None if value is None else _read(get_args(kind)[0], value)
    if isinstance(kind, type) and is_dataclass(kind):
        types = get_type_hints(kind)
        return kind(**{name: _read(types[name], value[name]) for name in types if name in value})
    return Verdict(value) if kind is Verdict else value
