"""The findings in words, and what the data cannot tell."""

from __future__ import annotations

from collections.abc import Sequence

from dotsim_ros.effects.effect import Effect
from dotsim_ros.effects.overlay import Estimate
from dotsim_ros.gap.findings import ChannelGap, ResidualPlace, Verdict
from dotsim_ros.measured.measurement import Measurement, protocol_of
from dotsim_ros.measured.recording import Phase

FEW = 4


def data_warnings(
    measurement: Measurement, channels: Sequence[str], has_reference: bool
) -> list[str]:
    """Return what a data set cannot tell, and what to record for it."""
    recordings = measurement.recordings
    texts = []
    if not any(r.press.force_n is not None for r in recordings) or "force" not in channels:
        texts.append(
            "no force: stiffness, force scale and drift cannot be told, and a softer gel looks "
            "like any other; record the wrench"
        )
    if not any(r.press.skin_position_m is not None for r in recordings) or "skin" not in channels:
        texts.append(
            "no skin: friction, compressibility and the pose are told by the force alone; record "
            "the skin's points where you can"
        )
    protocols = {protocol_of(r) for r in recordings}
    if len(protocols) == 1:
        texts.append(
            f"one protocol only ({next(iter(protocols))}): effects that it excites alike cannot be "
            "told apart; add holds, slides and another indenter"
        )
    if len(recordings) < FEW:
        texts.append(f"{len(recordings)} trajectories are few: record {FEW} at least")
    for phase, effects in (
        (Phase.HOLD, "relaxation and drift"),
        (Phase.SLIDE, "friction"),
        (Phase.RELEASE, "adhesion, backlash, softening and permanent set"),
    ):
        if not any(r.has(phase) for r in recordings):
            texts.append(f"no {phase.value} in the data: nothing is claimed of {effects}")
    if not has_reference:
        texts.append(
            "no reference: what the sensor's file has wrong beyond its priors is taken for an "
            "effect; --reference with the unit's commissioning tells wear and drift apart from it"
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
    nearest: Effect | None,
    sizes: tuple[float, float] | None,
    place: str,
) -> str:
    """Return the answer in one or two sentences.

    Args:
        verdict: the answer.
        named: effects that are added, with their estimates.
        alternatives: effects that the first is not told from.
        gaps: by channel, on the locked trajectories.
        nearest: the effect that comes nearest, where none is named.
        sizes: of the nearest, as the skin and as the force tell it, where they disagree.
        place: where the residual is largest, in words.
    """
    if verdict is Verdict.NO_GAP:
        return "No gap: simulation and measurement agree within noise and discretisation."
    if verdict is Verdict.UNKNOWN:
        text = "Unknown effect: simulation and measurement disagree, and no effect of the library "
        text += f"explains it. It is largest in {place}."
        if nearest is not None:
            text += f" Nearest comes: {_amid(nearest.title)}"
            if sizes is not None:
                first = nearest.parameters[0]
                unit = f" {first.unit}" if first.unit else ""
                text += (
                    f", but the skin tells {first.name} = {sizes[0]:.2g}{unit} and the force "
                    f"{sizes[1]:.2g}{unit}: one effect has one size"
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
    text = "; and ".join(parts) + (f"; held-out gap: {closing}." if closing else ".")
    if alternatives:
        others = ", ".join(effect.title for effect in alternatives)
        text += f" The data do not tell it from: {others}."
    return text


def optical_sentence(
    verdict: Verdict,
    named: Sequence[tuple[Effect, Sequence[Estimate]]],
    alternatives: Sequence[Effect],
    gap: ChannelGap,
    *,
    nearest: Effect | None,
) -> str:
    """Return what the images told, in one or two sentences.

    Args:
        verdict: of the images.
        named: effects that are added, with their estimates.
        alternatives: effects that the first is not told from.
        gap: of the tiles' colours.
        nearest: the effect that comes nearest, where none is named.
    """
    if verdict is Verdict.NO_GAP:
        return "Images: no gap beyond noise and the twin's own error."
    if verdict is Verdict.UNKNOWN:
        text = "Images: they differ from the twin's, and no effect of the library explains it."
        if nearest is not None:
            text += f" Nearest comes: {_amid(nearest.title)}."
        return text
    parts = [
        f"{_amid(effect.title)} is missing: {', '.join(shown(e) for e in estimates)}"
        for effect, estimates in named
    ]
    text = "Images: " + "; and ".join(parts)
    text += (
        f"; gap of the colours: {gap.recalibrated:.3g} -> {gap.after:.3g} grey levels (floor "
        f"{gap.floor:.2g})."
    )
    if alternatives:
        others = ", ".join(effect.title for effect in alternatives)
        text += f" The images do not tell it from: {others}."
    return text


def image_warnings(noise_sensor: str, noise_source: str, sensor: str, count: int) -> list[str]:
    """Return what images cannot tell.

    Args:
        noise_sensor, noise_source: whose images the thresholds come from, and which.
        sensor: name of the twin.
        count: of the trajectories with images.
    """
    texts = []
    if noise_sensor != sensor:
        texts.append(
            f"the images' thresholds come from {noise_source}, not from {sensor}: its twin may err "
            "more; make your own from images in which nothing is wrong, with find-gap "
            "--fit-optical-noise"
        )
    if count < FEW:
        texts.append(f"{count} trajectories with images are few: record {FEW} at least")
    return texts


def not_tried_sentence(effects: Sequence[Effect]) -> str:
    """Return which effects no image was searched for."""
    return f"Not tried: {', '.join(_amid(effect.title) for effect in effects)}."


def not_tried_warning(effects: Sequence[Effect], least: int, reason: str) -> str:
    """Return why images were not searched for some effects, and what to do.

    Args:
        effects: whose sizes in images with nothing wrong are not known.
        least: trajectories that can tell them.
        reason: why the reference does not; empty without one.
    """
    text = (
        f"not tried in the images: {', '.join(effect.name for effect in effects)}. How large they "
        "seem where nothing is missing is not known"
    )
    if reason:
        text += f", and the reference does not tell it ({reason})"
    return (
        f"{text}. Learn it from {least} trajectories or more with images in which nothing is "
        "wrong: dotsim_ros find-gap --measured DIR --effects DIR --fit-optical-noise FILE, then "
        "search with --optical-noise FILE; or give those trajectories as --reference"
    )


def told_by_reference(effects: Sequence[Effect], source: str) -> str:
    """Return that the reference told what images show of some effects where nothing is missing."""
    return (
        f"the images' noise knows nothing of {', '.join(effect.name for effect in effects)}: their "
        f"limits come from {source}, the reference, in which nothing is taken to be wrong"
    )


def _amid(title: str) -> str:
    """Return a title as it stands within a sentence; an abbreviation keeps its capitals."""
    return title if title[1:2].isupper() else title[0].lower() + title[1:]
