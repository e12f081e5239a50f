"""What a search for a gap found: the currency between the search and its report, all plain numbers.

`as_record` and `findings_of` carry it to JSON and back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import Enum
from typing import Any

VERSION = 1


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
class Estimate:
    """A fitted number.

    Attributes:
        name, unit: of the parameter.
        value, low, high: with its interval of 95 %.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float


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
    """

    name: str
    title: str
    is_excited: bool
    score: float
    size: float
    explained: float | None = None
    held_out_gain: float | None = None
    estimates: tuple[Estimate, ...] = ()


@dataclass(frozen=True)
class Place:
    """Residuals in one place: RMS in units of their expected deviation.

    Attributes:
        channel, trajectory, phase, region: of the place; "all" sums over one of them.
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
class ChannelGap:
    """A channel's RMS on the locked trajectories, in its own unit.

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
    """Two effects that the protocols hardly tell apart.

    Attributes:
        first, second: their names.
        cosine: rho of their signatures.
        separation: d = delta sqrt((1 - |rho|) / 2).
        remedy: what to record to separate them.
    """

    first: str
    second: str
    cosine: float
    separation: float
    remedy: str


@dataclass(frozen=True)
class Findings:
    """The whole result.

    Attributes:
        verdict: the answer.
        sentence: the answer in words.
        named: effects that are added to the model; several where several act.
        alternatives: effects that the data cannot tell from the first named one.
        statistic, threshold, alpha: the largest score, what 1 - alpha of data without any effect
            stay below, and alpha.
        p_value: share of simulated nulls with a larger score.
        mode: "absolute" or "differential".
        candidates: in the order of their rank.
        calibrated: the nuisances as fitted, with their prior's centre as `low` to `high`.
        places: where the gap is.
        gaps: by channel on the locked trajectories.
        share_closed, share_closed_low, share_closed_high: of the gap, with its interval; None if
            nothing was added.
        stability: share of bootstrap repetitions that gave the same name; None if nothing was
            named.
        pairs: effects that cannot be told apart.
        worst: the worst frame.
        warnings: what cannot be concluded, and why.
        trajectories, locked: names used for the search, and kept locked.
        solve_count, seconds: the cost.
        data_hash: of the measured data.
        sensor: name of the sensor's file.
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
    places: tuple[Place, ...] = ()
    gaps: tuple[ChannelGap, ...] = ()
    share_closed: float | None = None
    share_closed_low: float | None = None
    share_closed_high: float | None = None
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


def as_record(findings: Findings) -> dict[str, Any]:
    """Return findings as what JSON can hold."""
    return {"version": VERSION, **asdict(findings), "verdict": findings.verdict.value}


def findings_of(record: Mapping[str, Any]) -> Findings:
    """Return findings that `as_record` turned into a record.

    Raises:
        ValueError: a record of another version.
    """
    if record.get("version") != VERSION:
        raise ValueError(f"findings of version {record.get('version')!r}, expected {VERSION}")
    values = {key: value for key, value in record.items() if key != "version"}
    values["verdict"] = Verdict(values["verdict"])
    values["candidates"] = tuple(
        Candidate(**{**c, "estimates": tuple(Estimate(**e) for e in c["estimates"])})
        for c in values["candidates"]
    )
    for name, kind in (
        ("calibrated", Estimate),
        ("places", Place),
        ("gaps", ChannelGap),
        ("pairs", Pair),
    ):
        values[name] = tuple(kind(**entry) for entry in values[name])
    for name in ("named", "alternatives", "warnings", "trajectories", "locked"):
        values[name] = tuple(values[name])
    worst = values["worst"]
    values["worst"] = None if worst is None else WorstFrame(**worst)
    return Findings(**values)
