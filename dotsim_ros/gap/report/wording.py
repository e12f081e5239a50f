# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The findings in words, and what the data do not identify."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dotsim_ros.data.measurement import Measurement, protocol_of
from dotsim_ros.data.recording import Phase
from dotsim_ros.effects.effect import Effect, EffectParameter
from dotsim_ros.effects.overlay import Estimate
from dotsim_ros.gap.findings import ChannelGap, ResidualPlace, Verdict

FEW = 4


@dataclass(frozen=True)
class MadeUp:
    """That the twin's constants make up for what its file is off by.

    Attributes:
        gaps: of the channels in which it is off.
        alone: constants of which each would do, with the stiffness next to it, as well as all
            together, in words; none where no single one would.
        protocols: what to record to tell them, by constant.
    """

    gaps: tuple[ChannelGap, ...]
    alone: tuple[str, ...]
    protocols: tuple[str, ...]


def data_warnings(
    measurement: Measurement, channels: Sequence[str], has_reference: bool
) -> list[str]:
    """Return what a data set does not identify, and what to record for it."""
    recordings = measurement.recordings
    texts = []
    if not any(r.press.force_n is not None for r in recordings) or "force" not in channels:
        texts.append(
            "no force: stiffness, force scale and drift are not identifiable, since the skin does "
            "not depend on the gel's stiffness; record the wrench"
        )
    if not any(r.press.skin_position_m is not None for r in recordings) or "skin" not in channels:
        texts.append(
            "no skin: friction, compressibility and the pose are estimated from the force alone; "
            "record the skin's points where you can"
        )
    protocols = {protocol_of(r) for r in recordings}
    if len(protocols) == 1:
        texts.append(
            f"one protocol only ({next(iter(protocols))}): effects that it excites alike cannot be "
            "distinguished; add holds, slides and another indenter"
        )
    if len(recordings) < FEW:
        texts.append(f"{len(recordings)} trajectories are few: record {FEW} at least")
    for phase, effects in (
        (Phase.HOLD, "relaxation and drift"),
        (Phase.SLIDE, "friction"),
        (Phase.RELEASE, "adhesion, backlash, softening and permanent set"),
    ):
        if not any(r.has(phase) for r in recordings):
            texts.append(f"no {phase.value} in the data: nothing can be concluded about {effects}")
    if not has_reference:
        texts.append(
            "no reference: errors of the sensor's file beyond its priors are taken for an effect; "
            "--reference with the unit's commissioning separates wear and drift from them"
        )
    return texts


def shown(estimate: Estimate) -> str:
    """Return a fitted number with its interval."""
    unit = f" {estimate.unit}" if estimate.unit else ""
    return f"{estimate.name} = {estimate.value:.3g}{unit} [{estimate.low:.3g}, {estimate.high:.3g}]"


def largest_place(places: Sequence[ResidualPlace]) -> str:
    """Return where the residual is largest over all trajectories, in words."""
    every = [p for p in places if p.trajectory == "all"]
    if not every:
        return ""
    worst = max(every, key=lambda p: (p.before**2 - 1.0) * p.count**0.5)
    return (
        f"the {worst.channel} at the {worst.region} in {worst.phase} ({worst.before:.1f} times "
        "what is expected)"
    )


def sentence(
    verdict: Verdict,
    named: Sequence[tuple[Effect, Sequence[Estimate]]],
    alternatives: Sequence[Effect],
    gaps: Sequence[ChannelGap],
    *,
    nearest: Sequence[Effect],
    sizes: tuple[float, float] | None,
    beyond: float | None,
    is_held_out: bool = True,
    doubted: str = "",
    stability: float | None = None,
    left_open: float | None = None,
    place: str,
    made_up: MadeUp | None = None,
) -> str:
    """Return the answer in a few sentences.

    Args:
        verdict: the answer.
        named: effects that are added, with their estimates.
        alternatives: effects that cannot be distinguished from the first.
        gaps: by channel, on the held-out trajectories, or on all where none is held out.
        nearest: what comes nearest, where nothing is named: an effect, or two that act together.
        sizes: of the nearest, as the skin and as the force give it, where they disagree.
        beyond: size of the nearest that the data ask for, where it is beyond its range.
        is_held_out: whether any trajectory is.
        doubted: the effects that are not named because too few bootstrap repetitions ask for them,
            as `amid_all` puts them.
        stability: share of the repetitions that do.
        left_open: share of the held-out trajectories' gap that the nearest closes, where that is
            why it is not named.
        place: where the residual is largest, in words.
        made_up: where no effect is missing, how the twin's constants make up for a gap.
    """
    if verdict is Verdict.NO_GAP:
        if made_up is not None:
            return _made_up_sentence(made_up)
        return "No gap: simulation and measurement agree within noise and discretisation."
    if doubted and stability is not None:
        return (
            f"Not decided: simulation and measurement disagree, most in {place}, and what explains "
            f"it best is: {doubted}. Only {stability:.0%} of bootstrap repetitions over "
            "trajectories ask for it; record more trajectories."
        )
    if verdict is Verdict.UNKNOWN:
        text = "Unknown effect: simulation and measurement disagree, and no effect of the library "
        text += f"explains it. It is largest in {place}."
        if nearest:
            text += f" The nearest is: {amid_all(nearest, are_two=True)}"
            first = nearest[0].parameters[0]
            unit = f" {first.unit}" if first.unit else ""
            if beyond is not None:
                text += f", but the data {_asked(first, beyond)}"
            if left_open is not None:
                closes = "it closes" if len(nearest) == 1 else "together they close"
                text += f", but {closes} {left_open:.0%} of the held-out trajectories' gap"
            if sizes is not None:
                text += (
                    f", but the skin gives {first.name} = {sizes[0]:.2g}{unit} and the force "
                    f"{sizes[1]:.2g}{unit}: they should agree"
                )
            text += "."
        return text
    parts = [
        f"{effect.title} is missing: {', '.join(shown(e) for e in estimates)}"
        for effect, estimates in named
    ]
    closing = "; ".join(
        f"{gap.channel} {gap.recalibrated:.3g} -> {gap.after:.3g} {gap.unit} (floor "
        f"{gap.floor:.2g})"
        for gap in gaps
    )
    where = "held-out gap" if is_held_out else "gap of the data searched, none being held out"
    text = "; and ".join(parts) + (f"; {where}: {closing}." if closing else ".")
    if alternatives:
        others = ", ".join(effect.title for effect in alternatives)
        text += f" The data do not distinguish it from: {others}."
    return text


def _made_up_sentence(found: MadeUp) -> str:
    """Return that no effect is missing, but the twin's file does not fit."""
    off = ", ".join(
        f"{gap.channel} {gap.before:.3g} {gap.unit} ({gap.before / gap.floor:.1f} times the floor)"
        for gap in found.gaps
    )
    text = (
        "No gap beyond the twin's constants: as its file has them it is off, RMS "
        f"{off}, and other values within their priors make up for it."
    )
    if len(found.alone) == 1:
        text += f" One alone would: {found.alone[0]}; several together may be as right."
    elif found.alone:
        text += f" The data do not tell which; each alone would: {'; '.join(found.alone)}."
    else:
        text += " No single one would, and the data do not tell which together."
    if found.protocols:
        text += f" To tell, record for {'; for '.join(found.protocols)}."
    return text


def optical_sentence(
    verdict: Verdict,
    named: Sequence[tuple[Effect, Sequence[Estimate]]],
    alternatives: Sequence[Effect],
    gap: ChannelGap,
    *,
    nearest: Effect | None,
    beyond: tuple[EffectParameter, float] | None = None,
) -> str:
    """Return what was found in the images, in one or two sentences.

    Args:
        verdict: of the images.
        named: effects that are added, with their estimates.
        alternatives: effects that cannot be distinguished from the first.
        gap: of the tiles' colours.
        nearest: the effect that comes nearest, where none is named.
        beyond: parameter of the nearest that is beyond its range, and the value that the images ask
            for.
    """
    if verdict is Verdict.NO_GAP:
        return "Images: no gap beyond noise and the twin's own error."
    if verdict is Verdict.UNKNOWN:
        text = "Images: they differ from the twin's, and no effect of the library explains it."
        if nearest is not None:
            text += f" The nearest is: {amid(nearest.title)}"
            text += "." if beyond is None else f", but the images {_asked(*beyond)}."
        return text
    parts = [
        f"{amid(effect.title)} is missing: {', '.join(shown(e) for e in estimates)}"
        for effect, estimates in named
    ]
    text = "Images: " + "; and ".join(parts)
    text += (
        f"; gap of the colours: {gap.recalibrated:.3g} -> {gap.after:.3g} grey levels (floor "
        f"{gap.floor:.2g})."
    )
    if alternatives:
        others = ", ".join(effect.title for effect in alternatives)
        text += f" The images do not distinguish it from: {others}."
    return text


def _asked(parameter: EffectParameter, value: float) -> str:
    """Return that a value is asked for which is beyond the plausible range."""
    unit = f" {parameter.unit}" if parameter.unit else ""
    return (
        f"ask for {parameter.name} = {value:.2g}{unit}, and its plausible range is "
        f"{parameter.low:g} to {parameter.high:g}{unit}"
    )


def weighed(effect: Effect, estimate: Estimate, names: Sequence[str]) -> str:
    """Return that known weights give the scale of the force, in a sentence."""
    return (
        f"{effect.title} is missing, by the known weight ({', '.join(names)}): {shown(estimate)}; "
        "the presses were searched with forces divided by it."
    )


def weight_without_reference(names: Sequence[str]) -> str:
    """Return why weights are not used against a commissioning, and what to do."""
    return (
        f"the known weight ({', '.join(names)}) was not used: the commissioning has none, so how "
        "its gauge read is not known; weigh at each commissioning, or search without --reference"
    )


def reaches_end(effect: Effect, estimate: Estimate) -> str | None:
    """Return that an interval reaches the end of the plausible range, None for one that does not.

    Args:
        effect: that is named.
        estimate: of its first parameter.
    """
    first = effect.parameters[0]
    ends = [end for end in map(first.end_at, (estimate.low, estimate.high)) if end is not None]
    if not ends:
        return None
    unit = f" {first.unit}" if first.unit else ""
    return (
        f"the interval of {effect.name}.{first.name} reaches the end of its range, {ends[0]:.3g}"
        f"{unit}: the data do not say how large it is, and it may stand for something else that "
        "looks alike"
    )


def image_warnings(noise_sensor: str, noise_source: str, sensor: str, count: int) -> list[str]:
    """Return what limits the conclusions from images.

    Args:
        noise_sensor, noise_source: whose images the thresholds come from, and which.
        sensor: name of the twin.
        count: of the trajectories with images.
    """
    texts = []
    if noise_sensor != sensor:
        texts.append(
            f"the images' thresholds come from {noise_source}, not from {sensor}, whose twin may "
            "have larger errors; make your own from images in which no effect is missing, with "
            "find-gap --fit-optical-noise"
        )
    if count < FEW:
        texts.append(f"{count} trajectories with images are few: record {FEW} at least")
    return texts


def not_tried_sentence(effects: Sequence[Effect]) -> str:
    """Return which effects no image was searched for."""
    return f"Not tried: {', '.join(amid(effect.title) for effect in effects)}."


def not_tried_warning(effects: Sequence[Effect], least: int, reason: str) -> str:
    """Return why images were not searched for some effects, and what to do.

    Args:
        effects: whose apparent sizes in images without any effect are not known.
        least: trajectories from which they can be estimated.
        reason: why the reference does not give them; empty without one.
    """
    text = (
        f"not tried in the images: {', '.join(effect.name for effect in effects)}. Their apparent "
        "size where no effect is missing is not known"
    )
    if reason:
        text += f", and the reference does not give it ({reason})"
    return (
        f"{text}. Estimate it from {least} trajectories or more with images in which no effect is "
        "missing: dotsim_ros find-gap --measured DIR --effects DIR --fit-optical-noise FILE, then "
        "search with --optical-noise FILE; or give those trajectories as --reference"
    )


def learnt_from_reference(effects: Sequence[Effect], source: str) -> str:
    """Return that some effects' limits come from the reference, which is taken to have none."""
    return (
        f"the file of the images' noise does not hold {', '.join(e.name for e in effects)}: their "
        f"limits come from {source}, the reference, in which no effect is taken to be missing"
    )


def amid_all(effects: Sequence[Effect], *, are_two: bool) -> str:
    """Return the titles of two effects that act together, or of those that cannot be told apart, as
    they stand within a sentence."""
    return (" and " if are_two else " or ").join(amid(effect.title) for effect in effects)


def amid(title: str) -> str:
    """Return a title as it stands within a sentence; an abbreviation keeps its capitals."""
    return title if title[1:2].isupper() else title[0].lower() + title[1:]
