# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""From recordings to whitened evidence: what was measured, what the twin gives, and what nuisances
and effects do to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from dotsim_ros.data.recording import Recording
from dotsim_ros.effects.effect import FORCE, SKIN, Active, Effect
from dotsim_ros.effects.simulate import EffectRequest, EffectSolver
from dotsim_ros.gap.presses.assumptions import (
    OWN,
    PressNuisance,
    nuisance_columns,
    nuisance_requests,
)
from dotsim_ros.gap.presses.covariance import (
    ChannelNoise,
    Discrepancy,
    Whitening,
    usable,
    whitening_of,
)
from dotsim_ros.gap.presses.inference import Evidence
from dotsim_ros.gap.presses.observables import CHANNELS, SIZE, Places, observe, places_of
from dotsim_ros.gap.presses.patterns import patterns
from dotsim_ros.gel.values import GelValues
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray, IntArray
from dotsim_ros.twin.follow import SimulatedPress, SolveError
from dotsim_ros.twin.solver import Progress


@dataclass(frozen=True)
class EvidenceTrajectory:
    """A recording with what was observed and predicted.

    Attributes:
        recording: as measured.
        is_reference: whether it is of the commissioning.
        places: of its observables.
        observed, predicted: (F, SIZE) measured, and of the twin.
        whitening: of its observables.
        nuisance: (q, F, SIZE).
        pattern: (K, F, SIZE).
    """

    recording: Recording
    is_reference: bool
    places: Places
    observed: FloatArray
    predicted: FloatArray
    whitening: Whitening
    nuisance: FloatArray
    pattern: FloatArray


@dataclass
class Variant:
    """An effect with the parameters that shape it fixed: what it does at some sizes, its nodes.

    Attributes:
        effect: the effect.
        shape: its parameters next to the first.
        node: sizes that were simulated, the absent effect's among them.
        change: at each node, by trajectory, (F, SIZE): with the effect minus without; None for a
            trajectory along which it was not simulated.
    """

    effect: Effect
    shape: dict[str, float]
    node: list[float] = field(default_factory=list)
    change: list[list[FloatArray | None]] = field(default_factory=list)

    @property
    def absent(self) -> float:
        """Size of the absent effect."""
        none = self.effect.parameters[0].none
        assert none is not None
        return none

    def values(self, size: float) -> dict[str, float]:
        """Return the values of all parameters at a size."""
        return {self.effect.parameters[0].name: size, **self.shape}

    def put(self, size: float, change: Sequence[FloatArray | None]) -> None:
        """Add a node, in order."""
        place = int(np.searchsorted(self.node, size))
        self.node.insert(place, size)
        self.change.insert(place, list(change))


@dataclass(frozen=True)
class Segment:
    """An effect between two nodes, where it is taken as linear.

    Attributes:
        variant: of the effect.
        begin: size at its begin.
        offset: (n,) whitened change at the begin.
        column: (n,) whitened change for one unit of size.
        low, high: bounds of the size beyond the begin.
    """

    variant: Variant
    begin: float
    offset: FloatArray
    column: FloatArray
    low: float
    high: float

    def of_rows(self, rows: IntArray) -> Segment:
        """Return what is left of it on some of the observables."""
        return replace(self, offset=self.offset[rows], column=self.column[rows])


class Column(NamedTuple):
    """A nuisance of the evidence, its name there, and the data that it belongs to: those of the
    reference, those of the others, None for both."""

    nuisance: PressNuisance
    name: str
    of_reference: bool | None


@dataclass
class Case:
    """A measured data set, with a reference or without, ready to be searched.

    Attributes:
        trajectories: of the reference first.
        nuisances: what the twin may be wrong about.
        library: effects by name.
        solver: to simulate with.
        values: the twin's gel.
        rest_m: (V, 3) of the skin.
    """

    trajectories: Sequence[EvidenceTrajectory]
    nuisances: Sequence[PressNuisance]
    library: Mapping[str, Effect]
    solver: EffectSolver
    values: GelValues
    rest_m: FloatArray

    def evidence(self, chosen: Sequence[int]) -> Evidence:
        """Return the evidence of some trajectories."""
        parts = [self.trajectories[t] for t in chosen]
        columns = [self._nuisance_columns(t) for t in parts]
        centre = np.array([column.nuisance.centre for column in self.columns()])
        residual = [
            t.whitening.whiten(t.observed - t.predicted) - column @ centre
            for t, column in zip(parts, columns, strict=True)
        ]
        number = np.repeat(np.arange(len(parts)), [len(r) for r in residual])
        return Evidence(np.concatenate(residual), np.concatenate(columns), number)

    def columns(self) -> list[Column]:
        """Return the evidence's nuisances, in order."""
        own = [n for n in self.nuisances if n.belongs == OWN]
        return [
            *(Column(n, n.name, None) for n in self.nuisances if n.belongs != OWN),
            *(Column(n, f"{n.name} (reference)", True) for n in own),
            *(Column(n, n.name, False) for n in own),
        ]

    def _column_numbers(self, t: EvidenceTrajectory) -> list[int | None]:
        """Return which of a trajectory's nuisances each column of the evidence is, None for those
        of other data."""
        place = {n.name: k for k, n in enumerate(self.nuisances)}
        return [
            place[column.nuisance.name] if column.of_reference in (None, t.is_reference) else None
            for column in self.columns()
        ]

    def _nuisance_columns(self, t: EvidenceTrajectory) -> FloatArray:
        """Return (n_t, columns) whitened."""
        white = [t.whitening.whiten(column) for column in t.nuisance]
        nothing = np.zeros(t.whitening.size)
        numbers = self._column_numbers(t)
        return np.stack([nothing if k is None else white[k] for k in numbers], axis=1)

    def moved(self, number: int, nuisance: FloatArray) -> FloatArray:
        """Return (F, SIZE) what the evidence's nuisances, (columns,) from their means, do to a
        trajectory."""
        t = self.trajectories[number]
        share = np.zeros(len(self.nuisances))
        for k, moved in zip(self._column_numbers(t), nuisance.tolist(), strict=True):
            if k is not None:
                share[k] = self.nuisances[k].centre + moved
        result: FloatArray = np.tensordot(share, t.nuisance, axes=1)
        return result

    def whitened(self, change: Sequence[FloatArray | None], chosen: Sequence[int]) -> FloatArray:
        """Return (n,) of a change by trajectory, which is there for those that are chosen."""
        parts = []
        for number in chosen:
            one = change[number]
            assert one is not None
            parts.append(self.trajectories[number].whitening.whiten(one))
        return np.concatenate(parts)

    def pattern_columns(self, chosen: Sequence[int]) -> FloatArray:
        """Return (n, K) whitened patterns of the measured data, those that are there."""
        each = np.eye(len(self.trajectories[0].pattern))
        return np.stack([self.whitened(self.pattern_change(s), chosen) for s in each], axis=1)

    def pattern_change(self, share: FloatArray) -> list[FloatArray]:
        """Return (F, SIZE) of each trajectory: what patterns do at sizes (K,)."""
        return [
            np.zeros_like(t.predicted) if t.is_reference else np.tensordot(share, t.pattern, axes=1)
            for t in self.trajectories
        ]

    def change_at(self, variant: Variant, size: float) -> list[FloatArray | None]:
        """Return (F, SIZE) of each trajectory: what a variant does at a size, linear between the
        nodes next to it and beyond the outermost; None where those were not simulated."""
        node = variant.node
        right = _node_after(variant, size)
        share = (size - node[right - 1]) / (node[right] - node[right - 1])
        return [
            None if before is None or after is None else (1.0 - share) * before + share * after
            for before, after in zip(variant.change[right - 1], variant.change[right], strict=True)
        ]

    def change_everywhere(
        self, variant: Variant, size: float
    ) -> tuple[list[FloatArray], list[str]]:
        """Return as `change_at`, the nodes next to the size simulated where they were not, and what
        could not be solved."""
        right = _node_after(variant, size)
        failures = self._fill(
            [
                (
                    variant,
                    variant.node[k],
                    [n for n, one in enumerate(variant.change[k]) if one is None],
                )
                for k in (right - 1, right)
            ]
        )
        change = [one for one in self.change_at(variant, size) if one is not None]
        return change, failures

    def channel_columns(self, variant: Variant, size: float, chosen: Sequence[int]) -> FloatArray:
        """Return (n, 2) whitened: what a variant at a size does to the skin alone, and to the force
        alone."""
        change = self.change_at(variant, size)
        number = np.arange(SIZE)
        columns = []
        for channel in CHANNELS.values():
            is_shown = (number >= channel.start) & (number < channel.stop)
            alone = [None if one is None else np.where(is_shown, one, 0.0) for one in change]
            columns.append(self.whitened(alone, chosen))
        return np.stack(columns, axis=1)

    def excited(self, effect: Effect) -> bool:
        """Return whether a measured trajectory excites an effect, in a channel that is there."""
        measured = [t for t in self.trajectories if not t.is_reference]
        has_skin = any(t.recording.press.skin_position_m is not None for t in measured)
        has_force = any(t.recording.press.force_n is not None for t in measured)
        seen = (has_skin and SKIN in effect.channels) or (has_force and FORCE in effect.channels)
        return seen and any(effect.excited_by(t.recording) for t in measured)

    def variants(self, effect: Effect) -> list[Variant]:
        """Return the variants of an effect, with the absent effect as their only node."""
        nothing = [np.zeros_like(t.predicted) for t in self.trajectories]
        result = []
        for shape in shapes_of(effect):
            variant = Variant(effect, shape)
            variant.put(variant.absent, nothing)
            result.append(variant)
        return result

    def extend(
        self,
        wanted: Sequence[tuple[Variant, float]],
        progress: Progress | None = None,
        among: Sequence[int] | None = None,
    ) -> list[str]:
        """Simulate variants at sizes and add the nodes; return what could not be solved.

        Args:
            wanted: variants and sizes.
            progress: called with the number of solves done, and of all.
            among: numbers of the trajectories along which they are simulated; None for all.
        """
        numbers = range(len(self.trajectories)) if among is None else among
        for variant, size in wanted:
            variant.put(size, [None] * len(self.trajectories))
        return self._fill([(variant, size, numbers) for variant, size in wanted], progress)

    def _fill(
        self,
        wanted: Sequence[tuple[Variant, float, Sequence[int]]],
        progress: Progress | None = None,
    ) -> list[str]:
        """Simulate each variant at the size of one of its nodes along some trajectories; return
        what could not be solved: there is no change there, as along the reference's."""
        requests, owners = [], []
        for variant, size, numbers in wanted:
            change = variant.change[variant.node.index(size)]
            active = Active(variant.effect, variant.effect.checked(variant.values(size)))
            for number in numbers:
                t = self.trajectories[number]
                change[number] = np.zeros_like(t.predicted)
                if not t.is_reference:
                    requests.append(EffectRequest(t.recording, self.values, effects=[active]))
                    owners.append((change, number))
        results, failures = self.solver.run_each(requests, progress)
        for (change, number), result in zip(owners, results, strict=True):
            if result is not None:
                t = self.trajectories[number]
                shown = observed_of(t.recording, t.places, result, self.rest_m)
                change[number] = shown - t.predicted
        return failures

    def segments(self, variant: Variant, chosen: Sequence[int]) -> list[Segment]:
        """Return the segments between a variant's nodes, and beyond the outermost within range."""
        parameter = variant.effect.parameters[0]
        white = [self.whitened(change, chosen) for change in variant.change]
        result = []
        last = len(variant.node) - 1
        for k in range(last):
            width = variant.node[k + 1] - variant.node[k]
            low, high = 0.0, width
            if k == 0:
                low = min(0.0, parameter.low - variant.node[0])
            if k == last - 1:
                high = max(width, parameter.high - variant.node[k])
            # Towards an absent effect a secant says nothing of the other side.
            if variant.node[k] == variant.absent:
                low = 0.0
            if variant.node[k + 1] == variant.absent:
                high = width
            column = (white[k + 1] - white[k]) / width
            result.append(Segment(variant, variant.node[k], white[k], column, low, high))
        return result


def shapes_of(effect: Effect) -> list[dict[str, float]]:
    """Return the values at which the parameters next to the size are tried."""
    others = effect.parameters[1:]
    tried = product(*(parameter.probes for parameter in others))
    return [dict(zip((p.name for p in others), values, strict=True)) for values in tried]


def _node_after(variant: Variant, size: float) -> int:
    """Return the place of the node above a size, of the outermost where there is none."""
    return int(np.clip(np.searchsorted(variant.node, size), 1, len(variant.node) - 1))


def observed_of(
    recording: Recording, places: Places, simulated: SimulatedPress, rest_m: FloatArray
) -> FloatArray:
    """Return the observables (F, SIZE) of a simulation, in the channels that were measured."""
    press = recording.press
    skin = None if press.skin_position_m is None else simulated.skin_position_m
    force = None if press.force_n is None else simulated.force_n
    return observe(places, rest_m, skin, force, press.frame_count)


def make_case(
    recordings: Sequence[Recording],
    reference: Sequence[Recording],
    *,
    values: GelValues,
    nuisances: Sequence[PressNuisance],
    library: Mapping[str, Effect],
    solver: EffectSolver,
    skin: SkinMesh,
    noise: ChannelNoise,
    discrepancy: Discrepancy,
    channels: Sequence[str],
    progress: Progress | None = None,
) -> tuple[Case, list[str]]:
    """Simulate the twin and its nuisances along recordings.

    Args:
        recordings: measured.
        reference: of the commissioning; none in absolute mode.
        values: the twin's gel.
        nuisances: what it may be wrong about.
        library: effects by name.
        solver: of the gel.
        skin: the skin's markers.
        noise, discrepancy: of measurement and model.
        channels: that are used.
        progress: called with the number of solves done, and of all.

    Returns:
        The case, its trajectories of the reference first, and what had to be left out.
    """
    every = [(r, True) for r in reference] + [(r, False) for r in recordings]
    requests = [nuisance_requests(r, values, library) for r, _ in every]
    results, _ = solver.run_each([q for group in requests for q in group], progress)
    answers = iter(results)
    rest = skin.rest_position_m
    trajectories, left_out = [], []
    for (recording, is_reference), group in zip(every, requests, strict=True):
        asked = [next(answers) for _ in group]
        solved = [answer for answer in asked if answer is not None]
        if len(solved) < len(asked):
            left_out.append(
                f"{recording.name} was left out: the gel could not be solved at its poses, which "
                "may press deeper than the gel allows"
            )
            continue
        recording = _with_channels(recording, channels)
        press = recording.press
        places = places_of(recording, skin)
        observed = usable(
            recording,
            observe(places, rest, press.skin_position_m, press.force_n, press.frame_count),
        )
        simulated = [observed_of(recording, places, answer, rest) for answer in solved]
        columns = np.stack(nuisance_columns(nuisances, simulated, is_reference=is_reference))
        whitening = whitening_of(
            recording,
            places,
            observed,
            noise=noise,
            discrepancy=discrepancy,
            own=columns[[n.belongs == OWN for n in nuisances]],
        )
        trajectories.append(
            EvidenceTrajectory(
                recording,
                is_reference,
                places,
                observed,
                simulated[0],
                whitening,
                columns,
                patterns(recording, simulated[0], places.axes),
            )
        )
    if all(t.is_reference for t in trajectories):
        raise SolveError("no trajectory could be solved:\n" + "\n".join(left_out))
    return Case(trajectories, nuisances, library, solver, values, rest), left_out


def _with_channels(recording: Recording, channels: Sequence[str]) -> Recording:
    press = recording.press
    return replace(
        recording,
        press=replace(
            press,
            skin_position_m=press.skin_position_m if SKIN in channels else None,
            force_n=press.force_n if FORCE in channels else None,
        ),
    )
