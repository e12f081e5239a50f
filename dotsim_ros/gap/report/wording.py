# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The findings in words, and what the data do not identify."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dotsim_ros.data.measurement import Measurement, protocol_of
from dotsim_ros.data.recording import Phase
from dotsim_ros.effects.effect import Effect, EffectParameter
from dotsim_ros.effects.overlay import Estimate
from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import ALL, ChannelGap, Explanation, Question, ResidualPlace

FEW = 4


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
    every = [p for p in places if p.trajectory == ALL]
    if not every:
        return ""
    worst = max(every, key=lambda p: (p.before**2 - 1.0) * p.count**0.5)
    return (
        f"the {worst.channel} at the {worst.region} in {worst.phase} ({worst.before:.1f} times "
        "what is expected)"
    )


NO_GAP = "No gap: simulation and measurement agree within noise and discretisation."


def made_up(off: Sequence[ChannelGap], alone: Sequence[str], protocols: Sequence[str]) -> str:
    """Return that no effect is missing, but that the twin's file is off.

    Args:
        off: channels in which it is.
        alone: constants of which each would do, with the stiffness next to it, as well as all
            together, in words.
        protocols: what to record to distinguish them, by constant.
    """
    rms = ", ".join(
        f"{gap.channel} {gap.before:.3g} {gap.unit} ({gap.before / gap.floor:.1f} times the floor)"
        for gap in off
    )
    text = (
        "No gap beyond the twin's constants: as its file has them it is off, RMS "
        f"{rms}, and other values within their priors make up for it."
    )
    if len(alone) == 1:
        text += f" One alone would: {alone[0]}; several together may be as right."
    elif alone:
        text += f" The data do not tell which; each alone would: {'; '.join(alone)}."
    else:
        text += " No single one would, and the data do not tell which together."
    if protocols:
        text += f" To tell, record for {'; for '.join(protocols)}."
    return text


def not_decided(nearest: Sequence[Effect], *, are_two: bool, stability: float, place: str) -> str:
    """Return that too few bootstrap repetitions, a share of `stability`, ask for the effects that
    explain a gap best: two that act together, or those of a set."""
    return (
        f"Not decided: simulation and measurement disagree, most in {place}, and what "
        f"explains it best is: {amid_all(nearest, are_two=are_two)}. Only {stability:.0%} of "
        "bootstrap repetitions over trajectories ask for it; record more trajectories."
    )


def unknown(place: str, nearest: Sequence[Effect], reasons: Sequence[str]) -> str:
    """Return that no effect explains a gap that is largest in a place, and the reasons why the
    nearest ones, which would act together, do not."""
    but = "".join(f", but {reason}" for reason in reasons)
    return (
        "Unknown effect: simulation and measurement disagree, and no effect of the library "
        f"explains it. It is largest in {place}. The nearest is: "
        f"{amid_all(nearest, are_two=True)}{but}."
    )


MOST_POSSIBLE = 3
"""So many explanations are listed in a sentence."""


def to_record(explanations: Sequence[Explanation], questions: Sequence[Question]) -> str:
    """Return what is still possible, the most probable first, and what to record first."""
    best, *others = explanations[:MOST_POSSIBLE]
    text = f"Still possible: {'; or '.join([best.title, *(other.title for other in others)])}."
    if not questions:
        return f"{text} No trajectory that can be made with this setup would say more."
    first = questions[0]
    rivals = [other.title for other in others if other.name in first.separates]
    separates = f"tells {best.title} from {' and '.join(rivals)}" if rivals else "says most of it"
    return (
        f"{text} Record next: {first.path}, with {first.indenter} ({first.seconds:.0f} s), which "
        f"{separates}."
    )


def left_open(count: int, share: float) -> str:
    """Return as a reason that so many effects close too small a share of the gap."""
    closes = "it closes" if count == 1 else "together they close"
    return f"{closes} {share:.0%} of the held-out trajectories' gap"


def disagreeing(parameter: EffectParameter, skin: float, force: float) -> str:
    """Return as a reason that skin and force ask for two sizes."""
    first, second = (f"{size:.2g}{_unit(parameter)}" for size in (skin, force))
    return f"the skin gives {parameter.name} = {first} and the force {second}: they should agree"


def asked(data: str, parameter: EffectParameter, value: float) -> str:
    """Return as a reason that data ask for a value beyond the plausible range."""
    unit = _unit(parameter)
    return (
        f"the {data} ask for {parameter.name} = {value:.2g}{unit}, and its plausible range is "
        f"{parameter.low:g} to {parameter.high:g}{unit}"
    )


Named = Sequence[tuple[Effect, Sequence[Estimate]]]
"""Effects that are named, with their estimates."""


def missing(
    named: Named, alternatives: Sequence[Effect], gaps: Sequence[ChannelGap], *, is_held_out: bool
) -> str:
    """Return that effects are missing, and how much of the gaps they close."""
    text = "; and ".join(
        f"{effect.title} is missing: {', '.join(map(shown, estimates))}"
        for effect, estimates in named
    )
    closing = "; ".join(f"{gap.channel} {_closing(gap, gap.unit)}" for gap in gaps)
    where = "held-out gap" if is_held_out else "gap of the data searched, none being held out"
    text += f"; {where}: {closing}." if closing else "."
    return text + _not_distinguished("data", named, alternatives)


def hinges(others: Mapping[str, Sequence[Sequence[Effect]]]) -> str:
    """Return that the answer hangs on single trajectories.

    Args:
        others: what would be named without each, by its name: nothing, one effect, or two that act
            together, each with those that are not distinguished from it. At least one.
    """
    answers: dict[str, list[str]] = {}
    for trajectory, named in others.items():
        answer = " with ".join(amid_all(effects, are_two=False) for effects in named)
        answers.setdefault(answer or "no effect is named", []).append(trajectory)
    texts = [f"without {' or '.join(names)}: {answer}" for answer, names in answers.items()]
    again = "it" if len(others) == 1 else "each"
    return f"the answer hangs on single trajectories ({'; '.join(texts)}): record {again} again"


def beyond_usual(effect: Effect, value: float) -> str:
    """Return that a named effect's size is beyond its plausible range; empty where it is within."""
    parameter = effect.parameters[0]
    if parameter.low <= value <= parameter.high:
        return ""
    unit = _unit(parameter)
    return (
        f" Its size is beyond the usual, {parameter.low:g} to {parameter.high:g}{unit}: held-out "
        "data have no gap left with it, in any channel, phase and place."
    )


NO_GAP_IN_IMAGES = "Images: no gap beyond noise and the twin's own error."


def unknown_in_images(nearest: Effect | None, reasons: Sequence[str]) -> str:
    """Return that no effect explains the images, and why the nearest one does not."""
    text = "Images: they differ from the twin's, and no effect of the library explains it."
    if nearest is None:
        return text
    but = "".join(f", but {reason}" for reason in reasons)
    return f"{text} The nearest is: {amid(nearest.title)}{but}."


def missing_in_images(named: Named, alternatives: Sequence[Effect], gap: ChannelGap) -> str:
    """Return that effects are missing in the images, and how much of the gap they close."""
    text = "; and ".join(
        f"{amid(effect.title)} is missing: {', '.join(map(shown, estimates))}"
        for effect, estimates in named
    )
    return (
        f"Images: {text}; gap of the colours: {_closing(gap, 'grey levels')}."
        f"{_not_distinguished('images', named, alternatives)}"
    )


def _closing(gap: ChannelGap, unit: str) -> str:
    return f"{gap.recalibrated:.3g} -> {gap.after:.3g} {unit} (floor {gap.floor:.2g})"


def _not_distinguished(data: str, named: Named, alternatives: Sequence[Effect]) -> str:
    if not alternatives:
        return ""
    first = "it" if len(named) == 1 else amid(named[0][0].title)
    others = ", ".join(effect.title for effect in alternatives)
    return f" The {data} do not distinguish {first} from: {others}."


def _unit(parameter: EffectParameter | Estimate) -> str:
    return f" {parameter.unit}" if parameter.unit else ""


def certainty_warnings(found: str, stability: float | None, named: Named) -> list[str]:
    """Return what is uncertain of a name, and of the sizes of named effects.

    Args:
        found: what has the name.
        stability: share of the bootstrap repetitions that give it; None where nothing is named.
        named: effects with their estimates.
    """
    texts = []
    if stability is not None and stability < decision.STABLE_SHARE:
        texts.append(
            f"the name{found} is not stable: {stability:.0%} of {decision.BOOTSTRAPS} bootstrap "
            "repetitions over trajectories agree; record more trajectories"
        )
    for effect, estimates in named:
        first = effect.parameters[0]
        ends = [first.end_at(end) for end in (estimates[0].low, estimates[0].high)]
        reached = next((end for end in ends if end is not None), None)
        if reached is not None:
            texts.append(
                f"the interval of {effect.name}.{first.name} reaches the end of its range, "
                f"{reached:.3g}{_unit(first)}: the data do not say how large it is, and it may "
                "stand for something else that looks alike"
            )
    return texts


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


def amid_all(effects: Sequence[Effect], *, are_two: bool) -> str:
    """Return the titles of two effects that act together, or of those that are not distinguished,
    as they stand within a sentence."""
    return (" and " if are_two else " or ").join(amid(effect.title) for effect in effects)


def amid(title: str) -> str:
    """Return a title as it stands within a sentence; an abbreviation keeps its capitals."""
    return title if title[1:2].isupper() else title[0].lower() + title[1:]
