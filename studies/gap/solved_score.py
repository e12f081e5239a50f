# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The whole gap finder on sets that `python -m studies hide` made: each searched once, then its
truth opened and compared."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from dotsim_ros.gap.demo import sealed_text
from dotsim_ros.gap.find import find_gap
from dotsim_ros.gap.findings import Findings, as_record, findings_of
from dotsim_ros.gap.presses.covariance import FILE as SHIPPED
from dotsim_ros.io.documents import read_json
from dotsim_ros.io.files import cache_directory, parameter_path, write_json
from dotsim_ros.io.progress import PrintedProgress
from dotsim_ros.io.provenance import provenance
from dotsim_ros.io.worker_pool.pool import Crew, crew
from dotsim_ros.specification import SensorSpecification, load_sensor
from studies.gap.rates import median, rate
from studies.hidden.solved_draw import NULL, OUTSIDE, PAIR, SINGLE, truth_of
from studies.hidden.solved_sets import TRUTH, SetRecord, read_series

FINDINGS = "findings.json"
KINDS = (NULL, SINGLE, PAIR, OUTSIDE)
LEARNT_SINCE = {"slipping_core": "lost_bond"}
"""Laws that truths were sealed with as unknown, and that the library has an effect for by now: a
gel that slides on its core about the apex has come off it there."""
UNFINISHED = 6
"""A set with fewer trajectories than this is not searched."""


@dataclass(frozen=True)
class ScoreRequest:
    """What to score.

    Attributes:
        sets: folder that `python -m studies hide` made.
        half: of the sets.
        sensor: the twin, as declared.
        run: folder of the searches; those of before are not made again.
        workers: of a search.
        discrepancy: file of the twin's own error; None for the shipped one.
    """

    sets: Path
    half: str
    sensor: SensorSpecification
    run: Path
    workers: Crew = 2
    discrepancy: Path | None = None

    def asked(self) -> str:
        """Return a digest of what a search is given next to its set."""
        error = self.discrepancy or parameter_path(SHIPPED)
        asked = repr(self.sensor).encode() + error.read_bytes()
        return hashlib.sha256(asked).hexdigest()


def gap_physics(
    *,
    sets: Path = Path("data/hidden_17"),
    half: Literal["development", "opened"] = "development",
    sensor: str = "data/hidden_17/sensor_a.yaml",
    discrepancy: Path = Path("data/hidden_17/discrepancy.npz"),
    workers: int = 1,
    ray_address: str | None = None,
    cache: Path | None = None,
) -> dict[str, Any]:
    """The whole gap finder on sets whose hidden effects finite elements solved.

    Args:
        sets: folder that `python -m studies hide` made; each set is searched once.
        half: of the sets; the other one is to be opened once, when nothing is changed any more.
        sensor: name or file of the twin.
        discrepancy: file of the twin's own error, as `python -m studies gap_discrepancy` writes it.
        workers: processes, or workers of the Ray cluster, at most.
        ray_address: HOST:PORT of the head of a Ray cluster, auto or local (none).
        cache: folder of the searches made before (the user's cache).

    Raises:
        FileNotFoundError, ValueError: as `score_sets`.
    """
    request = ScoreRequest(
        sets,
        half,
        load_sensor(sensor),
        cache or cache_directory() / "gap_physics" / sets.resolve().name,
        crew(workers, ray_address),
        discrepancy,
    )
    return {"halves": {half: score_sets(request)}}


def score_sets(request: ScoreRequest) -> dict[str, Any]:
    """Search the sets of a half that are ready, and return the figures.

    Raises:
        FileNotFoundError: there are no sets, or a truth is missing.
        ValueError: none of the half is ready, or a truth is not the one that was sealed.
    """
    index, records = read_series(request.sets)
    if index["sensor"] != request.sensor.name:
        raise ValueError(
            f"{request.sets} holds units of {index['sensor']}, the twin is "
            f"{request.sensor.name}; give --sensor {index['sensor']}"
        )
    of_half = [record for record in records if record.half == request.half]
    ready = [record for record in of_half if record.is_ready]
    if not ready:
        raise ValueError(
            f"{request.sets} holds no set of the half {request.half!r} that is ready; make them "
            "with python -m studies hide"
        )
    rows = []
    for record in ready:
        rows.append(_row(request, record))
        shown = rows[-1]
        print(
            f"{shown['set']}: {shown['outcome']} ({' '.join(shown['named']) or shown['verdict']})"
        )
    return {
        "half": request.half,
        "series": {key: index[key] for key in ("version", "seed", "count", "sensor", "coarseness")}
        | {"made_at": index["provenance"]["commit"], "calculix": index["calculix"]},
        "not_ready": len(of_half) - len(ready),
        "failed_trajectories": {
            f"{record.name}/{name}": reason
            for record in ready
            for name, reason in record.failures.items()
        },
        "sets": rows,
        "rates": rates_of(rows),
    }


def _row(request: ScoreRequest, record: SetRecord) -> dict[str, Any]:
    """Search a set, or take what a search before has found, and judge it."""
    row: dict[str, Any] = {
        "set": record.name,
        "truth_sha256": record.truth_sha256,
        "trajectories": len(record.made),
    }
    findings = None
    if len(record.made) >= UNFINISHED:
        findings, row["searched_at"] = _findings(request, record)
    truth = opened_truth(request.sets, record)
    row |= {"kind": kind_of(truth), "hidden": truth["effects"], "decoys": truth["decoys"]}
    if findings is None:
        return row | {"outcome": "too few trajectories", "verdict": "unusable", "named": []}
    return row | judged(findings, truth)


def opened_truth(sets: Path, record: SetRecord) -> dict[str, Any]:
    """Return what is wrong with a set; to be called after its search.

    Raises:
        ValueError: it is not what was sealed.
    """
    path = sets / record.name / TRUTH
    return truth_of(sealed_text(path, record.truth_sha256, "make the set again"))


def _findings(request: ScoreRequest, record: SetRecord) -> tuple[Findings, str]:
    """Return what a search finds, and the commit at which it was made."""
    folder = request.run / record.name
    kept = folder / FINDINGS
    key = {
        "truth_sha256": record.truth_sha256,
        "made": list(record.made),
        "asked": request.asked(),
    }
    if kept.is_file():
        before = read_json(kept)
        if isinstance(before, dict) and all(before.get(k) == value for k, value in key.items()):
            return findings_of(before["findings"]), str(before["commit"])
    found = find_gap(
        request.sets / record.name,
        sensor=request.sensor,
        out=folder / "report",
        workers=request.workers,
        discrepancy=request.discrepancy,
        progress=PrintedProgress(),
    )
    commit = provenance()["commit"]
    write_json(kept, key | {"commit": commit, "findings": as_record(found)})
    return found, commit


def _library_names(truth: Mapping[str, Any]) -> set[str]:
    """Return the names that the library has for what is hidden; "" for what it does not know."""
    return {
        effect["library"] or LEARNT_SINCE.get(effect["name"], "") for effect in truth["effects"]
    }


def kind_of(truth: Mapping[str, Any]) -> str:
    """Return the kind of a set as the library is now."""
    kind = str(truth["kind"])
    return SINGLE if kind == OUTSIDE and "" not in _library_names(truth) else kind


def judged(findings: Findings, truth: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the finder answered next to what was hidden, and what the answer is worth.

    Args:
        findings: of a set.
        truth: of it, as `truth_of` reads it.
    """
    hidden = _library_names(truth)
    named, verdict = list(findings.named), findings.verdict.value
    sizes = {
        effect["library"]: effect["against_twin"]
        for effect in truth["effects"]
        if effect["against_twin"] is not None
    }
    estimates = []
    for candidate in findings.candidates:
        if candidate.name in named and candidate.name in sizes and candidate.estimates:
            first, true = candidate.estimates[0], sizes[candidate.name]
            estimates.append(
                {
                    "name": candidate.name,
                    "parameter": first.name,
                    "true": true,
                    "found": first.value,
                    "low": first.low,
                    "high": first.high,
                    "covers": bool(first.low <= true <= first.high),
                }
            )
    return {
        "verdict": verdict,
        "named": named,
        "alternatives": list(findings.alternatives),
        "statistic": findings.statistic,
        "threshold": findings.threshold,
        "nearest": [candidate.name for candidate in findings.candidates[:3]],
        "estimates": estimates,
        "share_closed": findings.share_closed,
        "stability": findings.stability,
        "seconds": findings.seconds,
        "outcome": outcome_of(verdict, named, findings.alternatives, hidden),
    }


def outcome_of(
    verdict: str, named: Sequence[str], alternatives: Sequence[str], hidden: set[str]
) -> str:
    """Return what an answer is worth.

    Args:
        verdict: of the findings.
        named, alternatives: names in it.
        hidden: names that the library has for what is hidden; "" for what it does not know.
    """
    if verdict == "unusable":
        return "refused"
    if not hidden:
        return {"no_gap": "right", "unknown": "called unknown"}.get(verdict, "false name")
    if verdict == "no_gap":
        return "missed"
    if verdict == "unknown":
        return "right" if "" in hidden else "called unknown"
    answered = set(named)
    if answered and answered == hidden and verdict == "named":
        return "right"
    if verdict == "set" and hidden & {*named, *alternatives}:
        return "in the set"
    if answered & hidden:
        return "one of two" if answered < hidden else "with a wrong one"
    return "wrong name"


def rates_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return shares over the sets, by kind."""

    def share(kind: str, *outcomes: str) -> dict[str, Any]:
        return rate([row["outcome"] in outcomes for row in rows if row["kind"] == kind])

    estimates = [estimate for row in rows for estimate in row.get("estimates", ())]
    return {
        "nulls_right": share(NULL, "right"),
        "nulls_with_a_name": share(NULL, "false name"),
        "single_right": share(SINGLE, "right"),
        "single_right_or_in_the_set": share(SINGLE, "right", "in the set"),
        "single_wrong_name": share(SINGLE, "wrong name", "with a wrong one"),
        "pairs_both": share(PAIR, "right"),
        "pairs_one_at_least": share(PAIR, "right", "one of two", "in the set", "with a wrong one"),
        "pairs_wrong_name": share(PAIR, "wrong name", "with a wrong one"),
        "outside_called_unknown": share(OUTSIDE, "right"),
        "intervals_that_cover": rate([estimate["covers"] for estimate in estimates]),
        "median_share_closed": median([row.get("share_closed") for row in rows]),
    }
