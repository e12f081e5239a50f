# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What is searched, how, and what the steps of a search share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from dotsim_ros.data.data_set import DataSet, indenter_files
from dotsim_ros.effects.effect import FORCE, IMAGE, SKIN, Effect
from dotsim_ros.effects.library import effect_names, load_effects
from dotsim_ros.effects.overlay import Estimate
from dotsim_ros.gap import decision
from dotsim_ros.gap.presses.covariance import ChannelNoise, Discrepancy
from dotsim_ros.gap.presses.evidence import Case, Segment, Variant
from dotsim_ros.gap.presses.inference import Evidence, Fit, fit_nuisances
from dotsim_ros.gap.presses.screening import Trial
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.worker_pool.pool import Crew, check_workers
from dotsim_ros.specification import SensorSpecification

MECHANICAL = (SKIN, FORCE)
CHANNELS = (*MECHANICAL, IMAGE)
Progress = Callable[[str, int, int], None]
"""Called with a step's name, how much of it is done, and of how much."""
PATTERN_DEVIATION = 20.0
"""Prior of a pattern, in its percents of the press."""


@dataclass(frozen=True)
class GapRequest:
    """What to search, and how; one that no search could be run with is refused.

    Attributes are the arguments of `dotsim_ros.gap.find.find_gap`, and:
        directory: of the run: solves are kept there.

    Raises:
        FileNotFoundError: no such folder of effects, or file.
        ValueError: an argument that is out of range or names nothing.
    """

    measured: Path | DataSet
    sensor: SensorSpecification
    directory: Path
    reference: Path | DataSet | None = None
    indenters: Path | None = None
    effects: tuple[Path, ...] = ()
    channels: tuple[str, ...] = MECHANICAL
    candidates: tuple[str, ...] = ()
    alpha: float = 0.02
    budget: int | None = None
    seed: int = 0
    workers: Crew = 2
    discrepancy: Path | None = None
    optical_noise: Path | None = None
    next_presses: int = 0

    def __post_init__(self) -> None:
        # No file of the user's is run for it.
        known = effect_names(self.effects)
        for kind, named, there in (
            ("channel", self.channels, CHANNELS),
            ("effect", self.candidates, known),
        ):
            strange = sorted(set(named) - set(there))
            if strange:
                raise ValueError(f"no {kind} {', '.join(strange)}; known are {', '.join(there)}")
        if not 0.0 < self.alpha < 1.0:
            raise ValueError(f"alpha is {self.alpha}, expected between 0 and 1")
        check_workers(self.workers)
        for name, count, least in (
            ("budget", self.budget, 0),
            ("seed", self.seed, 0),
            ("next_presses", self.next_presses, 0),
        ):
            if count is not None and count < least:
                raise ValueError(f"{name} is {count}, expected {least} or more")
        for path in (self.indenters, self.discrepancy, self.optical_noise):
            if path is not None and not path.exists():
                raise FileNotFoundError(f"there is nothing at {path}")
        if self.indenters is not None and not indenter_files(self.indenters):
            raise ValueError(
                f"indenters is {self.indenters}, expected a folder of meshes, NAME.stl each"
            )

    def library(self) -> dict[str, Effect]:
        """Return the effects, shipped and the user's; with candidates no other file is run."""
        return load_effects(self.effects, names=self.candidates or None)


@dataclass
class Ranked:
    """An effect during the search."""

    effect: Effect
    variants: list[Variant]
    trial: Trial
    estimates: tuple[Estimate, ...] = ()
    explained: float | None = None
    held_out_gain: float | None = None
    limit: float = np.inf

    @property
    def is_past_limit(self) -> bool:
        """Whether it gains more than data without any effect let it gain."""
        return self.trial.gain > self.limit

    @property
    def end(self) -> float | None:
        """The end of its plausible range that its size stands at, None for a size within."""
        return self.effect.parameters[0].end_at(self.trial.size)


@dataclass
class Search:
    """What the steps share."""

    request: GapRequest
    case: Case
    chosen: list[int]
    held_out: list[int]
    noise: ChannelNoise
    discrepancy: Discrepancy
    random: np.random.Generator
    progress: Progress
    warnings: list[str] = field(default_factory=list)
    pattern_chance: float = 0.0
    _segments: dict[tuple[int, int], list[Segment]] = field(default_factory=dict)

    def without(self, number: int) -> Search:
        """Return a search of the same without one of the chosen trajectories, which simulates no
        further size and keeps its draws and warnings to itself."""
        return replace(
            self,
            request=replace(self.request, budget=0),
            chosen=[one for one in self.chosen if one != number],
            random=np.random.default_rng(self.request.seed),
            warnings=[],
            _segments={},
        )

    @cached_property
    def evidence(self) -> Evidence:
        """What the chosen trajectories show."""
        return self.case.evidence(self.chosen)

    @cached_property
    def base(self) -> Fit:
        """The twin recalibrated, without any effect."""
        return fit_nuisances(self.evidence)

    @cached_property
    def pattern_columns(self) -> FloatArray:
        """(n, K) what a pattern does when it moves by one deviation of its prior."""
        return PATTERN_DEVIATION * self.case.pattern_columns(self.chosen)

    @cached_property
    def misfit_limit(self) -> float:
        """Largest objective of an observable that data without any effect leave, as the
        commissioning shows where there is one."""
        reference = [
            place for place, k in enumerate(self.chosen) if self.case.trajectories[k].is_reference
        ]
        if not reference:
            return self.discrepancy.misfit_limit + decision.MISFIT_OF_UNITS
        known = self.evidence.of(reference)
        return fit_nuisances(known).objective / len(known.residual) + decision.MISFIT_SINCE

    @property
    def least_factor(self) -> float:
        """By how much true data gain more than simulated ones, at the least."""
        return decision.least_factor(is_representative=self.discrepancy.is_representative)

    def segments(self, variants: Sequence[Variant]) -> list[Segment]:
        """Return the segments of variants; they are whitened once for each set of nodes."""
        result = []
        for variant in variants:
            key = id(variant), len(variant.node)
            if key not in self._segments:
                self._segments[key] = self.case.segments(variant, self.chosen)
            result += self._segments[key]
        return result

    def has_budget(self, variants: int) -> bool:
        """Return whether so many variants may still be simulated along the trajectories.

        What is asked for counts, not what is solved: a run that finds solves on disk takes the same
        steps as one that does not.
        """
        if self.request.budget is None:
            return True
        asked = self.case.solver.asked_count / len(self.case.trajectories)
        return asked + variants <= self.request.budget

    @cached_property
    def bootstraps(self) -> FloatArray:
        """(BOOTSTRAPS, T) how often each chosen trajectory counts in each repetition."""
        return decision.bootstrap_weights(len(self.chosen), decision.BOOTSTRAPS, self.random)
