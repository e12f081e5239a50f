# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The camera's part of a search: its effects in the images of a data set.

Skins come from the twin's gel at the poses of the images, with the mechanical effects that were
named; where a mechanical gap is unknown, only frames without contact are looked at, since the skin
of the others is not known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dotsim_ros.data.measurement import Measurement, one_of_each, protocol_of
from dotsim_ros.effects.effect import IMAGE, Effect
from dotsim_ros.effects.overlay import FoundEffect, Overlay, active_effects
from dotsim_ros.effects.simulate import EffectRequest, open_solver
from dotsim_ros.gap.findings import (
    Candidate,
    ChannelGap,
    Findings,
    OpticalFindings,
    TileGap,
    Verdict,
    candidate_of,
)
from dotsim_ros.gap.images.case import (
    HEIGHT,
    IDLE,
    WIDTH,
    OpticalCase,
    Shot,
    excited,
    optical_case,
)
from dotsim_ros.gap.images.fit import (
    Fitted,
    ImageSearch,
    OpticalAnswer,
    mean_squares,
    without_effects,
)
from dotsim_ros.gap.images.model import TwinCamera
from dotsim_ros.gap.images.null import OpticalNull, fit_optical_null, load_optical_null
from dotsim_ros.gap.images.reading import (
    MeasuredImages,
    check_same_unit,
    read_images,
)
from dotsim_ros.gap.images.tiles import COLOURS
from dotsim_ros.gap.presses.search_state import GapRequest, Progress
from dotsim_ros.gap.report import wording
from dotsim_ros.gel.make import skin_of
from dotsim_ros.gel.values import values_of
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.cores import single_threaded
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.image_metrics import image_psnr_db

LEAST_TRAJECTORIES = 4
RESAMPLED = 200


@single_threaded()
def fit_noise_of_images(
    request: GapRequest,
    measurement: Measurement,
    reference: Measurement | None,
    progress: Progress,
) -> OpticalNull:
    """Return what the images of a data set show in which nothing is missing.

    Raises:
        FileNotFoundError, ValueError: images that cannot be used; the text says why.
    """
    case = case_of(request, *images_of(request.sensor, measurement, reference), progress)
    _check_enough(case)
    effects = [e for e in request.library().values() if e.image is not None]
    name = measurement.directory.name
    return fit_optical_null(
        case,
        effects,
        sensor=request.sensor.name,
        source=f"{len(case.shots) - 1} trajectories of {name} with {request.sensor.name}",
        progress=lambda done, total: progress("noise of the images", done, total),
    )


def images_of(
    twin: SensorSpecification, measurement: Measurement, reference: Measurement | None
) -> tuple[MeasuredImages, TwinCamera]:
    """Return the images of a measurement, and the model of the twin's at their size.

    Raises:
        FileNotFoundError, ValueError: as `read_images`; or images of another unit.
    """
    images = read_images(measurement, sensor=twin)
    height, width = images.idle_images.shape[1:3]
    idle, owner = None, f"the idle frame of {twin.name}"
    if reference is not None:
        idle, owner = read_images(reference, sensor=twin).idle, "that of the reference"
        check_same_unit(idle, images.idle, owner=owner)
    camera = twin.camera
    if width * camera.height != height * camera.width:
        raise ValueError(
            f"they are {width}x{height}, the camera of {twin.name} has "
            f"{camera.width}x{camera.height}, another aspect ratio: they come from another camera"
        )
    model = TwinCamera(twin, width=width, height=height, idle=idle)
    check_same_unit(model.idle, images.idle, owner=owner)
    return images, model


def case_of(
    request: GapRequest,
    images: MeasuredImages,
    model: TwinCamera,
    progress: Progress,
    overlay: Overlay | None = None,
) -> OpticalCase:
    """Return images next to those of the twin, whose gel has the effects of an overlay."""
    sensor, library = request.sensor, request.library()
    active = () if overlay is None else active_effects(overlay, library)
    with open_solver(
        sensor, skin_of(sensor.gel), request.directory / "solves", workers=request.workers
    ) as solver:
        answers, failures = solver.run_each(
            [
                EffectRequest(one.recording, values_of(sensor), effects=active)
                for one in images.trajectories
            ],
            lambda done, total: progress("skins of the images", done, total),
        )
    skins = [None if answer is None else answer.skin_position_m for answer in answers]
    case = optical_case(
        images, model, skins, progress=lambda done, total: progress("images", done, total)
    )
    left_out = tuple(f"no image of the twin's: {text}" for text in failures)
    return replace(case, solve_count=solver.solve_count, left_out=left_out)


def _check_enough(case: OpticalCase) -> None:
    """Refuse images without a gap from which a model's error cannot be estimated."""
    count = len(case.shots) - 1
    if count <= LEAST_TRAJECTORIES:
        raise ValueError(
            f"{count} trajectories with images are too few to tell what a model errs by, "
            f"expected more than {LEAST_TRAJECTORIES}"
        )


def _null_of(
    request: GapRequest,
    reference: Measurement | None,
    effects: Sequence[Effect],
    progress: Progress,
) -> tuple[OpticalNull, list[str], int]:
    """Return what images show where nothing is missing, what limits that, and how many solves it
    took. Nothing is missing in a reference: it gives the sizes of effects that the file does not
    know, such as the user's own."""
    null = load_optical_null(request.optical_noise)
    unknown = [effect for effect in effects if not null.knows(effect)]
    if not unknown:
        return null, [], 0
    reason = ""
    if reference is not None:
        try:
            images, model = images_of(request.sensor, reference, reference)
            case = case_of(request, images, model, progress)
            _check_enough(case)
            source = f"{len(case.shots) - 1} trajectories of {reference.directory.name}"
            names = ", ".join(effect.name for effect in unknown)
            limit = (
                f"the file of the images' noise does not hold {names}: their limits come from "
                f"{source}, the reference, in which no effect is taken to be missing"
            )
            return null.with_effects(unknown, case), [limit], case.solve_count
        except (FileNotFoundError, ValueError) as error:
            reason = str(error)
    return null, [wording.not_tried_warning(unknown, LEAST_TRAJECTORIES + 1, reason)], 0


def unusable_images(reason: str) -> OpticalFindings:
    text = f"The images cannot be used: {reason}"
    return OpticalFindings(Verdict.UNUSABLE, text, warnings=(text,))


def find_optical(
    request: GapRequest,
    measurement: Measurement,
    reference: Measurement | None,
    effects: Sequence[Effect],
    findings: Findings | None,
    overlay: Overlay | None,
    progress: Progress,
) -> tuple[OpticalFindings, tuple[FoundEffect, ...], str, int]:
    """Return the optical part, its effects for the overlay, the hash of the images, and how many
    solves it took."""
    images, model = images_of(request.sensor, measurement, reference)
    null, limits, solves = _null_of(request, reference, effects, progress)
    warnings = [*images.warnings, *limits]
    known = [effect for effect in effects if null.knows(effect)]
    not_tried = [effect for effect in effects if effect not in known]
    names = tuple(effect.name for effect in not_tried)
    untried = wording.not_tried_sentence(not_tried)
    if not known:
        sentence = f"Images: not searched. {untried}"
        nothing = OpticalFindings(
            Verdict.UNUSABLE, sentence, not_tried=names, warnings=tuple(warnings)
        )
        return nothing, (), images.digest, solves
    case = case_of(request, images, model, progress, overlay)
    warnings += case.left_out
    solves += case.solve_count
    if findings is not None and findings.verdict is Verdict.UNKNOWN:
        case = case.without_contact()
        warnings.append(
            "what is missing in the gel is unknown, so the skin in contact is not known: only "
            "frames without contact were searched for effects of the camera"
        )
    warnings += wording.image_warnings(
        null.sensor, null.source, request.sensor.name, len(case.shots) - 1
    )
    random = np.random.default_rng([request.seed, 1])
    locked = _locked(case, findings, random)
    chosen = [shot for shot in case.shots if shot.name not in locked]
    tried = excited(known, chosen)
    if not tried:
        raise ValueError("no image excites any effect of the camera; record presses with images")
    progress("screen the images", 0, 1)
    search = ImageSearch(case, chosen, tried, null, alpha=request.alpha, seed=request.seed)
    progress("screen the images", 1, 1)
    answer = search.answer()
    silent = [effect for effect in known if effect not in tried]
    seen = _optical_findings(search, answer, locked, {e.name: e for e in effects}, silent, random)
    judged = _judged(search, locked)
    untouched = case
    if overlay is not None:
        names_judged = [shot.name for shot in judged]
        own = [one for one in images.trajectories if one.recording.name in names_judged]
        untouched = case_of(request, replace(images, trajectories=tuple(own)), model, progress)
        solves += untouched.solve_count
    seen = replace(
        seen,
        psnr_db=_psnr_db(case, judged, untouched, answer.named),
        sentence=f"{seen.sentence} {untried}" if not_tried else seen.sentence,
        not_tried=names,
        warnings=(*warnings, *seen.warnings),
    )
    found = tuple(
        FoundEffect(one.effect.name, answer.estimates[one.effect.name]) for one in answer.named
    )
    return seen, found, images.digest, solves


def _locked(
    case: OpticalCase, findings: Findings | None, random: np.random.Generator
) -> tuple[str, ...]:
    """Return the names of the trajectories that are kept locked: those of the mechanical search,
    else one of each repeated protocol."""
    names = [shot.name for shot in case.shots]
    if findings is not None:
        return tuple(name for name in findings.locked if name in names)
    pressed = [shot for shot in case.shots if shot.recording is not None]
    places = one_of_each([protocol_of(s.recording) for s in pressed if s.recording], random)
    return tuple(sorted(pressed[place].name for place in places))


def _optical_findings(
    search: ImageSearch,
    answer: OpticalAnswer,
    locked: Sequence[str],
    library: Mapping[str, Effect],
    silent: Sequence[Effect],
    random: np.random.Generator,
) -> OpticalFindings:
    case, null = search.case, search.null
    judged = _judged(search, locked)
    before = [shot.residual for shot in judged]
    after = without_effects(case, judged, before, answer.named)
    closed: Closed = (None, None, None)
    if answer.named:
        squares = [mean_squares(judged, one, search.noise, case) for one in (before, after)]
        sizes = np.array([one.size for one in before])
        closed = _closed(squares, sizes, null.usual_excess, random)
    estimated = [(one.effect, answer.estimates[one.effect.name]) for one in answer.named]
    uncertain = wording.certainty_warnings(" of the images' effect", answer.stability, estimated)
    gap = _colour_gap(search, judged, before, after)
    if answer.verdict is Verdict.NO_GAP:
        sentence = wording.NO_GAP_IN_IMAGES
    elif answer.verdict is Verdict.UNKNOWN:
        beyond = answer.beyond
        asked = [wording.asked("images", beyond.parameter, beyond.value)] if beyond else []
        sentence = wording.unknown_in_images(_nearest(answer, library), asked)
    else:
        alternatives = [library[name] for name in answer.alternatives]
        sentence = wording.missing_in_images(estimated, alternatives, gap)
    return OpticalFindings(
        verdict=answer.verdict,
        sentence=sentence,
        named=tuple(one.effect.name for one in answer.named),
        alternatives=answer.alternatives,
        statistic=answer.statistic,
        threshold=answer.threshold,
        explained=answer.explained,
        excess=answer.excess,
        largest_excess=answer.largest_excess,
        candidates=_candidates(answer, library, silent),
        gap=gap,
        share_closed=closed[0],
        share_closed_low=closed[1],
        share_closed_high=closed[2],
        stability=answer.stability,
        tiles=_tiles(search, judged, before, after),
        warnings=tuple(uncertain),
        trajectories=tuple(shot.name for shot in search.shots),
        locked=tuple(locked),
        frame_count=sum(len(shot.measured) for shot in case.shots),
        noise_source=null.source,
    )


def _judged(search: ImageSearch, locked: Sequence[str]) -> Sequence[Shot]:
    """Return the shots that the named effects are judged on: the locked ones, where there are."""
    searched = [shot for shot in search.shots if shot.name != IDLE]
    return search.case.of(locked) or searched or search.shots


def _psnr_db(
    case: OpticalCase, judged: Sequence[Shot], untouched: OpticalCase, named: Sequence[Fitted]
) -> tuple[float, ...]:
    """Return the mean peak signal-to-noise ratio of the frames of shots, in the tiles: with the
    twin as it was, with one gain and one black level of the camera fitted, and so with the named
    effects; empty where the twin as it was could not be solved.

    Args:
        case: of all images, its gel with the named effects.
        judged: some of its shots.
        untouched: with the gel of the twin as it was.
        named: effects of the images.
    """
    before = untouched.of([shot.name for shot in judged])
    if len(before) != len(judged):
        return ()
    inside = case.meter.grid.tile >= 0
    measured = np.concatenate([shot.measured[:, inside] for shot in judged]).astype(np.float64)
    active = [one.active for one in named]

    def with_camera(seen: FloatArray) -> FloatArray:
        columns = np.stack([seen.ravel(), np.ones(seen.size)], axis=1)
        fit = np.linalg.lstsq(columns, measured.ravel(), rcond=None)[0]
        return np.asarray((columns @ fit).reshape(seen.shape))

    def psnr(seen: FloatArray) -> float:
        frames = zip(seen, measured, strict=True)
        return float(np.mean([image_psnr_db(one, other) for one, other in frames]))

    plain = np.concatenate([shot.film.pixels[:, inside] for shot in before]).astype(np.float64)
    after = [shot.film.with_effects(active)[:, inside].astype(np.float64) for shot in judged]
    return psnr(plain), psnr(with_camera(plain)), psnr(with_camera(np.concatenate(after)))


def _nearest(answer: OpticalAnswer, library: Mapping[str, Effect]) -> Effect | None:
    """Return the effect that comes nearest, where any explains something."""
    if answer.beyond is not None:
        return answer.beyond.effect
    best = answer.scores[0]
    return library[best.name] if best.fit > 0.0 else None


Closed = tuple[float, float, float] | tuple[None, None, None]


def _closed(
    squares: Sequence[FloatArray], sizes: FloatArray, floor: float, random: np.random.Generator
) -> Closed:
    """Return the share of the gap closed, (RMS0^2 - RMS1^2) / (RMS0^2 - floor^2), with its interval
    by a bootstrap over trajectories; None where there was no gap."""
    draws = random.integers(len(sizes), size=(RESAMPLED, len(sizes)))
    shares = []
    for drawn in [np.arange(len(sizes)), *draws]:
        before, after = (float(np.average(s[drawn], weights=sizes[drawn])) for s in squares)
        if before > floor:
            shares.append((before - after) / (before - floor))
        elif not shares:
            return None, None, None
    low, high = np.percentile(shares, [2.5, 97.5]).tolist()
    return shares[0], min(low, shares[0]), max(high, shares[0])


def _colour_gap(
    search: ImageSearch,
    shots: Sequence[Shot],
    before: Sequence[FloatArray],
    after: Sequence[FloatArray],
) -> ChannelGap:
    """Return the RMS of the tiles' colours, in grey levels; recalibrated: with one gain and one
    black level of the camera for all."""

    def colours(values: Sequence[FloatArray]) -> FloatArray:
        return np.concatenate([one[..., COLOURS].ravel() for one in values])

    def level(values: FloatArray) -> float:
        return float(np.sqrt(np.mean(values**2)))

    seen = np.concatenate([search.case.meter.colour(s.film.pixels).ravel() for s in shots])
    camera = np.stack([seen, np.ones(len(seen))], axis=1)

    def recalibrated(values: FloatArray) -> FloatArray:
        return np.asarray(values - camera @ np.linalg.lstsq(camera, values, rcond=None)[0])

    measured = colours(before)
    expected = colours([search.noise.deviation(shot.change) for shot in shots])
    return ChannelGap(
        IMAGE,
        "levels",
        level(measured),
        level(recalibrated(measured)),
        level(recalibrated(colours(after))),
        float(np.sqrt(search.null.usual_excess)) * level(expected),
    )


def _tiles(
    search: ImageSearch,
    shots: Sequence[Shot],
    before: Sequence[FloatArray],
    after: Sequence[FloatArray],
) -> tuple[TileGap, ...]:
    """Return the RMS of each tile's observables in expected deviations."""
    deviation = np.concatenate([search.noise.deviation(shot.change) for shot in shots])
    rms = [
        np.sqrt(np.mean((np.concatenate(values) / deviation) ** 2, axis=(0, 2))).tolist()
        for values in (before, after)
    ]
    centre = (search.case.meter.grid.centre_px / [WIDTH, HEIGHT]).tolist()
    return tuple(
        TileGap(x, y, first, second) for (x, y), first, second in zip(centre, *rms, strict=True)
    )


def _candidates(
    answer: OpticalAnswer, library: Mapping[str, Effect], silent: Sequence[Effect]
) -> tuple[Candidate, ...]:
    fitted = {one.effect.name: one.score.values for one in answer.named}
    result = []
    for score in filter(lambda one: one.is_excited, answer.scores):
        effect = library[score.name]
        size = fitted.get(score.name, score.values)[effect.parameters[0].name]
        estimates = answer.estimates.get(score.name, ())
        result.append(
            Candidate(
                effect.name,
                effect.title,
                True,
                score.statistic,
                size,
                score.explained,
                estimates=estimates,
            )
        )
    hidden = [library[score.name] for score in answer.scores if not score.is_excited]
    return (*result, *map(candidate_of, [*silent, *hidden]))
