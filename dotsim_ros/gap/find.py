# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The whole search in one call: skin and force first, then the camera's effects in the images."""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dotsim_ros.data.data_set import DataSet, read_data_set
from dotsim_ros.data.measurement import holds_skin_or_force
from dotsim_ros.effects.effect import IMAGE, Effect, EffectError
from dotsim_ros.effects.overlay import Overlay
from dotsim_ros.gap.findings import Findings, OpticalFindings, Verdict
from dotsim_ros.gap.images.find import find_optical, fit_noise_of_images, unusable_images
from dotsim_ros.gap.images.null import OpticalNull, load_optical_null, save_optical_null
from dotsim_ros.gap.next_presses import FOLDER, write_questions
from dotsim_ros.gap.presses.covariance import load_discrepancy
from dotsim_ros.gap.presses.search import read_measurements, search_presses
from dotsim_ros.gap.presses.search_state import CHANNELS, MECHANICAL, GapRequest, Progress
from dotsim_ros.gap.report.write import write_report
from dotsim_ros.gel.values import values_of
from dotsim_ros.io.cores import single_threaded
from dotsim_ros.io.files import check_output_folder
from dotsim_ros.io.replacement import finish_replacement, remove_made
from dotsim_ros.io.worker_pool.pool import Crew
from dotsim_ros.specification import SensorSpecification, given_sensor
from dotsim_ros.twin.simulator import check_is_quasi_static


def channels_of(measured: Path | DataSet) -> tuple[str, ...]:
    """Return the channels that are used where none were asked for: skin and force, unless all that
    the bags of a data set hold is images, and the images where idle ones lie next to them."""
    data_set = read_data_set(measured)
    if not (data_set.idle_images() and any(entry.has_images for entry in data_set.entries)):
        return MECHANICAL
    return CHANNELS if holds_skin_or_force(data_set) else (IMAGE,)


@single_threaded()
def find_gap(
    measured: str | Path | DataSet,
    *,
    sensor: str | Path | SensorSpecification = "sensor_a",
    out: str | Path | None = None,
    reference: str | Path | None = None,
    indenters: str | Path | None = None,
    effects: Sequence[str | Path] = (),
    channels: Sequence[str] | None = None,
    candidates: Sequence[str] = (),
    alpha: float = 0.02,
    budget: int | None = None,
    seed: int = 0,
    workers: Crew = 2,
    discrepancy: str | Path | None = None,
    optical_noise: str | Path | None = None,
    next_presses: int = 0,
    progress: Progress | None = None,
) -> Findings:
    """Find where a calibrated sensor and its measurements disagree, and name the missing effect.

    It starts processes, so a script calls it below `if __name__ == "__main__":`.

    Args:
        measured: folder of the data set, or the data set.
        sensor: the calibrated twin: a name, a YAML file or a specification.
        out: folder of the report, with the solves, from which an interrupted run resumes,
            and the overlay of the effects that were named; None writes and keeps nothing.
        reference: folder of the unit's commissioning, to find what has changed since.
        indenters: folder of the indenters' meshes; by default looked for next to the data.
        effects: folders of your own effects: Python programs, which are run, all of them or, with
            `candidates`, those named alone.
        channels: of "skin", "force" and "image"; by default all that the data hold.
        candidates: names of the effects to look for; by default all.
        alpha: chance of a name on data without an effect.
        budget: solves of a trajectory after which the sizes of the best effects are refined no
            more; the first look at every effect is always taken. By default no limit.
        seed: of all draws.
        workers: how many processes, or workers of Ray.
        discrepancy: file of the model's own error; by default the shipped one.
        optical_noise: file of the images' noise; by default the shipped one.
        next_presses: so many trajectories to record next are found where the presses give no sure
            answer, and written to `out/next` in place of those before.
        progress: called with each step's name, how much of it is done, and of how much.

    Returns:
        What was found; its verdict is `Verdict.UNUSABLE` where the data cannot be used.

    Raises:
        FileNotFoundError: a data set, sensor, indenter or file that is not there.
        ValueError: an argument that is out of range or names nothing, before anything is read of
            the data or written.
        FileExistsError: there is something at `out/next` that was not made so.
    """
    if budget == 0:
        raise ValueError("budget is 0, expected 1 or more")
    request = GapRequest(
        measured=measured if isinstance(measured, DataSet) else Path(measured),
        sensor=given_sensor(sensor),
        directory=Path(),
        reference=_path(reference),
        indenters=_path(indenters),
        effects=tuple(map(Path, effects)),
        channels=tuple(channels or CHANNELS),
        candidates=tuple(candidates),
        alpha=alpha,
        budget=budget,
        seed=seed,
        workers=workers,
        discrepancy=_path(discrepancy),
        optical_noise=_path(optical_noise),
        next_presses=next_presses,
    )
    library = request.library()
    _effects_of(request)
    # That a file of the user's cannot be read says nothing about the data.
    load_discrepancy(request.discrepancy)
    if request.optical_noise is not None:
        load_optical_null(request.optical_noise)
    check_is_quasi_static(request.sensor)
    values_of(request.sensor)
    overlay = None
    with tempfile.TemporaryDirectory() as temporary:
        request = replace(request, directory=Path(temporary if out is None else out) / "run")
        try:
            data_set = read_data_set(request.measured)
            before = None if request.reference is None else read_data_set(request.reference)
            request = replace(request, measured=data_set, reference=before)
            if channels is None:
                request = replace(request, channels=channels_of(data_set))
            if out is not None:
                check_output_folder(out)
                finish_replacement(out)
                if next_presses:
                    remove_made(Path(out), FOLDER)
            findings, overlay = find_gap_with_images(request, progress or _silent)
        except EffectError:  # says nothing of the data
            raise
        except ValueError as error:
            findings = Findings(Verdict.UNUSABLE, f"The data cannot be used: {error}")
    if out is not None:
        write_report(out, findings, effects=library, overlay=overlay)
        if findings.questions:
            write_questions(Path(out), findings.questions, data_set, request.indenters)
    return findings


def fit_optical_noise(
    measured: str | Path,
    out: str | Path,
    *,
    sensor: str | Path | SensorSpecification = "sensor_a",
    run_folder: str | Path | None = None,
    reference: str | Path | None = None,
    indenters: str | Path | None = None,
    effects: Sequence[str | Path] = (),
    workers: Crew = 2,
    progress: Progress | None = None,
) -> OpticalNull:
    """Estimate the images' noise from data without an effect; `find_gap` takes it as
    `optical_noise`.

    It starts processes, so a script calls it below `if __name__ == "__main__":`.

    Args:
        measured: folder of a data set with images.
        out: file to write it to.
        sensor, reference, indenters, effects, workers, progress: as for `find_gap`.
        run_folder: where solves are kept; by default they are not.

    Raises:
        FileNotFoundError, ValueError: images that cannot be used; the text says why.
    """
    with tempfile.TemporaryDirectory() as temporary:
        request = GapRequest(
            measured=Path(measured),
            sensor=given_sensor(sensor),
            directory=Path(temporary if run_folder is None else run_folder),
            reference=_path(reference),
            indenters=_path(indenters),
            effects=tuple(map(Path, effects)),
            channels=(IMAGE,),
            workers=workers,
        )
        null = fit_noise_of_images(request, *read_measurements(request), progress or _silent)
    save_optical_null(null, Path(out))
    return null


def _path(given: str | Path | None) -> Path | None:
    return None if given is None else Path(given)


def _silent(_step: str, _done: int, _total: int) -> None:
    """Show nothing."""


def _effects_of(request: GapRequest) -> tuple[list[Effect], list[Effect]]:
    """Return the effects to look for that show in skin or force, and in images.

    Raises:
        ValueError: none of the candidates shows in the channels.
    """
    library = request.library()
    wanted = [library[name] for name in request.candidates] or list(library.values())
    has_presses = any(channel in MECHANICAL for channel in request.channels)
    mechanical = [effect for effect in wanted if has_presses and effect.image is None]
    has_images = IMAGE in request.channels
    optical = [effect for effect in wanted if has_images and effect.image is not None]
    if not mechanical and not optical:
        raise ValueError(
            f"none of {', '.join(request.candidates)} shows in {', '.join(request.channels)}; "
            "name another effect or channel"
        )
    return mechanical, optical


def find_gap_with_images(
    request: GapRequest, progress: Progress
) -> tuple[Findings, Overlay | None]:
    """Search a data set by the channels of a request, images among them.

    Raises:
        FileNotFoundError: a data set, an indenter or a file that is not there.
        ValueError: data that cannot be used by any channel; the text says why and what to do.
    """
    begun_s = time.monotonic()
    mechanical, optical = _effects_of(request)
    findings, overlay = None, None
    pressed = tuple(channel for channel in request.channels if channel != IMAGE and mechanical)
    channels = (*pressed, IMAGE) if optical else pressed
    measured = read_measurements(replace(request, channels=channels))
    if mechanical:
        names = tuple(e.name for e in mechanical) if request.candidates else ()
        only = replace(request, channels=pressed, candidates=names)
        findings, overlay = search_presses(only, *measured, progress)
    if findings is not None and not optical:
        return findings, overlay
    try:
        seen, found, digest, solves = find_optical(
            request, *measured, optical, findings, overlay, progress
        )
    except EffectError:
        raise
    except (ValueError, FileNotFoundError) as error:
        seen, found, digest, solves = unusable_images(str(error)), (), "", 0
    if findings is None:
        findings = Findings(
            Verdict.NO_GAP,
            "",
            alpha=request.alpha,
            mode="absolute" if request.reference is None else "differential",
            sensor=request.sensor.name,
        )
    findings = combined(findings, seen)
    data_hash = hashlib.sha256((findings.data_hash + digest).encode()).hexdigest()[:16]
    findings = replace(
        findings,
        solve_count=findings.solve_count + solves,
        seconds=time.monotonic() - begun_s,
        data_hash=data_hash,
    )
    effects = (() if overlay is None else overlay.effects) + found
    return findings, Overlay(request.sensor.name, data_hash, effects) if effects else None


def combined(findings: Findings, optical: OpticalFindings) -> Findings:
    """Return the findings of all channels: an effect of either part is named; what is unknown in
    either stays so where nothing is named."""
    alone = not findings.sentence
    parts = [optical.verdict] if alone else [findings.verdict, optical.verdict]
    order = (Verdict.NAMED, Verdict.SET, Verdict.UNKNOWN, Verdict.NO_GAP, Verdict.UNUSABLE)
    return replace(
        findings,
        verdict=min(parts, key=order.index),
        sentence=" ".join(text for text in (findings.sentence, optical.sentence) if text),
        named=findings.named + optical.named,
        alternatives=findings.alternatives + optical.alternatives,
        warnings=findings.warnings + optical.warnings,
        optical=optical,
    )
