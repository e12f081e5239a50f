# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The power analysis of the gap finder: measured presses in which nothing is missing, hidden
effects added by other laws, and the finder's rule on many draws of them.

The presses are `sensor_a`'s, made by an independent finite-element solver. All that the finder
knows of presses without an effect comes from one half of them, the cases from the other; then the
halves change places. A hidden effect changes a press by what its law makes of our own gel. The rule
is applied to effects that are simulated at several sizes beforehand, for all cases at once, in
place of the refits that a search makes for its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import Verdict
from dotsim_ros.gap.presses.answer import answer_of, null_gains, screen, set_limits
from dotsim_ros.gap.presses.covariance import Discrepancy
from dotsim_ros.gap.presses.inference import cosines, lengths
from dotsim_ros.gap.presses.observables import PATCH_COUNT, observe
from dotsim_ros.gap.presses.search_state import Search
from dotsim_ros.gel.material import PronySeries
from dotsim_ros.gel.values import GelValues, values_of
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.cache import PHYSICS, content_key, load_arrays, store_arrays
from dotsim_ros.io.documents import ArrayForm
from dotsim_ros.io.files import short_name
from dotsim_ros.io.worker_pool.pool import crew
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.follow import SimulatedPress, SolveError
from dotsim_ros.twin.simulator import GelSimulator
from dotsim_ros.twin.solver import TOLERANCE_M
from studies.data import SENSOR_A
from studies.gap.baselines import Left, bic_name, lasso_name, left_on_others
from studies.gap.discrepancy import calibrated_discrepancy
from studies.gap.limits import detection_limits
from studies.gap.presses import (
    CASE_SIZE,
    NULL_DRAWS,
    Presses,
    Source,
    draw_presses,
    halves,
    open_presses,
    search_of,
    source_of,
)
from studies.gap.rates import clustered_rate, median
from studies.gap.same_law import SameLaw, same_law_cases, same_law_figures
from studies.hidden.laws import LAWS, OTHER_LAWS, HiddenLaw
from studies.hidden.reality import Truth, library_names, part_names
from studies.hidden.reality import answer_of as reality_of
from studies.run import expect_known

STIFFNESS_DECOY = 0.05
LIMIT_SEARCHES = 5
PAIRS = 12
"""Cases with a pair of effects, for each repeat and half."""
DESIGNS = ((0.1, CASE_SIZE), (0.25, CASE_SIZE), (0.5, CASE_SIZE), (1.0, CASE_SIZE), (1.0, 12))
"""Shares of a law's full size, and presses of a case."""
SIZE_CLASSES = (0.0, 5.0, 10.0, 20.0, 40.0, np.inf)
IMITATED = 0.9
"""An effect of the library with a larger cosine explains 80 % of a hidden one: it imitates it."""
UNKNOWN = ""


@dataclass(frozen=True)
class StudyCase:
    """A drawn case and what the finder made of it.

    Attributes:
        truth: names of laws and shares of their full sizes.
        presses: that were drawn.
        verdict, named, alternatives: the finder's.
        whitened_size: of the hidden change, nuisances projected out.
        least_size: the same of the smallest of its parts.
        alike: largest cosine between the hidden change and an effect of the library, as it was
            found, nuisances projected out.
        left: on trajectories that were not searched.
        lasso, bic: effects that the lasso and the Bayesian information criterion name.
        screening: effect that screening alone names.
    """

    truth: tuple[tuple[str, float], ...]
    presses: tuple[str, ...]
    verdict: Verdict
    named: tuple[str, ...]
    alternatives: tuple[str, ...]
    whitened_size: float
    least_size: float
    alike: float
    left: Left
    lasso: str | None
    bic: str | None
    screening: str | None

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
        # Of an offset along some direction any axis may be the largest.
        groups = [library_names(one) | part_names(one) for one in self._each()]
        named = set(self.named)
        return all(named & group for group in groups) and named <= set().union(*groups)

    def _each(self) -> list[Truth]:
        return [Truth((part,)) for part in self.truth]

    @property
    def parts(self) -> set[str]:
        """Names of the library for further parts of what is hidden."""
        return part_names(Truth(self.truth))


def gap(
    *,
    data: Path = SENSOR_A,
    sensor: str = "sensor_a",
    nulls: int = 200,
    repeats: int = 2,
    laws: tuple[str, ...] = tuple(OTHER_LAWS),
    seed: int = 5,
    workers: int = 2,
    ray_address: str | None = None,
    cache: Path | None = None,
) -> dict[str, Any]:
    """Power of the gap finder on effects that are hidden in measured presses.

    Args:
        data: folder of a data set without an effect.
        sensor: name or file of the sensor, calibrated to it.
        nulls: cases without an effect.
        repeats: cases of each law and size, from each half of the presses.
        laws: that are hidden; by default none that is a formula of the library.
        seed: of all draws.
        workers: processes, or workers of the Ray cluster, at most.
        ray_address: HOST:PORT of the head of a Ray cluster, auto or local (none).
        cache: folder of the solves (the user's cache).

    Raises:
        ValueError: no such law.
        SolveError: the gel with a hidden law could not be solved.
    """
    expect_known("law", laws, LAWS)
    source = source_of(data, sensor, cache, crew(workers, ray_address))
    source.run.mkdir(parents=True, exist_ok=True)
    names = [recording.name for recording in source.measurement.recordings]
    first, second = halves(names, seed)
    found: list[StudyCase] = []
    same_law: list[SameLaw] = []
    known: list[Discrepancy] = []
    left_out: list[str] = []
    solves = 0
    limits: dict[str, Any] = {}
    for number, (known_half, tested) in enumerate(((first, second), (second, first))):
        known.append(calibrated_discrepancy(source, known_half, seed))
        with open_presses(source, tested, known[-1]) as presses:
            changes = _hidden_changes(presses, source, laws, seed)
            random = np.random.default_rng([seed, 1, number])
            share = nulls // 2 if number else nulls - nulls // 2
            found += _cases(presses, changes, source, share, repeats, random)
            same_law += same_law_cases(presses, source, random)
            left_out += presses.left_out
            solves += presses.case.solver.solve_count
            if not limits:
                limits["absolute"] = _limits(presses, source, seed)
    with open_presses(source, second, known[0], is_differential=True) as presses:
        limits["differential"] = _limits(presses, source, seed)
    return {
        **figures(found),
        "same_law": same_law_figures(same_law),
        "cases": [_published(case) for case in found],
        "halves": [list(first), list(second)],
        "bias": [dict(one.bias) for one in known],
        "limit_factors": [dict(one.limit_factors) for one in known],
        "detection_limits": limits,
        "left_out": left_out,
        "data_warnings": list(source.measurement.warnings),
        "solves": solves,
        "seed": seed,
        "rule_version": decision.RULE_VERSION,
    }


def _limits(presses: Presses, source: Source, seed: int) -> dict[str, dict[str, Any]]:
    """Return the detection limits of draws of presses."""
    random = np.random.default_rng([seed, 3])
    trajectories = presses.case.trajectories
    names = sorted({t.recording.name for t in trajectories})

    def draw(number: int) -> Search:
        drawn = {names[k] for k in draw_presses(len(names), random)}
        chosen = [k for k, t in enumerate(trajectories) if t.recording.name in drawn]
        source.progress("detection limits", number + 1, LIMIT_SEARCHES)
        return search_of(presses.case, chosen, source.request(seed), number, presses.discrepancy)

    return detection_limits((draw(number) for number in range(LIMIT_SEARCHES)), presses.variants)


class _Remembering(GelSimulator):
    """Solves nothing twice: many laws act on what the same gel answers to the same poses."""

    def __init__(self, specification: SensorSpecification, skin: SkinMesh) -> None:
        super().__init__(specification, skin, tolerance_m=TOLERANCE_M)
        self._known: dict[str, SimulatedPress] = {}

    def press(
        self,
        values: GelValues,
        indenter: Indenter,
        poses: Sequence[Pose],
        stamp_s: FloatArray,
        offset: FloatArray | None = None,
        *,
        relaxation: PronySeries | None = None,
    ) -> SimulatedPress:
        """Return as `GelSimulator.press`."""
        places = [(p.position_m.tolist(), p.quaternion_xyzw.tolist()) for p in poses]
        key = repr((values, indenter.name, relaxation, stamp_s.tolist(), offset, places))
        if key not in self._known:
            self._known[key] = super().press(
                values, indenter, poses, stamp_s, offset, relaxation=relaxation
            )
        return self._known[key]


def full_size(law: HiddenLaw) -> float:
    """Return the size at the end of a law's range that is farthest from nothing."""
    return law.low if law.name in ("slippery", "compressible") else law.high


def _hidden_changes(
    presses: Presses, source: Source, laws: Sequence[str], seed: int
) -> dict[str, list[FloatArray]]:
    """Return by law, at the upper end of its range, what it does to each trajectory (F, SIZE)."""
    case, run = presses.case, source.run
    simulator = _Remembering(source.sensor, presses.skin)
    values = values_of(source.sensor)
    result: dict[str, list[FloatArray]] = {}
    total = len(laws) * len(case.trajectories)
    for place, name in enumerate(laws):
        size = full_size(LAWS[name])
        changes = []
        for number, t in enumerate(case.trajectories):
            press = t.recording.press
            key = content_key(
                (*PHYSICS, "../studies/gap"),
                (source.sensor, presses.skin.rest_position_m, name, size, seed, number),
                (t.recording, t.predicted),
            )
            stored = run / f"law_{name}_{short_name(t.recording.name)}_{key}.npz"
            known = load_arrays(stored, {"change": ArrayForm(t.predicted.shape)})
            if known is not None:
                changes.append(known["change"])
                continue
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
            except SolveError as error:
                raise SolveError(
                    f"{t.recording.name} with the hidden law {name} of {size:g} "
                    f"{LAWS[name].unit} could not be solved ({error}); leave the law out with "
                    "--laws"
                ) from error
            shown = observe(
                t.places, simulator.skin.rest_position_m, moved, force, press.frame_count
            )
            changes.append(shown - t.predicted)
            store_arrays(stored, {"change": changes[-1]})
            source.progress("hide", place * len(case.trajectories) + number + 1, total)
        result[name] = changes
    return result


def _cases(
    presses: Presses,
    changes: Mapping[str, Sequence[FloatArray]],
    source: Source,
    nulls: int,
    repeats: int,
    random: np.random.Generator,
) -> list[StudyCase]:
    planned: list[tuple[tuple[tuple[str, float], ...], int]] = [((), CASE_SIZE)] * nulls
    planned += [
        (((name, share),), size)
        for name in changes
        for share, size in DESIGNS
        for _ in range(repeats)
    ]
    known = [name for name in changes if LAWS[name].library]
    for _ in range(PAIRS * repeats):
        first, second = random.choice(known, size=2, replace=False).tolist()
        planned.append((((first, 1.0), (second, 1.0)), CASE_SIZE))
    result = []
    for number, (truth, size) in enumerate(planned):
        result.append(_decide(presses, changes, source, truth, size, random))
        source.progress("cases", number + 1, len(planned))
    return result


def _decide(
    presses: Presses,
    changes: Mapping[str, Sequence[FloatArray]],
    source: Source,
    truth: tuple[tuple[str, float], ...],
    size: int,
    random: np.random.Generator,
) -> StudyCase:
    case = presses.case
    count = len(case.trajectories)
    chosen = draw_presses(count, random, size)
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
    altered = replace(case, trajectories=trajectories)
    draw = int(random.integers(2**31))
    search = search_of(altered, chosen, source.request(draw), draw, presses.discrepancy)
    ranked, looked_at = (screen(search, each) for each in (presses.variants, presses.screened))
    # As a search does: before it refines the sizes of the best.
    gains, pattern_gains = null_gains(search, looked_at, NULL_DRAWS)
    set_limits(search, looked_at, gains)
    first = looked_at[0]
    lasso = lasso_name(search, ranked)
    answer = answer_of(search, ranked, gains, pattern_gains)
    others = [number for number in range(count) if number not in chosen]

    def size_of(change: Sequence[FloatArray]) -> float:
        return float(lengths(search.evidence, altered.whitened(change, chosen)[:, None])[0])

    columns = [altered.whitened(hidden, chosen), *(entry.trial.change for entry in ranked)]
    alike = float(np.abs(cosines(search.evidence, np.stack(columns, axis=1))[0, 1:]).max())
    parts = [size_of([share * part for part in changes[name]]) for name, share in truth]
    return StudyCase(
        truth,
        tuple(case.trajectories[k].recording.name for k in chosen),
        answer.decision.verdict,
        tuple(entry.effect.name for entry in answer.decision.named),
        tuple(entry.effect.name for entry in answer.decision.alternatives),
        size_of(hidden),
        min(parts, default=0.0),
        alike if truth else 0.0,
        left_on_others(search, answer.decision.named, others, case),
        lasso,
        bic_name(search, ranked),
        first.effect.name if first.is_past_limit else None,
    )


def _published(case: StudyCase) -> dict[str, Any]:
    left = asdict(case.left)
    return {
        "hidden": [list(part) for part in case.truth],
        "presses": list(case.presses),
        "verdict": case.verdict.value,
        "named": list(case.named),
        "alternatives": list(case.alternatives),
        "whitened_size": round(case.whitened_size, 2),
        "alike": round(case.alike, 3),
        "left": {name: round(value, 3) for name, value in left.items()},
    }


def figures(cases: Sequence[StudyCase]) -> dict[str, Any]:
    """Return what is published of the cases."""
    nulls = [c for c in cases if not c.truth]
    single = [c for c in cases if len(c.truth) == 1 and c.hidden != {UNKNOWN}]
    unknown = [c for c in cases if len(c.truth) == 1 and c.hidden == {UNKNOWN}]
    pairs = [c for c in cases if len(c.truth) == 2]
    false = [c for c in nulls if c.verdict is not Verdict.NO_GAP]
    named = [c for c in nulls if c.named]
    power = {
        f"{low:g} to {high:g}": _share(
            [c for c in single if low <= c.whitened_size < high], _is_right
        )
        for low, high in pairwise(SIZE_CLASSES)
    }
    confusion: dict[str, dict[str, int]] = {}
    for c in single + unknown:
        row = confusion.setdefault(c.truth[0][0], {})
        answer = "+".join(c.named) if c.named else c.verdict.value
        row[answer] = row.get(answer, 0) + 1
    return {
        "nulls": {
            "cases": len(nulls),
            "false_names": _share(nulls, lambda c: bool(c.named)),
            "false_alarms": _share(nulls, lambda c: c.verdict is not Verdict.NO_GAP),
            "wrong_names": sorted({name for c in named for name in c.named}),
            "verdicts": [c.verdict.value for c in false],
        },
        "named_right_by_whitened_size": power,
        "named_right_over_all_sizes": _share(single, _is_right),
        "power": _power(single),
        "named_right_by_law": {
            name: _share([c for c in single if c.truth[0][0] == name], _is_right)
            for name in dict.fromkeys(c.truth[0][0] for c in single)
        },
        "unknown_called_unknown": _share([c for c in unknown if c.whitened_size > 10.0], _is_right),
        "unimitated_called_unknown": _share(
            [c for c in unknown if c.whitened_size > 10.0 and c.alike < IMITATED], _is_right
        ),
        "both_of_two": _share(pairs, _is_right),
        "both_of_two_from_10": _share([c for c in pairs if c.least_size >= 10.0], _is_right),
        "one_of_two": _share(pairs, lambda c: bool(set(c.named) & c.hidden)),
        "wrong_in_pairs": _share(pairs, lambda c: bool(set(c.named) - c.hidden - c.parts)),
        "after_adding": _after_adding([c for c in single + pairs if c.named]),
        "baselines": _baselines(nulls, single),
        "confusion": confusion,
        "set_share": _share(single, lambda c: c.verdict is Verdict.SET),
    }


def _is_right(case: StudyCase) -> bool:
    return case.is_right


def _share(
    cases: Sequence[StudyCase], outcome: Callable[[StudyCase], bool]
) -> dict[str, float | int | None]:
    """Return a share of cases, with an interval by press."""
    return clustered_rate([outcome(c) for c in cases], [c.presses for c in cases])


def _power(single: Sequence[StudyCase]) -> dict[str, Any]:
    """Return by law how often it is named at each of its sizes, in its own unit."""
    result: dict[str, Any] = {}
    for name, share in dict.fromkeys(c.truth[0] for c in single):
        law = LAWS[name]
        row = result.setdefault(name, {"unit": law.unit, "sizes": []})
        cases = [c for c in single if c.truth[0] == (name, share)]
        row["sizes"].append(
            {
                "size": share * full_size(law),
                "whitened_size": median([c.whitened_size for c in cases]),
                "named_right": _share(cases, _is_right),
            }
        )
    return result


def _after_adding(cases: Sequence[StudyCase]) -> dict[str, Any]:
    """Return what named effects leave of trajectories that were not searched."""
    return {
        "within_1.2_of_the_floor": _share(
            cases, lambda c: c.left.with_effects <= 1.2**2 * c.left.nothing_hidden
        ),
        "worse_than_recalibrated": _share(
            cases, lambda c: c.left.with_effects > 1.001 * c.left.recalibrated
        ),
        "worse_by_one_percent": _share(
            cases, lambda c: c.left.with_effects > 1.01**2 * c.left.recalibrated
        ),
        "median_share_closed": _median_closed(cases),
        "median_share_closed_single": _median_closed([c for c in cases if len(c.truth) == 1]),
    }


def _median_closed(cases: Sequence[StudyCase]) -> float | None:
    return median([_share_closed(c.left, c.left.with_effects) for c in cases])


def _share_closed(left: Left, now: float) -> float | None:
    """Return the share of the gap on trajectories not searched that is closed, None without one."""
    gap = left.recalibrated - left.nothing_hidden
    return (left.recalibrated - now) / gap if gap > 0.2 * left.nothing_hidden else None


def _baselines(nulls: Sequence[StudyCase], single: Sequence[StudyCase]) -> dict[str, Any]:
    large = [c for c in single if c.whitened_size >= 20.0]
    return {
        "lasso": {
            "false_names": _share(nulls, lambda c: c.lasso is not None),
            "named_right_from_20": _share(large, lambda c: c.lasso in c.hidden),
        },
        "bic": {
            "false_names": _share(nulls, lambda c: c.bic is not None),
            "named_right_from_20": _share(large, lambda c: c.bic in c.hidden),
        },
        "screening": {
            "false_names": _share(nulls, lambda c: c.screening is not None),
            "named_right_from_20": _share(large, lambda c: c.screening in c.hidden),
        },
        "ours": {
            "false_names": _share(nulls, lambda c: bool(c.named)),
            "named_right_from_20": _share(large, _is_right),
        },
        "median_share_closed_from_20": {
            "recalibration": 0.0,
            "black_box": median([_share_closed(c.left, c.left.black_box) for c in large]),
            "ours": _median_closed(large),
        },
    }
