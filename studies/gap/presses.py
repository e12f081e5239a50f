# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Measured presses in which nothing is missing, ready for the gap finder: what the library's
effects do to them, simulated once for all draws of cases."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from dotsim_ros.data.measurement import Measurement, read_measurement
from dotsim_ros.data.split import repeats_of
from dotsim_ros.effects.library import load_effects
from dotsim_ros.effects.simulate import open_solver
from dotsim_ros.gap.presses.assumptions import ABSOLUTE, DIFFERENTIAL, PressNuisance, centred
from dotsim_ros.gap.presses.covariance import ChannelNoise, Discrepancy
from dotsim_ros.gap.presses.evidence import Case, Variant, make_case
from dotsim_ros.gap.presses.search import simulate_effects
from dotsim_ros.gap.presses.search_state import GapRequest, Search
from dotsim_ros.gel.make import skin_of
from dotsim_ros.gel.values import values_of
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.files import cache_directory
from dotsim_ros.io.progress import PrintedProgress
from dotsim_ros.io.worker_pool.pool import Crew
from dotsim_ros.specification import SensorSpecification, load_sensor

Progress = Callable[[str, int, int], None]

CASE_SIZE = 8
"""Trajectories of a case."""
GRID = (0.15, 0.3, 0.6, 1.0)
"""Sizes at which effects are simulated, as shares of the way from none to each end of the range."""
NULL_DRAWS = 60
"""Simulated nulls of a case: fewer than a search takes."""
CLOSE = 0.2
"""A size that is nearer to one that is simulated, as a share of it, is left out."""


@dataclass(frozen=True)
class Source:
    """Where presses come from, and how they are simulated.

    Attributes:
        directory: data set in which nothing is missing.
        sensor: calibrated to it.
        run: folder of the solves.
        workers: how many processes, or workers of Ray.
        progress: called with the step, the number of solves done, and of all.
    """

    directory: Path
    sensor: SensorSpecification
    run: Path
    workers: Crew
    progress: Progress

    @cached_property
    def measurement(self) -> Measurement:
        """The presses, read once."""
        return read_measurement(self.directory, own_skin=skin_of(self.sensor.gel))

    def request(self, seed: int) -> GapRequest:
        """Return what a search of such presses is asked for."""
        return GapRequest(self.directory, self.sensor, self.run, budget=0, seed=seed)


def source_of(data: Path, sensor: str, cache: Path | None, workers: Crew) -> Source:
    """Return presses as the options of a study name them; solves are kept in the user's cache where
    no other is given."""
    kept = cache or cache_directory() / "gap"
    return Source(data, load_sensor(sensor), kept, workers, PrintedProgress())


@dataclass(frozen=True)
class Presses:
    """Presses without an effect, and what the library's effects do to them.

    Attributes:
        discrepancy: as the finder knows it.
        case: of all presses.
        variants: of the effects that they excite.
        screened: the same at the sizes of a search's first look alone.
        left_out: what could not be solved.
        skin: whose points were measured.
    """

    discrepancy: Discrepancy
    case: Case
    variants: list[Variant]
    screened: list[Variant]
    left_out: list[str]
    skin: SkinMesh


def halves(names: Sequence[str], seed: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return two halves of the trajectories; repeats of one protocol go to both."""
    random = np.random.default_rng(seed)
    first: list[str] = []
    second: list[str] = []
    for members in repeats_of(names).values():
        random.shuffle(members)
        half = len(members) // 2
        # An odd one goes to the smaller half.
        if len(members) % 2 and len(first) < len(second):
            half += 1
        first += members[:half]
        second += members[half:]
    return tuple(sorted(first)), tuple(sorted(second))


@contextmanager
def open_case(
    source: Source,
    names: Sequence[str],
    discrepancy: Discrepancy,
    nuisances: Sequence[PressNuisance],
    *,
    is_own_reference: bool = False,
) -> Iterator[tuple[Case, list[str], SkinMesh]]:
    """Open a case of some presses, without any effect yet; it comes with what was left out, and the
    skin whose points were measured.

    Args:
        source: of the presses.
        names: of those to use.
        discrepancy: as the finder knows it.
        nuisances: what the twin may be wrong about.
        is_own_reference: whether the same presses are their own commissioning: nothing has changed.
    """
    sensor = source.sensor
    measurement = source.measurement
    by_name = {recording.name: recording for recording in measurement.recordings}
    recordings = [by_name[name] for name in names]
    library, values = load_effects(), values_of(sensor)
    with open_solver(sensor, measurement.skin, source.run, workers=source.workers) as solver:
        case, left_out = make_case(
            recordings,
            recordings if is_own_reference else (),
            values=values,
            nuisances=nuisances,
            library=library,
            solver=solver,
            skin=measurement.skin,
            noise=ChannelNoise(),
            discrepancy=discrepancy,
            channels=("skin", "force"),
            progress=lambda done, total: source.progress("calibrate", done, total),
        )
        yield case, left_out, measurement.skin


@contextmanager
def open_presses(
    source: Source,
    names: Sequence[str],
    discrepancy: Discrepancy,
    *,
    is_differential: bool = False,
) -> Iterator[Presses]:
    """Open presses with every effect that they excite, simulated at several sizes."""
    nuisances = centred(DIFFERENTIAL if is_differential else ABSOLUTE, discrepancy.bias)
    opened = open_case(source, names, discrepancy, nuisances, is_own_reference=is_differential)
    with opened as (case, left_out, skin):
        everything = range(len(case.trajectories))
        search = search_of(case, everything, source.request(0), 0, discrepancy, source.progress)
        variants, _ = simulate_effects(
            search, lambda done, total: source.progress("screen", done, total)
        )
        screened = [replace(v, node=list(v.node), change=list(v.change)) for v in variants]
        case.extend(
            [(v, size) for v in variants for size in further_sizes(v)],
            progress=lambda done, total: source.progress("sizes", done, total),
        )
        yield Presses(discrepancy, case, variants, screened, left_out, skin)


def further_sizes(variant: Variant) -> list[float]:
    """Return sizes to simulate next to those that are."""
    parameter = variant.effect.parameters[0]
    sizes: list[float] = []
    for end in (parameter.low, parameter.high):
        for share in GRID:
            size = variant.absent + share * (end - variant.absent)
            known = [node for node in (*variant.node, *sizes) if node != variant.absent]
            away = abs(size - variant.absent)
            if away > 0.0 and all(abs(size - node) > CLOSE * away for node in known):
                sizes.append(size)
    return sizes


def silent(step: str, done: int, total: int) -> None:
    """Tell nothing."""


def search_of(
    case: Case,
    chosen: Sequence[int],
    request: GapRequest,
    seed: int,
    discrepancy: Discrepancy,
    progress: Progress = silent,
) -> Search:
    """Return a search of some trajectories of a case."""
    return Search(
        request=request,
        case=case,
        chosen=list(chosen),
        held_out=[],
        noise=ChannelNoise(),
        discrepancy=discrepancy,
        random=np.random.default_rng(seed),
        progress=progress,
    )


def draw_presses(count: int, random: np.random.Generator, wanted: int = CASE_SIZE) -> list[int]:
    """Return the numbers of a case's presses: so many of `count`, or all but one of few."""
    size = min(wanted, max(1, count - 1))
    return sorted(random.choice(count, size=size, replace=False).tolist())
