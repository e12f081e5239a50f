"""The blind study of the gap finder: measured presses in which nothing is missing, hidden effects
added by other laws, and the finder's rule on many draws of them.

The presses are `sensor_a`'s, made by an independent finite-element solver; the discrepancy that the
finder knows comes from one half of them, the cases from the other. A hidden effect changes a press
by what its law makes of our own gel. The rule is applied to screened effects, without refits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.calibration.parameters import values_of
from dotsim_ros.calibration.simulation import GelSimulator, SolveError
from dotsim_ros.evaluation.gap_null import residuals_without_effect
from dotsim_ros.evaluation.provenance import provenance
from dotsim_ros.gap import decision
from dotsim_ros.gap.assumptions import ABSOLUTE
from dotsim_ros.gap.covariance import Discrepancy, Noise, fit_discrepancy
from dotsim_ros.gap.evidence import Case, Variant, make_trajectories
from dotsim_ros.gap.findings import Verdict
from dotsim_ros.gap.inference import fit, lengths
from dotsim_ros.gap.library import load_effects
from dotsim_ros.gap.measurement import read_measurement
from dotsim_ros.gap.observables import PATCH_COUNT, observe
from dotsim_ros.gap.search import Request, Search, answer_of, null_gains, screen, simulate_effects
from dotsim_ros.gap.simulate import open_solver
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.geometry.specification import SensorSpecification
from dotsim_ros.hidden.laws import LAWS
from dotsim_ros.hidden.reality import Truth, library_names
from dotsim_ros.hidden.reality import answer_of as reality_of
from dotsim_ros.measured.data_set import read_data_set
from dotsim_ros.sensor import skin_of

Array = NDArray[np.float64]

CASE_SIZE = 8
"""Trajectories of a case."""
STIFFNESS_DECOY = 0.05
NULL_DRAWS = 60
"""Simulated nulls of a case: fewer than a search takes."""
SHARES = (0.25, 0.5, 1.0)
"""Of a law's full size."""
UNKNOWN = ""


@dataclass(frozen=True)
class StudyCase:
    """A drawn case and what the finder made of it.

    Attributes:
        truth: names of laws and shares of their full sizes.
        verdict, named, alternatives: the finder's.
        whitened_size: of the hidden change, nuisances projected out.
    """

    truth: tuple[tuple[str, float], ...]
    verdict: Verdict
    named: tuple[str, ...]
    alternatives: tuple[str, ...]
    whitened_size: float

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
        return set(self.named) == self.hidden


def halves(names: Sequence[str], seed: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return two halves of the trajectories: for the discrepancy, and for the cases; repeats of one
    protocol go to both."""
    random = np.random.default_rng(seed)
    groups: dict[str, list[str]] = {}
    for name in sorted(names):
        groups.setdefault(name.rstrip("0123456789").rstrip("_"), []).append(name)
    first, second = [], []
    for members in groups.values():
        random.shuffle(members)
        half = len(members) // 2
        first += members[:half]
        second += members[half:]
    return tuple(sorted(first)), tuple(sorted(second))


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
    by_name = {r.name: (r, e) for r, e in zip(measurement.recordings, residuals, strict=True)}
    discrepancy = fit_discrepancy(
        [by_name[n][0] for n in known], [by_name[n][1] for n in known], f"{len(known)} presses"
    )
    recordings = [by_name[n][0] for n in tested]
    library, values = load_effects(), values_of(sensor)
    with open_solver(sensor, measurement.skin, run, workers=workers) as solver:
        trajectories, left_out = make_trajectories(
            recordings,
            (),
            values=values,
            nuisances=ABSOLUTE,
            library=library,
            solver=solver,
            skin=measurement.skin,
            noise=Noise(),
            discrepancy=discrepancy,
            channels=("skin", "force"),
            progress=lambda done, total: progress("calibrate", done, total),
        )
        rest_m = measurement.skin.rest_position_m
        case = Case(trajectories, ABSOLUTE, library, solver, values, rest_m)
        request = Request(directory, sensor, run, budget=0, seed=seed)
        search = _search(case, range(len(trajectories)), request, seed, progress, discrepancy)
        variants, _ = simulate_effects(search)
        solves = solver.solve_count
    changes = _hidden_changes(case, sensor, measurement.skin, laws, run, seed, progress)
    found = _cases(case, variants, changes, request, nulls, repeats, seed, progress, discrepancy)
    return {
        **figures(found),
        "trajectories": {"discrepancy": list(known), "cases": list(tested)},
        "left_out": left_out,
        "solves": solves,
        "seed": seed,
        "rule_version": decision.RULE_VERSION,
        "provenance": provenance(),
    }


def _search(
    case: Case,
    chosen: Sequence[int],
    request: Request,
    seed: int,
    progress: Callable[[str, int, int], None],
    discrepancy: Discrepancy,
) -> Search:
    evidence = case.evidence(chosen)
    base = fit(evidence, np.zeros((len(evidence.residual), 0)))
    random = np.random.default_rng(seed)
    return Search(
        request=request,
        case=case,
        chosen=list(chosen),
        locked=[],
        evidence=evidence,
        base=base,
        noise=Noise(),
        discrepancy=discrepancy,
        random=random,
        progress=progress,
        solver=case.solver,
    )


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
    simulator = GelSimulator(sensor, skin, tolerance_m=5.0e-6)
    values = values_of(sensor)
    result: dict[str, list[Array]] = {}
    total = len(laws) * len(case.trajectories)
    for place, name in enumerate(laws):
        law = LAWS[name]
        size = law.high if law.name not in ("slippery", "compressible") else law.low
        changes = []
        for number, t in enumerate(case.trajectories):
            stored = run / f"law_{name}_{t.recording.name}_{seed}.npy"
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
                    seed=seed + number,
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
    variants: Sequence[Variant],
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
    for _ in range(4 * repeats):
        first, second = random.choice(known, size=2, replace=False).tolist()
        truths.append(((first, 1.0), (second, 1.0)))
    result = []
    for number, truth in enumerate(truths):
        result.append(_decide(case, variants, changes, request, truth, random, discrepancy))
        progress("cases", number + 1, len(truths))
    return result


def _decide(
    case: Case,
    variants: Sequence[Variant],
    changes: Mapping[str, Sequence[Array]],
    request: Request,
    truth: tuple[tuple[str, float], ...],
    random: np.random.Generator,
    discrepancy: Discrepancy,
) -> StudyCase:
    count = len(case.trajectories)
    chosen = sorted(random.choice(count, size=min(CASE_SIZE, count), replace=False).tolist())
    stiffer = 1.0 + STIFFNESS_DECOY * random.standard_normal()
    trajectories = []
    for number, t in enumerate(case.trajectories):
        hidden = sum((share * changes[name][number] for name, share in truth), 0.0 * t.predicted)
        observed = t.observed + hidden
        observed[:, 3 * PATCH_COUNT :] *= stiffer
        trajectories.append(replace(t, observed=observed))
    altered = case.with_trajectories(trajectories)
    search = _search(altered, chosen, request, int(random.integers(2**31)), _silent, discrepancy)
    gains, pattern_gains = null_gains(search, screen(search, variants), NULL_DRAWS)
    answer = answer_of(search, screen(search, variants), gains, pattern_gains)
    size = 0.0
    if truth:
        change = [
            sum((share * changes[name][k] for name, share in truth), 0.0 * t.predicted)
            for k, t in enumerate(case.trajectories)
        ]
        size = float(lengths(search.evidence, altered.whitened(change, chosen)[:, None])[0])
    return StudyCase(
        truth,
        answer.verdict,
        tuple(entry.effect.name for entry in answer.named),
        tuple(entry.effect.name for entry in answer.alternatives),
        size,
    )


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
        "one_of_two": _rate([bool(set(c.named) & c.hidden) for c in pairs]),
        "wrong_in_pairs": _rate([bool(set(c.named) - c.hidden) for c in pairs]),
        "confusion": confusion,
        "set_share": _rate([c.verdict is Verdict.SET for c in single]),
    }


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
