# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The search for a gap, from a measured data set to findings (steps 1 to 9 of the method)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from dotsim_ros.data.measurement import Measurement, one_of_each, protocol_of, read_measurement
from dotsim_ros.data.plausibility import check_same_shape
from dotsim_ros.data.recording import Recording
from dotsim_ros.effects.effect import IMAGE
from dotsim_ros.effects.overlay import Overlay
from dotsim_ros.effects.simulate import EffectSolver, open_solver
from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import Findings
from dotsim_ros.gap.presses.answer import answer_of, null_gains, screen
from dotsim_ros.gap.presses.assumptions import (
    ABSOLUTE,
    DIFFERENTIAL,
    centred,
    nuisance_requests,
)
from dotsim_ros.gap.presses.conclusions import findings_of
from dotsim_ros.gap.presses.covariance import ChannelNoise, load_discrepancy, noise_from_idle
from dotsim_ros.gap.presses.evidence import Case, Variant, make_case
from dotsim_ros.gap.presses.questions import ASKED, with_questions
from dotsim_ros.gap.presses.screening import excited_variants, planned_requests
from dotsim_ros.gap.presses.search_state import MECHANICAL, GapRequest, Progress, Search
from dotsim_ros.gap.presses.weighed import (
    EFFECT,
    is_wrong,
    weighed_scale,
    with_right_forces,
    with_scale,
    without_scale,
)
from dotsim_ros.gap.report import wording
from dotsim_ros.gel.make import skin_of
from dotsim_ros.gel.values import values_of
from dotsim_ros.io.worker_pool.pool import worker_count
from dotsim_ros.twin.solver import Progress as SolvesDone

FIRST_COSTS = 1.65
"""What a press of the first step takes of the time of a later one: in it the workers meet every
indenter, and wait for the last gel. Measured over both steps of eight trajectories on two cores."""


def read_measurements(request: GapRequest) -> tuple[Measurement, Measurement | None]:
    """Read what the channels of a request need of its data set, and of its reference.

    Raises:
        FileNotFoundError, ValueError: as `read_measurement`.
    """
    read = partial(
        read_measurement,
        own_skin=skin_of(request.sensor.gel),
        indenters=request.indenters,
        presses=any(channel in MECHANICAL for channel in request.channels),
        images=IMAGE in request.channels,
    )
    reference = request.reference
    return read(request.measured), None if reference is None else read(reference)


def search_presses(
    request: GapRequest,
    measurement: Measurement,
    reference: Measurement | None,
    progress: Progress,
) -> tuple[Findings, Overlay | None]:
    """Search a data set; return what was found, and the overlay if an effect was named.

    Raises:
        FileNotFoundError: a data set, an indenter or a file that is not there.
        ValueError: data that cannot be used; the text says why and what to do.
    """
    begun_s = time.monotonic()
    _check_skins(request, measurement, reference)
    scale, weight_warnings = weighed_scale(request)
    if scale is not None:
        measurement = with_right_forces(measurement, scale)
    library = request.library()
    request = without_scale(request, library, scale)
    noise = noise_from_idle(
        measurement.recordings, measurement.skin.rest_position_m, ChannelNoise()
    )
    discrepancy = load_discrepancy(request.discrepancy)
    values = values_of(request.sensor)
    warnings = [
        *measurement.warnings,
        *wording.data_warnings(measurement, request.channels, reference is not None),
        *weight_warnings,
    ]
    if noise.source == "declared":
        warnings.append("no frame is without contact: the declared noise is used")
    random = np.random.default_rng(request.seed)
    with open_solver(
        request.sensor, measurement.skin, request.directory / "solves", workers=request.workers
    ) as solver:
        first, last = _plan(request, measurement, reference, solver, progress)
        nuisances = centred(ABSOLUTE if reference is None else DIFFERENTIAL, discrepancy.bias)
        case, left_out = make_case(
            measurement.recordings,
            () if reference is None else reference.recordings,
            values=values,
            nuisances=nuisances,
            library=library,
            solver=solver,
            skin=measurement.skin,
            noise=noise,
            discrepancy=discrepancy,
            channels=request.channels,
            progress=first,
        )
        warnings += left_out
        chosen, held_out = _hold_out(case, random)
        if not held_out:
            warnings.append(
                "no protocol was repeated: nothing could be held out, so the gain is shown on "
                "the data that the effect was found in; repeat each protocol"
            )
        search = Search(
            request, case, chosen, held_out, noise, discrepancy, random, progress, warnings
        )
        variants, silent = simulate_effects(search, last)
        ranked = screen(search, variants)
        gains, pattern_gains = null_gains(search, ranked, decision.NULL_DRAWS)
        answer = answer_of(search, ranked, gains, pattern_gains)
        findings, overlay = findings_of(search, measurement, reference, answer, silent)
        if request.next_presses:
            findings = with_questions(findings, search, answer, measurement.skin)
    if scale is not None and is_wrong(scale):
        findings, overlay = with_scale(findings, overlay, scale, library[EFFECT])
    seconds = time.monotonic() - begun_s
    return replace(findings, solve_count=solver.solve_count, seconds=seconds), overlay


def _check_skins(
    request: GapRequest, measurement: Measurement, reference: Measurement | None
) -> None:
    """Refuse the skin of another sensor, and one that the reference does not have."""
    directory, own = measurement.directory, skin_of(request.sensor.gel)
    check_same_shape(measurement.skin, own, data=str(directory), sensor=request.sensor.name)
    count = measurement.skin.vertex_count
    if reference is not None and reference.skin.vertex_count != count:
        raise ValueError(
            f"{reference.directory} lists {reference.skin.vertex_count} points of the skin, "
            f"{directory} {count}; record both in the same way"
        )


def _plan(
    request: GapRequest,
    measurement: Measurement,
    reference: Measurement | None,
    solver: EffectSolver,
    progress: Progress,
) -> tuple[SolvesDone, SolvesDone]:
    """Make what all solves need, and return what reports those of the first step and of the last:
    how long they take altogether is known before the first, but for refits, of which there are few.
    """
    library, values = request.library(), values_of(request.sensor)
    measured = measurement.recordings
    calibration = [
        one
        for recording in (*(() if reference is None else reference.recordings), *measured)
        for one in nuisance_requests(recording, values, library)
    ]
    screening = planned_requests(measured, values, library, request.candidates)
    workers = worker_count(request.workers)

    def tables(done: int, total: int) -> None:
        # Reported in rounds: each worker makes one at a time, and all take equally long.
        rounds = -(-total // workers)
        progress("tables", rounds if done == total else done // workers, rounds)

    progress("tables", 0, 1)
    solver.prepare([*calibration, *screening], tables)
    # Which of the repeated ones is held out makes no difference here.
    held_out = _places_held_out(measured, np.random.default_rng(0))
    searched = [r for place, r in enumerate(measured) if place not in held_out]
    names = {recording.name for recording in searched}
    later = [one for one in screening if one.recording.name in names]
    # What both need is solved in the first step.
    whole = solver.work_of([*calibration, *later])
    return progress_of_two_steps(progress, later=whole - solver.work_of(calibration))


def progress_of_two_steps(progress: Progress, later: int) -> tuple[SolvesDone, SolvesDone]:
    """Return what reports the solves of the first step, and of a last one that is so much work, in
    presses' work of the last."""
    costs = FIRST_COSTS if later else 1.0
    before = 0

    def first(done: int, total: int) -> None:
        nonlocal before
        before = round(costs * total)
        progress("solve", round(costs * done), before + later)

    def last(done: int, total: int) -> None:
        progress("solve", before + done, before + total)

    return first, last


def _hold_out(case: Case, random: np.random.Generator) -> tuple[list[int], list[int]]:
    """Return trajectories to search, and to hold out: one of each repeated protocol."""
    measured = [n for n, t in enumerate(case.trajectories) if not t.is_reference]
    places = _places_held_out([case.trajectories[n].recording for n in measured], random)
    held_out = [measured[place] for place in places]
    return [n for n in range(len(case.trajectories)) if n not in held_out], held_out


def _places_held_out(recordings: Sequence[Recording], random: np.random.Generator) -> list[int]:
    """Return one place of each repeated protocol. What was asked for is none of them: it is to
    decide, and what was held out before it was recorded stays so."""
    places = [k for k, one in enumerate(recordings) if not one.name.startswith(ASKED)]
    chosen = one_of_each([protocol_of(recordings[k]) for k in places], random)
    return [places[k] for k in chosen]


def simulate_effects(search: Search, progress: SolvesDone) -> tuple[list[Variant], list[str]]:
    """Simulate every effect that is excited at its probes; return them, and the others' names.

    Raises:
        ValueError: nothing is excited.
    """
    variants, silent = excited_variants(search.case, search.request.candidates)
    if not variants and search.request.candidates:
        library = search.case.library
        protocols = "; ".join(f"{name}: {library[name].protocol}" for name in silent)
        raise ValueError(
            f"no trajectory excites any of {', '.join(search.request.candidates)}, so nothing can "
            f"be concluded of them; record what does ({protocols}), or name other candidates"
        )
    if not variants:
        raise ValueError(
            "no trajectory excites any effect of the library: nothing can be concluded; record "
            "presses with force or skin, holds, slides and releases"
        )
    wanted = [
        (variant, probe) for variant in variants for probe in variant.effect.parameters[0].probes
    ]
    failures = search.case.extend(
        wanted,
        progress=progress,
        # What is held out is simulated for what is named alone.
        among=search.chosen,
    )
    search.warnings += [f"an effect could not be simulated: {text}" for text in failures]
    return variants, silent
