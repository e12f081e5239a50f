# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The scale of the force gauge, where known weights give it: they alone decide whether it is wrong,
and the presses are searched with forces that are right."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from dotsim_ros.data.data_set import DataSet, read_data_set
from dotsim_ros.data.known_weight import ForceScale, combined_scale, read_weight
from dotsim_ros.data.measurement import Measurement
from dotsim_ros.effects.effect import FORCE, Effect
from dotsim_ros.effects.overlay import Estimate, FoundEffect, Overlay
from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import Candidate, Findings, Verdict
from dotsim_ros.gap.presses.search_state import GapRequest
from dotsim_ros.gap.report import wording

EFFECT = "force_scale"


def weighed_scale(request: GapRequest) -> tuple[ForceScale | None, list[str]]:
    """Return the scale that known weights give a request's forces, None where none can be used, and
    what was left out. In differential mode it is the scale over that of the commissioning.

    Raises:
        FileNotFoundError, ValueError: as `read_data_set`.
    """
    if FORCE not in request.channels:
        return None, []
    scale, warnings = _scale_of(request.measured)
    if scale is None or request.reference is None:
        return scale, warnings
    before, more = _scale_of(request.reference)
    warnings += more
    if before is None:
        text = (
            f"the known weight ({', '.join(scale.names)}) was not used: the commissioning has "
            "none, so how its gauge read is not known; weigh at each commissioning, or search "
            "without --reference"
        )
        return None, [*warnings, text]
    return scale.over(before), warnings


def _scale_of(data: Path | DataSet) -> tuple[ForceScale | None, list[str]]:
    scales, warnings = [], []
    for entry in read_data_set(data).weights:
        try:
            scales.append(read_weight(entry))
        except (FileNotFoundError, ValueError) as error:
            warnings.append(f"the weight {entry.name} was left out: {error}")
    return (combined_scale(scales) if scales else None), warnings


def is_wrong(scale: ForceScale) -> bool:
    """Return whether a gauge's scale is another than 1."""
    return abs(scale.scale - 1.0) > decision.APART * scale.deviation


def with_right_forces(measurement: Measurement, scale: ForceScale) -> Measurement:
    """Return a data set with the forces that its gauge should have read; those of a gauge that is
    right stay as they are."""
    digest = hashlib.sha256(f"{measurement.digest} {scale}".encode()).hexdigest()[:16]
    measurement = replace(measurement, digest=digest)
    if not is_wrong(scale):
        return measurement
    recordings = tuple(
        r
        if r.press.force_n is None
        else replace(r, press=replace(r.press, force_n=r.press.force_n / scale.scale))
        for r in measurement.recordings
    )
    return replace(measurement, recordings=recordings)


def without_scale(
    request: GapRequest, library: Mapping[str, Effect], scale: ForceScale | None
) -> GapRequest:
    """Return a request that does not look for the scale, where weights give it."""
    if scale is None:
        return request
    wanted = request.candidates or [n for n, e in library.items() if e.image is None]
    others = tuple(name for name in wanted if name != EFFECT)
    # No candidate at all would be every effect; there is no gap of the scale left to be found.
    return replace(request, candidates=others or (EFFECT,))


def with_scale(
    findings: Findings, overlay: Overlay | None, scale: ForceScale, effect: Effect
) -> tuple[Findings, Overlay]:
    """Return what was found in presses, and the wrong scale that weights give."""
    reach = 1.96 * scale.deviation
    estimate = Estimate("scale", "", scale.scale, scale.scale - reach, scale.scale + reach)
    candidate = Candidate(
        EFFECT,
        effect.title,
        True,
        ((scale.scale - 1.0) / scale.deviation) ** 2,
        scale.scale,
        estimates=(estimate,),
        limit=decision.SAME,
    )
    others = [c for c in findings.candidates if c.name != EFFECT]
    findings = replace(
        findings,
        verdict=Verdict.SET if findings.verdict is Verdict.SET else Verdict.NAMED,
        sentence=(
            f"{effect.title} is missing, by the known weight ({', '.join(scale.names)}): "
            f"{wording.shown(estimate)}; the presses were searched with forces divided by it. "
            f"{findings.sentence}"
        ).strip(),
        named=(*findings.named, EFFECT),
        candidates=(*others, candidate),
        # Weights are no trajectories: what was doubted of the presses is in the sentence.
        stability=findings.stability if findings.named else None,
    )
    effects = () if overlay is None else overlay.effects
    found = FoundEffect(EFFECT, (estimate,))
    return findings, Overlay(findings.sensor, findings.data_hash, (*effects, found))
