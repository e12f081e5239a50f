# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The sections of a gap's report: what was found, in the order in which a reader asks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from dotsim_ros.effects.effect import Effect
from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import Candidate, Findings, ResidualPlace, Verdict
from dotsim_ros.gap.report.figures import gap_bars, heatmap, ranking, worst_frame
from dotsim_ros.gap.report.images import image_sections
from dotsim_ros.gap.report.places import ALL, by_phase, by_trajectory
from dotsim_ros.gap.report.text import (
    duration,
    estimate_text,
    force_text,
    percent,
    quantity,
    role_text,
    shown_name,
    with_prior_text,
)
from dotsim_ros.io.page import Block, Bullets, Gallery, Page, Paragraph, Section, Table

TITLE = "Gap between simulation and measurement"
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


def page_of(
    findings: Findings, provenance: Mapping[str, str], effects: Mapping[str, Effect]
) -> Page:
    """Return the report.

    Args:
        findings: what was found.
        provenance: of the figures.
        effects: the library, by name: units of predicted sizes, and what excites an effect. Those
            that it does not hold are shown without.
    """
    label, colour = LABELS[findings.verdict]
    # Many warnings would push what was found off the first screen, which then counts them.
    warns_first = len(findings.warnings) <= _MOST_WARNINGS_FIRST or not findings.candidates
    gel = _without_images(findings)
    sections = [
        _at_a_glance(gel, warns_first),
        _warnings(findings) if warns_first else None,
        *(() if findings.optical is None else image_sections(findings.optical, effects)),
        _gaps(gel),
        _where_and_when(gel),
        _worst(gel),
        _candidates(gel, effects),
        _not_apart(gel, effects),
        _remains(gel),
        None if warns_first else _warnings(findings),
        _not_tried(findings, effects),
        _calibrated(findings),
        _cost(findings, provenance),
    ]
    return Page(
        TITLE,
        findings.sentence,
        tuple(section for section in sections if section is not None),
        label,
        colour,
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


def _at_a_glance(f: Findings, warns_first: bool) -> Section | None:
    items = []
    if f.candidates:
        items.append(
            f"Largest score {f.statistic:.3g} against a threshold of {f.threshold:.3g}, which "
            f"{percent(1.0 - f.alpha)} of simulated data without any effect stay below; "
            f"{percent(f.p_value) if f.p_value > 0.0 else 'none'} of them had a larger score."
        )
    for name in f.named:
        candidate = _candidate(f, name)
        if candidate is not None and candidate.estimates:
            estimates = ", ".join(map(estimate_text, candidate.estimates))
            items.append(f"{candidate.title}: {estimates} (95 % intervals).")
    if f.share_closed is not None:
        interval = ""
        if f.share_closed_low is not None and f.share_closed_high is not None:
            interval = f" ({percent(f.share_closed_low)} to {percent(f.share_closed_high)})"
        where = "the held-out trajectories" if f.locked else "the trajectories of the search"
        items.append(
            f"Share of the gap closed on {where}: {percent(f.share_closed)}{interval}, of what "
            "the effects move."
        )
    if f.stability is not None and not f.named:
        items.append(
            f"{percent(f.stability)} of bootstrap repetitions over trajectories ask for what comes "
            f"nearest, expected {percent(decision.LIKELY)} at least to name it."
        )
    elif f.stability is not None:
        stable = "" if f.stability >= decision.STABLE_SHARE else ": the name is not stable"
        items.append(
            f"{percent(f.stability)} of bootstrap repetitions over trajectories give the same "
            f"answer{stable}."
        )
    if f.verdict is not Verdict.UNUSABLE:
        against = {
            "absolute": "simulation against measurement",
            "differential": "these data against those of the reference",
        }
        items.append(f"Mode: {f.mode}, {against.get(f.mode, '')}.".replace(", .", "."))
    if not warns_first:
        items.append(f"{len(f.warnings)} warnings limit what can be concluded: see below.")
    if not items:
        return None
    return Section("At a glance", (Bullets(tuple(items)),), is_half=warns_first)


def _warnings(f: Findings) -> Section | None:
    title = "Warnings: what cannot be concluded"
    if not f.warnings:
        return Section(title, (Paragraph("None."),), is_half=True)
    is_beside = f.verdict is not Verdict.UNUSABLE and len(f.warnings) <= _MOST_WARNINGS_FIRST
    return Section(title, (Bullets(f.warnings),), is_half=is_beside)


def _gaps(f: Findings) -> Section | None:
    if not f.gaps:
        return None
    stages: tuple[str, ...] = ("before", "recalibrated", "after", "floor")
    text = (
        "Measured minus simulated: before, with the twin as it was; recalibrated, with its "
        "constants fitted again; after, with the named effects; floor, what noise and "
        "discretisation alone leave."
    )
    if not f.named:
        stages = ("before", "recalibrated", "floor")
        text = (
            "Measured minus simulated: before, with the twin as it was; recalibrated, with its "
            "constants fitted again; floor, what noise and discretisation alone leave. No effect "
            "was added, so there is no after."
        )
    where = "Held-out trajectories" if f.locked else "Trajectories of the search, none held out"
    blocks = (Gallery(tuple(gap_bars(gap, stages) for gap in f.gaps)), Paragraph(text))
    return Section(f"{where}: before, after and floor", blocks)


def _where_and_when(f: Findings) -> Section | None:
    phases, trajectories = by_phase(f.places), by_trajectory(f.places)
    images = []
    if phases.rows and phases.columns:
        images.append(heatmap(phases, "before", name="phases", title="By phase"))
        if f.named:
            title = "By phase, with the effect"
            images.append(heatmap(phases, "after", name="phases_after", title=title))
    if trajectories.rows and trajectories.columns:
        title = "By trajectory"
        images.append(heatmap(trajectories, "before", name="trajectories", title=title))
    if not images:
        return None
    text = "RMS of the residuals in units of their expected deviation: 1 is noise and "
    text += "discretisation alone. Blank: nothing measured there."
    return Section("Where and when", (Gallery(tuple(images)), Paragraph(text)))


def _worst(f: Findings) -> Section | None:
    if f.worst is None:
        return None
    w = f.worst
    blocks: list[Block] = [
        Paragraph(f"Trajectory {w.trajectory}, frame {w.frame}, {w.stamp_s:.2f} s.")
    ]
    if w.rest_m and w.measured_m and w.before_m:
        blocks.append(Gallery(worst_frame(w, with_after=bool(f.named and w.after_m))))
        blocks.append(
            Paragraph(
                "The skin seen from above, unrolled, +x to the right and +y down. Motion is the "
                "distance from the skin at rest, misfit that of the simulated from the measured."
            )
        )
    else:
        blocks.append(Paragraph("No skin was measured."))
    if w.force_measured_n:
        rows = [("measured", w.force_measured_n), ("before", w.force_before_n)]
        if f.named:
            rows.append(("after", w.force_after_n))
        blocks.append(
            Table(
                ("force on the indenter", "x, y, z, N"),
                tuple((name, force_text(force)) for name, force in rows),
            )
        )
    else:
        blocks.append(Paragraph("No force was measured."))
    return Section("The worst frame", tuple(blocks))


def _candidates(f: Findings, effects: Mapping[str, Effect]) -> Section | None:
    tried = [candidate for candidate in f.candidates if candidate.is_excited]
    if not tried:
        return None
    image = ranking(f)
    head = (
        "effect",
        "score / limit",
        "predicted size",
        "explains",
        "held-out gain",
        "fitted (95 %)",
    )
    rows = tuple(
        (
            f"{rank}. {c.title} ({c.name}){role_text(f, c.name)}",
            f"{c.score:.3g}" + (f" / {c.limit:.3g}" if c.limit else ""),
            _size_text(c, effects),
            percent(c.explained),
            "-" if c.held_out_gain is None else f"{c.held_out_gain:+.3g} nats",
            "; ".join(map(estimate_text, c.estimates)) or "-",
        )
        for rank, c in enumerate(tried, start=1)
    )
    blocks = (
        *((Gallery((image,)),) if image is not None else ()),
        Table(head, rows),
        Paragraph(
            "A score counts from the effect's own limit: what the model's error imitates has a "
            "larger one. Explains: share of the removable gap once "
            "refitted together with the twin's constants. Held-out gain: of the log score on "
            "trajectories that the refit did not see. A dash: not refitted."
        ),
    )
    return Section("Candidates by rank", blocks)


def _size_text(candidate: Candidate, effects: Mapping[str, Effect]) -> str:
    effect = effects.get(candidate.name)
    first = effect.parameters[0] if effect is not None else next(iter(candidate.estimates), None)
    if first is None:
        return f"{candidate.size:.3g}"
    return f"{shown_name(first.name, first.unit)} {quantity(candidate.size, first.unit)}"


def _not_apart(f: Findings, effects: Mapping[str, Effect]) -> Section | None:
    if not f.pairs and not f.alternatives:
        return None
    blocks: list[Block] = []
    if f.alternatives and f.named:
        names = ", ".join(_title(f, name, effects) for name in f.alternatives)
        blocks.append(
            Paragraph(
                f"These data do not distinguish {_title(f, f.named[0], effects)} from: {names}. "
                "The first is in the overlay because it explains most; any of them may be true."
            )
        )
    if f.pairs:
        rows = tuple(
            (
                f"{pair.first} and {pair.second}",
                f"{pair.cosine:+.3f}",
                f"{pair.separation:.2g}",
                pair.remedy,
                pair.best_trajectory or "-",
            )
            for pair in f.pairs
        )
        head = ("pair", "cosine", "separation", "what to record", "most per second")
        blocks.append(Table(head, rows))
        blocks.append(
            Paragraph(
                "Cosine: how alike the signatures of two effects are under these protocols. "
                "Separation: by how many deviations they would differ at the size that was found; "
                "from 3.1 the rank can be trusted. Most per second: of the trajectories that are "
                "there, the one to repeat."
            )
        )
    return Section("What cannot be distinguished", tuple(blocks))


def _title(f: Findings, name: str, effects: Mapping[str, Effect]) -> str:
    candidate = _candidate(f, name)
    if candidate is not None:
        return candidate.title
    return effects[name].title if name in effects else name


def _remains(f: Findings) -> Section | None:
    blocks: list[Block] = []
    lines = []
    for gap in f.gaps:
        left = gap.after if f.named else gap.recalibrated
        if gap.floor > 0.0:
            ratio = left / gap.floor
            seen = "no detectable gap remains" if ratio <= CLOSED_RATIO else "a gap remains"
            lines.append(
                f"{gap.channel}: {quantity(left, gap.unit)}, {ratio:.2f} times the floor: {seen}."
            )
    if lines:
        blocks.append(Bullets(tuple(lines)))
    if f.fallback:
        closest = "; ".join(
            f"{gap.channel} {quantity(gap.recalibrated, gap.unit)} to "
            f"{quantity(gap.after, gap.unit)}"
            for gap in f.fallback
        )
        blocks.append(
            Paragraph(
                "Not physics: a smooth correction by phase and region, fitted next to the twin's "
                f"constants where no effect fits, changes the residual of "
                f"{'the held-out trajectories' if f.locked else 'the trajectories of the search'}: "
                f"{closest}. It is not an effect, it is not in the overlay, and it "
                "does not carry over to other protocols."
            )
        )
    parts = [p for p in f.places if p.count and ALL not in (p.channel, p.phase, p.region)]
    parts.sort(key=lambda p: p.after if f.named else p.before, reverse=True)
    if parts:
        rows = tuple(_place_row(place, bool(f.named)) for place in parts[:_STRONGEST_PLACES])
        head = ("place", "trajectory", "before (95 %)", *(["after"] if f.named else []), "count")
        blocks.append(Table(head, rows))
    return Section("What remains", tuple(blocks)) if blocks else None


def _place_row(p: ResidualPlace, with_after: bool) -> tuple[str, ...]:
    interval = f" ({p.low:.2g} to {p.high:.2g})" if p.high > 0.0 else ""
    return (
        f"{p.channel}, {p.region}, {p.phase}",
        p.trajectory,
        f"{p.before:.2g}{interval}",
        *([f"{p.after:.2g}"] if with_after else []),
        str(p.count),
    )


def _not_tried(f: Findings, effects: Mapping[str, Effect]) -> Section | None:
    blocks: list[Block] = []
    rows = tuple(
        (c.title, effects[c.name].protocol if c.name in effects else "see the effect's file")
        for c in (*f.candidates, *(() if f.optical is None else f.optical.candidates))
        if not c.is_excited
    )
    if rows:
        text = "No trajectory excites these effects: they are neither found nor excluded."
        blocks += [Paragraph(text), Table(("effect", "what to record"), rows)]
    if f.optical is not None and f.optical.not_tried:
        titles = [effects[n].title if n in effects else n for n in f.optical.not_tried]
        text = "The apparent size of these effects in images without any of them is not known, so "
        text += "they are neither found nor excluded. dotsim_ros find-gap --fit-optical-noise FILE "
        text += "estimates it, --optical-noise FILE uses it."
        rows = tuple((title, name) for title, name in zip(titles, f.optical.not_tried, strict=True))
        blocks += [Paragraph(text), Table(("effect", "its file"), rows)]
    return Section("Not tried", tuple(blocks)) if blocks else None


def _calibrated(f: Findings) -> Section | None:
    if not f.calibrated:
        return None
    return Section(
        "Fitted first, so that a wrong constant is not taken for missing physics",
        (Bullets(tuple(map(with_prior_text, f.calibrated))),),
    )


def _cost(f: Findings, provenance: Mapping[str, str]) -> Section:
    items = [
        f"{f.solve_count} solves of a trajectory, {duration(f.seconds)}",
        f"Searched on: {', '.join(f.trajectories) or 'nothing'}",
        f"Held out until the end: {', '.join(f.locked) or 'nothing'}",
        f"Sensor: {f.sensor or 'not named'}; data: {f.data_hash or 'not hashed'}",
        *(f"{name.capitalize()}: {value}" for name, value in provenance.items()),
    ]
    return Section("Cost and provenance", (Bullets(tuple(items)),))


def _candidate(f: Findings, name: str) -> Candidate | None:
    return next((candidate for candidate in f.candidates if candidate.name == name), None)
