# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The report of a search for a gap: its images and numbers. `params/gap/report.j2` has its words,
in the order in which a reader asks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dotsim_ros.effects.effect import Effect
from dotsim_ros.effects.overlay import Estimate
from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import Candidate, Findings, OpticalFindings, Verdict
from dotsim_ros.gap.report.figures import (
    place_images,
    quantity,
    ranking,
    shown,
    shown_unit,
    tile_images,
    user_gap_image,
    worst_frame,
)
from dotsim_ros.io.page import template_files

TEMPLATE = "gap/report.j2"
LABELS = {
    Verdict.NO_GAP: ("No gap", "#2b7a4b"),
    Verdict.NAMED: ("Effect named", "#1763b6"),
    Verdict.SET: ("Effects that cannot be distinguished", "#a8610a"),
    Verdict.UNKNOWN: ("Unknown effect", "#7a3ea1"),
    Verdict.UNUSABLE: ("Data cannot be used", "#b3261e"),
}
CLOSED_RATIO = 1.2
"""A channel whose RMS is at most this many floors has no detectable gap left."""
_STRONGEST_PLACES = 6
_MOST_WARNINGS_FIRST = 5
"""Many warnings would push what was found off the first screen, which then counts them."""

Rows = list[tuple[str, ...]]


def report_files(
    findings: Findings, provenance: Mapping[str, str], effects: Mapping[str, Effect]
) -> dict[str, bytes]:
    """Return the files of the report by name: `report.html`, `report.md` and its images.

    Args:
        findings: what was found.
        provenance: of the figures.
        effects: the library, by name: units of predicted sizes, and what excites an effect. Those
            that it does not hold are shown without.
    """
    own = findings.optical
    gel = _without_images(findings)
    label, colour = LABELS[findings.verdict]
    galleries = {
        "user_gaps": user_gap_image(findings.user_gaps()),
        "images": tile_images(own),
        "places": place_images(gel),
        "worst": [] if gel.worst is None else worst_frame(gel.worst, with_after=bool(gel.named)),
        "ranking": ranking(gel),
    }
    candidates = (*findings.candidates, *(() if own is None else own.candidates))
    titles = {name: effect.title for name, effect in effects.items()}
    titles |= {one.name: one.title for one in findings.candidates}
    return template_files(
        TEMPLATE,
        [image for images in galleries.values() for image in images],
        whole=findings,
        f=gel,
        own=own,
        label=label,
        colour=colour,
        provenance=provenance,
        galleries=galleries,
        is_unusable=findings.verdict is Verdict.UNUSABLE,
        warns_first=len(findings.warnings) <= _MOST_WARNINGS_FIRST or not findings.candidates,
        most_warnings_first=_MOST_WARNINGS_FIRST,
        closed_ratio=CLOSED_RATIO,
        likely=decision.LIKELY,
        stable_share=decision.STABLE_SHARE,
        remaining=_remaining(gel),
        place_rows=_place_rows(gel),
        shear_rows=_shear_rows(gel),
        pair_rows=_pair_rows(gel),
        explanation_rows=[(one.title, _percent(one.weight)) for one in gel.explanations],
        question_rows=_question_rows(gel),
        silent_rows=[
            (c.title, effects[c.name].protocol if c.name in effects else "see the effect's file")
            for c in candidates
            if not c.is_excited
        ],
        not_tried_rows=[
            (titles.get(name, name), name) for name in (() if own is None else own.not_tried)
        ],
        candidate_rows=lambda f: _candidate_rows(f, effects),
        force_rows=_force_rows,
        titles=lambda names: ", ".join(titles.get(name, name) for name in names),
        number=lambda value: f"{value:.3g}",
        percent=_percent,
        quantity=quantity,
        duration=lambda seconds: (
            f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} min"
        ),
        estimates=lambda candidate: ", ".join(map(_with_range, candidate.estimates)),
        with_prior=lambda estimate: _with_range(estimate, "prior "),
    )


def _without_images(f: Findings) -> Findings:
    """Return findings whose names are those of skin and force alone."""
    if f.optical is None:
        return f
    own = f.optical
    return replace(
        f,
        named=tuple(name for name in f.named if name not in own.named),
        alternatives=tuple(name for name in f.alternatives if name not in own.alternatives),
    )


def _candidate_rows(f: Findings | OpticalFindings, effects: Mapping[str, Effect]) -> Rows:
    """Return the effects that were tried, best first; limits and held-out gains are those of skin
    and force alone."""
    tried = [candidate for candidate in f.candidates if candidate.is_excited]
    rows = []
    for rank, c in enumerate(tried, start=1):
        role = ", cannot be distinguished from it" if c.name in f.alternatives else ""
        role = ", added" if c.name in f.named else role
        gain = "-" if c.held_out_gain is None else f"{c.held_out_gain:+.3g} nats"
        rows.append(
            (
                f"{rank}. {c.title} ({c.name}){role}",
                f"{c.score:.3g}" + (f" / {c.limit:.3g}" if c.limit else ""),
                _size(c, effects),
                _percent(c.explained),
                *((gain,) if isinstance(f, Findings) else ()),
                "; ".join(map(_with_range, c.estimates)) or "-",
            )
        )
    return rows


def _size(candidate: Candidate, effects: Mapping[str, Effect]) -> str:
    effect = effects.get(candidate.name)
    first = effect.parameters[0] if effect is not None else next(iter(candidate.estimates), None)
    if first is None:
        return f"{candidate.size:.3g}"
    return f"{_name(first.name, first.unit)} {quantity(candidate.size, first.unit)}"


def _force_rows(f: Findings) -> Rows:
    assert f.worst is not None
    forces = {"measured": f.worst.force_measured_n, "before": f.worst.force_before_n}
    if f.named:
        forces["after"] = f.worst.force_after_n
    return [(name, _force(force)) for name, force in forces.items()]


def _force(force_n: list[float]) -> str:
    """Return a force, (3,) or empty, as numbers."""
    if not force_n:
        return "-"
    parts = ", ".join(f"{component:.2f}" for component in force_n)
    return f"({parts}), {np.linalg.norm(force_n):.2f} in size"


def _pair_rows(f: Findings) -> Rows:
    return [
        (
            f"{pair.first} and {pair.second}",
            f"{pair.cosine:+.3f}",
            f"{pair.separation:.2g}",
            pair.remedy,
            pair.best_trajectory or "-",
        )
        for pair in f.pairs
    ]


def _question_rows(f: Findings) -> Rows:
    titles = {one.name: one.title for one in f.explanations}
    return [
        (
            one.name,
            one.indenter,
            one.path,
            f"{one.seconds:.0f} s",
            f"{one.information_nats:.2g}",
            f"{60.0 * one.information_nats / one.seconds:.2g}",
            ", ".join(titles[name] for name in one.separates) or "-",
        )
        for one in f.questions
    ]


def _remaining(f: Findings) -> Sequence[tuple[object, float, float]]:
    """Return each channel, its RMS that is left, and how many floors that is."""
    left = [(gap, gap.after if f.named else gap.recalibrated) for gap in f.gaps if gap.floor > 0.0]
    return [(gap, value, value / gap.floor) for gap, value in left]


def _shear_rows(f: Findings) -> Rows:
    return [
        (
            one.name,
            one.trajectory,
            *(
                quantity(value, one.unit)
                for value in (
                    one.measured,
                    one.before,
                    *((one.after,) if f.named else ()),
                    one.deviation,
                )
            ),
        )
        for one in f.shear[:_STRONGEST_PLACES]
    ]


def _place_rows(f: Findings) -> Rows:
    parts = sorted(f.places, key=lambda p: p.after if f.named else p.before, reverse=True)
    return [
        (
            f"{p.channel}, {p.region}, {p.phase}",
            p.trajectory,
            f"{p.before:.2g}" + (f" ({p.low:.2g} to {p.high:.2g})" if p.high > 0.0 else ""),
            *((f"{p.after:.2g}",) if f.named else ()),
            str(p.count),
        )
        for p in parts[:_STRONGEST_PLACES]
    ]


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100.0 * share:.0f} %"


def _with_range(estimate: Estimate, range_name: str = "") -> str:
    """Return a fitted number with its interval."""
    low, high = (f"{shown(end, estimate.unit):.3g}" for end in (estimate.low, estimate.high))
    value = f"{shown(estimate.value, estimate.unit):.3g}"
    name, unit = _name(estimate.name, estimate.unit), shown_unit(estimate.unit)
    return f"{name} = {value} ({range_name}{low} to {high}) {unit}".rstrip()


def _name(name: str, unit: str) -> str:
    """Return a parameter's name without its SI unit, which may not be the one that is shown."""
    return name.removesuffix(f"_{unit.replace('/', '_').lower()}")
