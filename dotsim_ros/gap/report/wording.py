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
from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import ChannelGap, ResidualPlace, Verdict
from dotsim_ros.gap.resampling import BOOTSTRAPS

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
    interval = f"[{estimate.low:.3g}, {estimate.high:.3g}]"
    return f"{estimate.name} = {estimate.value:.3g}{_unit(estimate)} {interval}"


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


@dataclass(frozen=True)
class Facts:
    """What a sentence on an answer is made of.

    Attributes:
        named: effects that are added, with their estimates.
        alternatives: effects that cannot be distinguished from the first.
        gaps: by channel, on the held-out trajectories, or on all where none is held out.
        nearest: what comes nearest, where nothing is named: an effect, or two that act together.
        sizes: of the nearest, as the skin and as the force give it, where they disagree.
        beyond: parameter of the nearest and the value that the data ask for, beyond its range.
        left_open: share of the held-out trajectories' gap that the nearest closes, where that is
            why it is not named.
        doubted: the effects that are not named because too few bootstrap repetitions ask for them,
            as `amid_all` puts them.
        stability: share of the repetitions that do.
        place: where the residual is largest, in words.
        is_held_out: whether any trajectory is.
        made_up: where no effect is missing, how the twin's constants make up for a gap.
    """

    named: Sequence[tuple[Effect, Sequence[Estimate]]] = ()
    alternatives: Sequence[Effect] = ()
    gaps: Sequence[ChannelGap] = ()
    nearest: Sequence[Effect] = ()
    sizes: tuple[float, float] | None = None
    beyond: tuple[EffectParameter, float] | None = None
    left_open: float | None = None
    doubted: str = ""
    stability: float | None = None
    place: str = ""
    is_held_out: bool = True
    made_up: MadeUp | None = None


def sentence(verdict: Verdict, facts: Facts) -> str:
    """Return the answer of skin and force in a few sentences."""
    return {
        Verdict.NO_GAP: _no_gap,
        Verdict.UNKNOWN: _not_decided if facts.doubted else _unknown,
        Verdict.NAMED: _missing,
        Verdict.SET: _missing,
    }[verdict](facts)


def optical_sentence(verdict: Verdict, facts: Facts) -> str:
    """Return what was found in the images, in one or two sentences."""
    return {
        Verdict.NO_GAP: lambda _: "Images: no gap beyond noise and the twin's own error.",
        Verdict.UNKNOWN: _unknown_in_images,
        Verdict.NAMED: _missing_in_images,
        Verdict.SET: _missing_in_images,
    }[verdict](facts)


def _no_gap(facts: Facts) -> str:
    """Return that no effect is missing, and where the twin's file does not fit, that and why."""
    found = facts.made_up
    if found is None:
        return "No gap: simulation and measurement agree within noise and discretisation."
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


def _not_decided(facts: Facts) -> str:
    return (
        f"Not decided: simulation and measurement disagree, most in {facts.place}, and what "
        f"explains it best is: {facts.doubted}. Only {facts.stability:.0%} of bootstrap "
        "repetitions over trajectories ask for it; record more trajectories."
    )


def _unknown(facts: Facts) -> str:
    text = (
        "Unknown effect: simulation and measurement disagree, and no effect of the library "
        f"explains it. It is largest in {facts.place}."
    )
    if not facts.nearest:
        return text
    text += f" The nearest is: {amid_all(facts.nearest, are_two=True)}"
    if facts.beyond is not None:
        text += f", but the data {_asked(*facts.beyond)}"
    if facts.left_open is not None:
        closes = "it closes" if len(facts.nearest) == 1 else "together they close"
        text += f", but {closes} {facts.left_open:.0%} of the held-out trajectories' gap"
    if facts.sizes is not None:
        first = facts.nearest[0].parameters[0]
        skin, force = (f"{size:.2g}{_unit(first)}" for size in facts.sizes)
        text += (
            f", but the skin gives {first.name} = {skin} and the force {force}: they should agree"
        )
    return f"{text}."


def _missing(facts: Facts) -> str:
    text = "; and ".join(
        f"{effect.title} is missing: {', '.join(map(shown, estimates))}"
        for effect, estimates in facts.named
    )
    closing = "; ".join(f"{gap.channel} {_closing(gap, gap.unit)}" for gap in facts.gaps)
    where = "held-out gap" if facts.is_held_out else "gap of the data searched, none being held out"
    text += f"; {where}: {closing}." if closing else "."
    return text + _not_distinguished("data", facts)


def _unknown_in_images(facts: Facts) -> str:
    text = "Images: they differ from the twin's, and no effect of the library explains it."
    if not facts.nearest:
        return text
    but = "" if facts.beyond is None else f", but the images {_asked(*facts.beyond)}"
    return f"{text} The nearest is: {amid(facts.nearest[0].title)}{but}."


def _missing_in_images(facts: Facts) -> str:
    text = "Images: " + "; and ".join(
        f"{amid(effect.title)} is missing: {', '.join(map(shown, estimates))}"
        for effect, estimates in facts.named
    )
    text += f"; gap of the colours: {_closing(facts.gaps[0], 'grey levels')}."
    return text + _not_distinguished("images", facts)


def _closing(gap: ChannelGap, unit: str) -> str:
    return f"{gap.recalibrated:.3g} -> {gap.after:.3g} {unit} (floor {gap.floor:.2g})"


def _not_distinguished(data: str, facts: Facts) -> str:
    others = ", ".join(effect.title for effect in facts.alternatives)
    return f" The {data} do not distinguish it from: {others}." if others else ""


def _asked(parameter: EffectParameter, value: float) -> str:
    """Return that a value is asked for which is beyond the plausible range."""
    unit = _unit(parameter)
    return (
        f"ask for {parameter.name} = {value:.2g}{unit}, and its plausible range is "
        f"{parameter.low:g} to {parameter.high:g}{unit}"
    )


def _unit(parameter: EffectParameter | Estimate) -> str:
    return f" {parameter.unit}" if parameter.unit else ""


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


def certainty_warnings(
    found: str, stability: float | None, named: Sequence[tuple[Effect, Sequence[Estimate]]]
) -> list[str]:
    """Return what is uncertain of a name, and of the sizes of named effects.

    Args:
        found: what has the name.
        stability: share of the bootstrap repetitions that give it; None where nothing is named.
        named: effects with their estimates.
    """
    texts = []
    if stability is not None and stability < decision.STABLE_SHARE:
        texts.append(
            f"the name{found} is not stable: {stability:.0%} of {BOOTSTRAPS} bootstrap repetitions "
            "over trajectories agree; record more trajectories"
        )
    reached = [reaches_end(effect, estimates[0]) for effect, estimates in named]
    return [*texts, *(text for text in reached if text is not None)]


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
    return (
        f"the interval of {effect.name}.{first.name} reaches the end of its range, {ends[0]:.3g}"
        f"{_unit(first)}: the data do not say how large it is, and it may stand for something else "
        "that looks alike"
    )


def image_warnings(noise_sensor: str, noise_source: str, sensor: str, count: int) -> list[str]:
    """Return what limits the conclusions from images."""
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
