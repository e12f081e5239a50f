"""The blind study of the gap finder: measured presses in which nothing is missing, hidden effects
added by other laws, and the finder's rule on many draws of them.

The presses are `sensor_a`'s, made by an independent finite-element solver; the discrepancy that the
finder knows comes from one half of them, the cases from the other. A hidden effect changes a press
by what its law makes of our own gel. The rule is applied to effects that are simulated at several
sizes beforehand, for all cases at once, in place of the refits that a search makes for its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.calibration.parameters import GelValues, values_of
from dotsim_ros.calibration.simulation import GelSimulator, Simulated, SolveError
from dotsim_ros.evaluation.gap_baselines import Left, lasso_name, left_on_others
from dotsim_ros.evaluation.gap_limits import detection_limits
from dotsim_ros.evaluation.gap_null import discrepancy_of_half, residuals_without_effect
from dotsim_ros.evaluation.provenance import provenance
from dotsim_ros.evaluation.split import repeats_of
from dotsim_ros.gap import decision
from dotsim_ros.gap.answer import answer_of, null_gains, screen, set_limits
from dotsim_ros.gap.assumptions import ABSOLUTE, DIFFERENTIAL, Nuisance
from dotsim_ros.gap.certainty import estimates_of
from dotsim_ros.gap.covariance import Discrepancy, Noise
from dotsim_ros.gap.evidence import Case, Variant, make_trajectories
from dotsim_ros.gap.findings import Verdict
from dotsim_ros.gap.inference import lengths
from dotsim_ros.gap.library import load_effects
from dotsim_ros.gap.measurement import read_measurement
from dotsim_ros.gap.observables import PATCH_COUNT, observe
from dotsim_ros.gap.search import simulate_effects
from dotsim_ros.gap.search_state import Ranked, Request, Search
from dotsim_ros.gap.simulate import TOLERANCE_M, open_solver
from dotsim_ros.gel.material import PronySeries
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.geometry.specification import SensorSpecification
from dotsim_ros.hidden.laws import LAWS, Law
from dotsim_ros.hidden.reality import Truth, library_names, part_names
from dotsim_ros.hidden.reality import answer_of as reality_of
from dotsim_ros.measured.data_set import read_data_set
from dotsim_ros.sensor import skin_of

Array = NDArray[np.float64]

CASE_SIZE = 8
"""Trajectories of a case."""
STIFFNESS_DECOY = 0.05
NULL_DRAWS = 60
"""Simulated nulls of a case: fewer than a search takes."""
LIMIT_DRAWS = 60
LIMIT_SEARCHES = 5
PAIRS = 12
"""For each repeat."""
SHARES = (0.25, 0.5, 1.0)
"""Of a law's full size."""
GRID = (0.15, 0.3, 0.6, 1.0)
"""Sizes at which effects are simulated, as shares of the way from none to each end of the range."""
CLOSE = 0.2
"""A size that is nearer to one that is simulated, as a share of it, is left out."""
UNKNOWN = ""


@dataclass(frozen=True)
class StudyCase:
    """A drawn case and what the finder made of it.

    Attributes:
        truth: names of laws and shares of their full sizes.
        verdict, named, alternatives: the finder's.
        whitened_size: of the hidden change, nuisances projected out.
        least_size: the same of the smallest of its parts.
        left: on trajectories that were not searched.
        lasso: effect that the lasso names.
        screening: effect that screening alone names.
        found: size of the effect and its interval, and the hidden one's, where the library has the
            same law and found it.
    """

    truth: tuple[tuple[str, float], ...]
    verdict: Verdict
    named: tuple[str, ...]
    alternatives: tuple[str, ...]
    whitened_size: float
    least_size: float
    left: Left
    lasso: str | None
    screening: str | None
    found: tuple[float, float, float, float] | None = None

    @property
    def hidden(self) -> set[str]:
        """Names of the library for what is hidden."""
        return library_names(Truth(self.truth))

    @property
    def is_right(self) -> bool:
        """Return whether the answer is right: the effect named, or in a set of two."""
        if not self.truth:
            return self.verdict is Verdict.NO_GAP
        if self.hidden == {UNKNOWN}:
            return self.verdict is Verdict.UNKNOWN
        if self.verdict is Verdict.SET and len(self.alternatives) == 1:
            return bool(self.hidden & {*self.named, *self.alternatives})
        return set(self.named) - self.parts == self.hidden

    @property
    def parts(self) -> set[str]:
        """Names of the library for further parts of what is hidden."""
        return part_names(Truth(self.truth))


def halves(names: Sequence[str], seed: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return two halves of the trajectories: for the discrepancy, and for the cases; repeats of one
    protocol go to both."""
    random = np.random.default_rng(seed)
    first, second = [], []
    for members in repeats_of(names).values():
        random.shuffle(members)
        half = len(members) // 2
        first += members[:half]
        second += members[half:]
    return tuple(sorted(first)), tuple(sorted(second))


@dataclass(frozen=True)
class _Study:
    """Presses without an effect, and what the library's effects do to them.

    Attributes:
        known, tested: names of the trajectories of the discrepancy, and of the cases.
        discrepancy: as the finder knows it.
        case: of all trajectories to draw from.
        variants: of the effects that they excite.
        screened: the same at the sizes of a search's first look alone.
        left_out: what could not be solved.
        skin: whose points were measured.
    """

    known: tuple[str, ...]
    tested: tuple[str, ...]
    discrepancy: Discrepancy
    case: Case
    variants: list[Variant]
    screened: list[Variant]
    left_out: list[str]
    skin: SkinMesh


@contextmanager
def _study(
    directory: Path,
    sensor: SensorSpecification,
    run: Path,
    seed: int,
    workers: int,
    progress: Callable[[str, int, int], None],
    nuisances: Sequence[Nuisance] = ABSOLUTE,
) -> Iterator[_Study]:
    names = [entry.name for entry in read_data_set(directory).entries]
    known, tested = halves(names, seed)
    measurement = read_measurement(directory, own_skin=skin_of(sensor.gel))
    residuals = residuals_without_effect(
        measurement,
        sensor,
        run,
        workers=workers,
        progress=lambda done, total: progress("discrepancy", done, total),
    )
    discrepancy = discrepancy_of_half(measurement.recordings, residuals, known)
    by_name = {recording.name: recording for recording in measurement.recordings}
    library, values = load_effects(), values_of(sensor)
    with open_solver(sensor, measurement.skin, run, workers=workers) as solver:
        recordings = [by_name[n] for n in tested]
        trajectories, left_out = make_trajectories(
            recordings,
            # The same presses are their own commissioning: nothing has changed since.
            recordings if nuisances is DIFFERENTIAL else (),
            values=values,
            nuisances=nuisances,
            library=library,
            solver=solver,
            skin=measurement.skin,
            noise=Noise(),
            discrepancy=discrepancy,
            channels=("skin", "force"),
            progress=lambda done, total: progress("calibrate", done, total),
        )
        rest_m = measurement.skin.rest_position_m
        case = Case(trajectories, nuisances, library, solver, values, rest_m)
        request = Request(directory, sensor, run, budget=0, seed=seed)
        search = _search(case, range(len(trajectories)), request, seed, progress, discrepancy)
        variants, _ = simulate_effects(search)
        screened = [replace(v, node=list(v.node), change=list(v.change)) for v in variants]
        case.extend(
            [(v, size) for v in variants for size in further_sizes(v)],
            progress=lambda done, total: progress("sizes", done, total),
        )
        yield _Study(
            known, tested, discrepancy, case, variants, screened, left_out, measurement.skin
        )


def further_sizes(variant: Variant) -> list[float]:
    """Return sizes to simulate beside those that are."""
    parameter = variant.effect.parameters[0]
    sizes: list[float] = []
    for end in (parameter.low, parameter.high):
        for share in GRID:
            size = variant.absent + share * (end - variant.absent)
            known = [node for node in (*variant.node, *sizes) if node != variant.absent]
            away = abs(size - variant.absent)
            if away > 0.0 and all(abs(size - node) > CLOSE * away for node in known):
                sizes.append(size)
    return sizes


def with_limits(
    discrepancy: Discrepancy,
    directory: Path,
    sensor: SensorSpecification,
    run: Path,
    *,
    seed: int,
    workers: int = 2,
    progress: Callable[[str, int, int], None],
) -> Discrepancy:
    """Return covariances with what presses in which nothing is missing show: by how much each
    effect gains more on them than all gain on simulated ones, and how badly they fit; the 98th
    percentiles of draws of eight presses.

    Args:
        discrepancy: of the whole data set.
        directory, sensor, run, seed, workers, progress: as `run_study`.
    """
    random = np.random.default_rng([seed, 2])
    gains: dict[str, list[float]] = {}
    simulated: list[float] = []
    misfits: list[float] = []
    with _study(directory, sensor, run, seed, workers, progress) as study:
        count = len(study.case.trajectories)
        request = Request(directory, sensor, run, budget=0, seed=seed)
        for draw in range(LIMIT_DRAWS):
            chosen = sorted(random.choice(count, min(CASE_SIZE, count), replace=False).tolist())
            search = _search(study.case, chosen, request, draw, _silent, study.discrepancy)
            ranked = screen(search, study.variants)
            misfits.append(search.base.objective / len(search.evidence.residual))
            for entry in ranked:
                gains.setdefault(entry.effect.name, []).append(entry.trial.gain)
            simulated += null_gains(search, ranked, NULL_DRAWS // 6)[0].tolist()
            progress("limits", draw + 1, LIMIT_DRAWS)
    threshold = float(np.quantile(simulated, 0.98))
    factors = {
        name: round(max(0.0, float(np.quantile(found, 0.98))) / threshold, 2)
        for name, found in sorted(gains.items())
    }
    misfit = round(float(np.quantile(misfits, 0.98)), 4)
    return replace(discrepancy, limit_factors=factors, misfit_limit=misfit)


def run_study(
    directory: Path,
    sensor: SensorSpecification,
    run: Path,
    *,
    nulls: int,
    repeats: int,
    seed: int,
    laws: Sequence[str] = tuple(LAWS),
    workers: int = 2,
    progress: Callable[[str, int, int], None],
) -> dict[str, Any]:
    """Return the study's figures.

    Args:
        directory: data set in which nothing is missing.
        sensor: calibrated to it.
        run: folder of the solves.
        nulls: cases without an effect.
        repeats: cases of each law and size.
        seed: of all draws.
        laws: that are hidden.
        workers: processes.
        progress: told each step's share.
    """
    with _study(directory, sensor, run, seed, workers, progress) as study:
        case, discrepancy = study.case, study.discrepancy
        variants = study.variants, study.screened
        solves = case.solver.solve_count
    limits = {"absolute": _limits(study, sensor, run, seed, progress)}
    with _study(directory, sensor, run, seed, workers, progress, DIFFERENTIAL) as study:
        limits["differential"] = _limits(study, sensor, run, seed, progress)
    request = Request(directory, sensor, run, budget=0, seed=seed)
    changes = _hidden_changes(case, sensor, study.skin, laws, run, seed, progress)
    found = _cases(case, variants, changes, request, nulls, repeats, seed, progress, discrepancy)
    return {
        **figures(found),
        "trajectories": {"discrepancy": list(study.known), "cases": list(study.tested)},
        "detection_limits": limits,
        "left_out": study.left_out,
        "solves": solves,
        "seed": seed,
        "rule_version": decision.RULE_VERSION,
        "provenance": provenance(),
    }


def _limits(
    study: _Study,
    sensor: SensorSpecification,
    run: Path,
    seed: int,
    progress: Callable[[str, int, int], None],
) -> dict[str, dict[str, Any]]:
    """Return the detection limits of draws of eight presses."""
    random = np.random.default_rng([seed, 3])
    trajectories = study.case.trajectories
    request = Request(run, sensor, run, budget=0, seed=seed)

    def draw(number: int) -> Search:
        names = sorted({t.recording.name for t in trajectories})
        drawn = set(random.choice(names, min(CASE_SIZE, len(names)), replace=False).tolist())
        chosen = [k for k, t in enumerate(trajectories) if t.recording.name in drawn]
        progress("detection limits", number + 1, LIMIT_SEARCHES)
        return _search(study.case, chosen, request, number, _silent, study.discrepancy)

    return detection_limits((draw(number) for number in range(LIMIT_SEARCHES)), study.variants)


def _search(
    case: Case,
    chosen: Sequence[int],
    request: Request,
    seed: int,
    progress: Callable[[str, int, int], None],
    discrepancy: Discrepancy,
) -> Search:
    return Search(
        request=request,
        case=case,
        chosen=list(chosen),
        locked=[],
        noise=Noise(),
        discrepancy=discrepancy,
        random=np.random.default_rng(seed),
        progress=progress,
    )


class _Remembering(GelSimulator):
    """Solves nothing twice: many laws act on what the same gel answers to the same poses."""

    def __init__(self, specification: SensorSpecification, skin: SkinMesh) -> None:
        super().__init__(specification, skin, tolerance_m=TOLERANCE_M)
        self._known: dict[str, Simulated] = {}

    def press(
        self,
        values: GelValues,
        indenter: Indenter,
        poses: Sequence[Pose],
        stamp_s: Array,
        offset: Array | None = None,
        *,
        relaxation: PronySeries | None = None,
    ) -> Simulated:
        """Return as `GelSimulator.press`."""
        places = [(p.position_m.tolist(), p.quaternion_xyzw.tolist()) for p in poses]
        key = repr((values, indenter.name, relaxation, stamp_s.tolist(), offset, places))
        if key not in self._known:
            self._known[key] = super().press(
                values, indenter, poses, stamp_s, offset, relaxation=relaxation
            )
        return self._known[key]


def full_size(law: Law) -> float:
    """Return the size at the end of a law's range that is farthest from nothing."""
    return law.low if law.name in ("slippery", "compressible") else law.high


def _hidden_changes(
    case: Case,
    sensor: SensorSpecification,
    skin: SkinMesh,
    laws: Sequence[str],
    run: Path,
    seed: int,
    progress: Callable[[str, int, int], None],
) -> dict[str, list[Array]]:
    """Return by law, at the upper end of its range, what it does to each trajectory (F, SIZE)."""
    simulator = _Remembering(sensor, skin)
    values = values_of(sensor)
    result: dict[str, list[Array]] = {}
    total = len(laws) * len(case.trajectories)
    for place, name in enumerate(laws):
        size = full_size(LAWS[name])
        changes = []
        for number, t in enumerate(case.trajectories):
            stored = run / f"law_{name}_{t.recording.name}_unit_{seed}.npy"
            if stored.is_file():
                changes.append(np.load(stored))
                continue
            press = t.recording.press
            try:
                moved, force = reality_of(
                    simulator,
                    values,
                    t.recording.indenter,
                    press,
                    Truth(((name, size),)),
                    session_s=t.recording.session_s,
                    seed=seed,
                    number=number,
                )
            except SolveError:
                changes.append(np.zeros_like(t.predicted))
                continue
            shown = observe(
                t.places, simulator.skin.rest_position_m, moved, force, press.frame_count
            )
            changes.append(shown - t.predicted)
            np.save(stored, changes[-1])
            progress("hide", place * len(case.trajectories) + number + 1, total)
        result[name] = changes
    return result


def _cases(
    case: Case,
    variants: tuple[Sequence[Variant], Sequence[Variant]],
    changes: Mapping[str, Sequence[Array]],
    request: Request,
    nulls: int,
    repeats: int,
    seed: int,
    progress: Callable[[str, int, int], None],
    discrepancy: Discrepancy,
) -> list[StudyCase]:
    random = np.random.default_rng([seed, 1])
    truths: list[tuple[tuple[str, float], ...]] = [()] * nulls
    truths += [((name, share),) for name in changes for share in SHARES for _ in range(repeats)]
    known = [name for name in changes if LAWS[name].library]
    for _ in range(PAIRS * repeats):
        first, second = random.choice(known, size=2, replace=False).tolist()
        truths.append(((first, 1.0), (second, 1.0)))
    result = []
    for number, truth in enumerate(truths):
        result.append(_decide(case, variants, changes, request, truth, random, discrepancy))
        progress("cases", number + 1, len(truths))
    return result


def _decide(
    case: Case,
    variants: tuple[Sequence[Variant], Sequence[Variant]],
    changes: Mapping[str, Sequence[Array]],
    request: Request,
    truth: tuple[tuple[str, float], ...],
    random: np.random.Generator,
    discrepancy: Discrepancy,
) -> StudyCase:
    count = len(case.trajectories)
    chosen = sorted(random.choice(count, size=min(CASE_SIZE, count), replace=False).tolist())
    stiffer = 1.0 + STIFFNESS_DECOY * random.standard_normal()
    hidden = [
        sum((share * changes[name][k] for name, share in truth), np.zeros_like(t.predicted))
        for k, t in enumerate(case.trajectories)
    ]
    trajectories = []
    for t, change in zip(case.trajectories, hidden, strict=True):
        observed = t.observed + change
        observed[:, 3 * PATCH_COUNT :] *= stiffer
        trajectories.append(replace(t, observed=observed))
    altered = case.with_trajectories(trajectories)
    search = _search(altered, chosen, request, int(random.integers(2**31)), _silent, discrepancy)
    ranked, looked_at = (screen(search, each) for each in variants)
    # As a search does: before it refines the sizes of the best.
    gains, pattern_gains = null_gains(search, looked_at, NULL_DRAWS)
    set_limits(search, looked_at, gains)
    first = looked_at[0]
    lasso = lasso_name(search, ranked)
    answer = answer_of(search, ranked, gains, pattern_gains)
    others = [number for number in range(count) if number not in chosen]

    def size_of(change: Sequence[Array]) -> float:
        return float(lengths(search.evidence, altered.whitened(change, chosen)[:, None])[0])

    parts = [size_of([share * part for part in changes[name]]) for name, share in truth]
    return StudyCase(
        truth,
        answer.verdict,
        tuple(entry.effect.name for entry in answer.named),
        tuple(entry.effect.name for entry in answer.alternatives),
        size_of(hidden),
        min(parts, default=0.0),
        left_on_others(search, answer.named, others, case),
        lasso,
        first.effect.name if first.is_past_limit else None,
        _found(search, answer.named, truth),
    )


def _found(
    search: Search, named: Sequence[Ranked], truth: tuple[tuple[str, float], ...]
) -> tuple[float, float, float, float] | None:
    """Return value, interval and truth where the library's own law was hidden whole and named."""
    if len(truth) != 1 or len(named) != 1 or truth[0][1] != 1.0:
        return None
    law, effect = LAWS[truth[0][0]], named[0].effect
    if law.known_size is None or effect.name != law.library:
        return None
    estimate = estimates_of(search, named[0], [])[0]
    return estimate.value, estimate.low, estimate.high, law.known_size(full_size(law))


def _silent(step: str, done: int, total: int) -> None:
    """Tell nothing."""


def figures(cases: Sequence[StudyCase]) -> dict[str, Any]:
    """Return what is published of the cases."""
    nulls = [c for c in cases if not c.truth]
    single = [c for c in cases if len(c.truth) == 1 and c.hidden != {UNKNOWN}]
    unknown = [c for c in cases if len(c.truth) == 1 and c.hidden == {UNKNOWN}]
    pairs = [c for c in cases if len(c.truth) == 2]
    false = [c for c in nulls if c.verdict is not Verdict.NO_GAP]
    named = [c for c in nulls if c.named]
    power = {}
    for low, high in ((0.0, 5.0), (5.0, 10.0), (10.0, 20.0), (20.0, 40.0), (40.0, np.inf)):
        inside = [c for c in single if low <= c.whitened_size < high]
        power[f"{low:g} to {high:g}"] = _rate([c.is_right for c in inside])
    confusion: dict[str, dict[str, int]] = {}
    for c in single + unknown:
        row = confusion.setdefault(c.truth[0][0], {})
        answer = "+".join(c.named) if c.named else c.verdict.value
        row[answer] = row.get(answer, 0) + 1
    return {
        "nulls": {
            "cases": len(nulls),
            "false_names": _rate([bool(c.named) for c in nulls]),
            "false_alarms": _rate([c.verdict is not Verdict.NO_GAP for c in nulls]),
            "wrong_names": sorted({name for c in named for name in c.named}),
            "verdicts": [c.verdict.value for c in false],
        },
        "named_right_by_whitened_size": power,
        "named_right_by_law": {
            name: _rate([c.is_right for c in single if c.truth[0][0] == name])
            for name in dict.fromkeys(c.truth[0][0] for c in single)
        },
        "unknown_called_unknown": _rate([c.is_right for c in unknown if c.whitened_size > 10.0]),
        "both_of_two": _rate([c.is_right for c in pairs]),
        "both_of_two_from_10": _rate([c.is_right for c in pairs if c.least_size >= 10.0]),
        "one_of_two": _rate([bool(set(c.named) & c.hidden) for c in pairs]),
        "wrong_in_pairs": _rate([bool(set(c.named) - c.hidden - c.parts) for c in pairs]),
        "after_adding": _after_adding([c for c in single + pairs if c.named]),
        "same_law": _same_law([c.found for c in single if c.found is not None]),
        "baselines": _baselines(nulls, single),
        "confusion": confusion,
        "set_share": _rate([c.verdict is Verdict.SET for c in single]),
    }


def _after_adding(cases: Sequence[StudyCase]) -> dict[str, Any]:
    """Return what named effects leave of trajectories that were not searched."""
    return {
        "within_1.2_of_the_floor": _rate(
            [c.left.with_effects <= 1.2**2 * c.left.nothing_hidden for c in cases]
        ),
        "worse_than_recalibrated": _rate(
            [c.left.with_effects > 1.001 * c.left.recalibrated for c in cases]
        ),
        "median_share_closed": _median([_share_closed(c.left, c.left.with_effects) for c in cases]),
    }


def _share_closed(left: Left, now: float) -> float | None:
    """Return the share of the gap on trajectories not searched that is closed, None without one."""
    gap = left.recalibrated - left.nothing_hidden
    return (left.recalibrated - now) / gap if gap > 0.2 * left.nothing_hidden else None


def _same_law(found: Sequence[tuple[float, float, float, float]]) -> dict[str, Any]:
    return {
        "median_relative_error": _median([abs(value / true - 1.0) for value, _, _, true in found]),
        "interval_covers": _rate([low <= true <= high for _, low, high, true in found]),
    }


def _baselines(nulls: Sequence[StudyCase], single: Sequence[StudyCase]) -> dict[str, Any]:
    large = [c for c in single if c.whitened_size >= 20.0]
    return {
        "lasso": {
            "false_names": _rate([c.lasso is not None for c in nulls]),
            "named_right_from_20": _rate([c.lasso in c.hidden for c in large]),
        },
        "screening": {
            "false_names": _rate([c.screening is not None for c in nulls]),
            "named_right_from_20": _rate([c.screening in c.hidden for c in large]),
        },
        "ours": {
            "false_names": _rate([bool(c.named) for c in nulls]),
            "named_right_from_20": _rate([c.is_right for c in large]),
        },
        "median_share_closed_from_20": {
            "recalibration": 0.0,
            "black_box": _median([_share_closed(c.left, c.left.black_box) for c in large]),
            "ours": _median([_share_closed(c.left, c.left.with_effects) for c in large]),
        },
    }


def _median(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return round(float(np.median(known)), 4) if known else None


def _rate(outcomes: Sequence[bool]) -> dict[str, float | int | None]:
    """Return a share with Wilson's interval of 95 % (Wilson 1927)."""
    n = len(outcomes)
    if n == 0:
        return {"share": None, "low": None, "high": None, "of": 0}
    p, z = sum(outcomes) / n, 1.96
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return {
        "share": round(p, 4),
        "low": round(float(centre - half), 4),
        "high": round(float(centre + half), 4),
        "of": n,
    }
