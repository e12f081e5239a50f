# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tries every effect of the library on the evidence, against what chance would give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dotsim_ros.data.recording import Recording
from dotsim_ros.effects.effect import FORCE, SKIN, Active, Effect
from dotsim_ros.effects.simulate import EffectRequest
from dotsim_ros.gap.presses.evidence import Case, Segment, Variant, shapes_of
from dotsim_ros.gap.presses.inference import Evidence, Fit, Products, fit, parts_of, settle
from dotsim_ros.gel.values import GelValues
from dotsim_ros.io.arrays import FloatArray


@dataclass(frozen=True)
class Trial:
    """The best of an effect's variants on some evidence.

    Attributes:
        segment: of it.
        size: of the effect.
        gain: by how much it lowers the objective of nuisances alone.
        fit: nuisances and weights with it.
        change: (n,) whitened, what it does at that size.
    """

    segment: Segment
    size: float
    gain: float
    fit: Fit
    change: FloatArray

    @property
    def variant(self) -> Variant:
        """The effect's."""
        return self.segment.variant


def try_segment(evidence: Evidence, segment: Segment, base: float) -> Trial:
    """Return the trial of one segment."""
    left = evidence.with_residual(evidence.residual - segment.offset)
    found = fit(left, segment.column[:, None], np.array([segment.low]), np.array([segment.high]))
    step = float(found.size[0])
    return Trial(
        segment,
        segment.begin + step,
        base - found.objective,
        found,
        segment.offset + step * segment.column,
    )


def best_trial(evidence: Evidence, segments: Sequence[Segment], base: float) -> Trial:
    """Return the segment that gains most."""
    return max((try_segment(evidence, s, base) for s in segments), key=lambda trial: trial.gain)


class Screen:
    """Segments on one evidence, ready for many residuals: what does not depend on the residual is
    computed once.

    Args:
        evidence: whose nuisances they stand next to.
        segments: of any effects; there may be none.
    """

    def __init__(self, evidence: Evidence, segments: Sequence[Segment] = ()) -> None:
        self._segments = tuple(segments)
        self._parts = parts_of(evidence.trajectory)
        self._nuisance = evidence.nuisance
        # The column of each segment, then the offset of each.
        both = [*(s.column for s in segments), *(s.offset for s in segments)]
        self._moved = np.reshape(both, (-1, len(evidence.residual))).T
        count = len(self._segments)
        nuisance, moved = self._by_trajectory(self._nuisance), self._by_trajectory(self._moved)
        self._gram = np.stack([n.T @ n for n in nuisance])
        self._across = np.stack([n.T @ m for n, m in zip(nuisance, moved, strict=True)])
        self._own = np.stack([np.sum(m**2, axis=0) for m in moved])
        self._mixed = np.stack([np.sum(m[:, :count] * m[:, count:], axis=0) for m in moved])
        self._rows = np.array([float(len(rows)) for rows in self._parts])

    def _by_trajectory(self, rows_of_all: FloatArray) -> list[FloatArray]:
        return [rows_of_all[rows] for rows in self._parts]

    def tries(
        self, residual: FloatArray, counts: FloatArray | None = None
    ) -> tuple[float, FloatArray, FloatArray]:
        """Return the objective of the nuisances alone, by how much each segment lowers it (k,), and
        the size of its effect there (k,).

        Args:
            residual: (n,).
            counts: (T,) how often each trajectory counts; None for once each.
        """
        counts = np.ones(len(self._parts)) if counts is None else counts
        parts = self._by_trajectory(residual)
        square = np.array([part @ part for part in parts])
        right, moved = (
            np.stack([part @ m for part, m in zip(parts, self._by_trajectory(of), strict=True)])
            for of in (self._nuisance, self._moved)
        )
        nothing = np.zeros(0)
        alone = Products(self._gram, right, square, self._rows, counts)
        base = settle(alone, nothing, nothing).objective
        q, count = right.shape[1], len(self._segments)
        gains, sizes = np.zeros((2, count))
        gram = np.empty((len(parts), q + 1, q + 1))
        gram[:, :q, :q] = self._gram
        for k, segment in enumerate(self._segments):
            gram[:, q, :q] = gram[:, :q, q] = self._across[:, :, k]
            gram[:, q, q] = self._own[:, k]
            column = moved[:, k] - self._mixed[:, k]
            known = Products(
                gram,
                np.column_stack([right - self._across[:, :, count + k], column]),
                square - 2.0 * moved[:, count + k] + self._own[:, count + k],
                self._rows,
                counts,
            )
            found = settle(known, np.array([segment.low]), np.array([segment.high]))
            gains[k] = base - found.objective
            sizes[k] = segment.begin + found.size[0]
        return base, gains, sizes


def planned_requests(
    measured: Sequence[Recording],
    values: GelValues,
    library: Mapping[str, Effect],
    candidates: Sequence[str] = (),
) -> list[EffectRequest]:
    """Return what screening will simulate along recordings of which all channels are there: every
    effect that one of them excites, at its probes.

    Args:
        measured: along which the effects are simulated.
        values: the twin's gel.
        library: effects by name.
        candidates: names of the effects to look at; none for all.
    """
    requests = []
    for effect in _wanted(library, candidates):
        if not any(map(effect.excited_by, measured)):
            continue
        size = effect.parameters[0]
        for shape in shapes_of(effect):
            for probe in size.probes:
                active = Active(effect, effect.checked({size.name: probe, **shape}))
                requests += [EffectRequest(r, values, effects=[active]) for r in measured]
    return requests


def excited_variants(case: Case, candidates: Sequence[str] = ()) -> tuple[list[Variant], list[str]]:
    """Return the variants of the effects that the data excite, and the names of the others."""
    variants, silent = [], []
    for effect in _wanted(case.library, candidates):
        if case.excited(effect):
            variants += case.variants(effect)
        else:
            silent.append(effect.name)
    return variants, silent


def _wanted(library: Mapping[str, Effect], candidates: Sequence[str]) -> list[Effect]:
    """Return the effects that show in skin or force, of the candidates or of all."""
    return [
        effect
        for effect in library.values()
        if {SKIN, FORCE} & set(effect.channels) and (not candidates or effect.name in candidates)
    ]
