# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The rule of the images: which optical effects are named, how large they are, what is unknown.

The best effect's signature is recreated at the size found (a secant instead of the probe's), its
shape searched about the best probe. A second effect enters past the threshold and with a share of
what the first one leaves (`decision.FURTHER`). What the named ones leave is compared with what
trajectories leave in which nothing is missing.

Where a size stands at an end of its plausible range, the range is opened there
(`EffectParameter.beyond`). If the images ask for a size out there, farther from the end than noise
and the model's error let it be, the effect imitates something else: what is missing is unknown,
unless an effect that takes off as much is within its own range. Presses name such an effect where
it leaves nothing of held-out trajectories; of images none are held out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dotsim_ros.effects.effect import Active, Effect, EffectParameter
from dotsim_ros.effects.overlay import Estimate
from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import Verdict
from dotsim_ros.gap.images.case import OpticalCase, Shot
from dotsim_ros.gap.images.null import OpticalNull
from dotsim_ros.gap.images.search import (
    CameraNuisance,
    Direction,
    EffectScore,
    OpticalSearch,
    Signature,
    camera_nuisances,
    freed,
    probes_of,
    signatures_of,
)
from dotsim_ros.gap.images.tile_noise import TileNoise
from dotsim_ros.io.arrays import FloatArray

ROUNDS = 2
"""How often a signature is recreated."""
SMALLEST_STEP = 0.2
"""A signature is made with this share of its probe at least: shorter ones are all rounding."""
MOST_EFFECTS = 2


@dataclass(frozen=True)
class Fitted:
    """An effect at the size that was found.

    Attributes:
        effect: it.
        score: of its refined signature.
        signature: made at the size found.
    """

    effect: Effect
    score: EffectScore
    signature: Signature

    @property
    def active(self) -> Active:
        """The effect at work."""
        return Active(self.effect, self.effect.checked(self.score.values))


@dataclass(frozen=True)
class BeyondRange:
    """A size that images ask an effect for, and that it can hardly have.

    Attributes:
        effect: it.
        parameter: that is beyond its range.
        value: of it.
    """

    effect: Effect
    parameter: EffectParameter
    value: float


@dataclass(frozen=True)
class OpticalAnswer:
    """What the rule makes of images; most of it as in `OpticalFindings`.

    Attributes:
        scores: of all effects, the best first.
        estimates: the parameters of each named effect.
        beyond: why the effect that explains most is not named, where it asks for too large a size.
    """

    verdict: Verdict
    scores: tuple[EffectScore, ...]
    statistic: float
    threshold: float
    excess: float
    largest_excess: float
    explained: float = 0.0
    named: tuple[Fitted, ...] = ()
    alternatives: tuple[str, ...] = ()
    estimates: Mapping[str, tuple[Estimate, ...]] = field(default_factory=dict)
    stability: float | None = None
    beyond: BeyondRange | None = None


class ImageSearch:
    """Looks for optical effects in some trajectories of a case.

    Args:
        case: of all images.
        shots: those to search.
        effects: to look for; all known to the null.
        null: what images show where nothing is missing.
        alpha: probability of a name on data without any effect.
        seed: of the draws.
        signatures: of the effects on these shots, where they were made before.
    """

    def __init__(
        self,
        case: OpticalCase,
        shots: Sequence[Shot],
        effects: Sequence[Effect],
        null: OpticalNull,
        *,
        alpha: float,
        seed: int,
        signatures: Mapping[str, Sequence[Signature]] | None = None,
    ) -> None:
        self.case, self.shots, self.null, self.alpha = case, list(shots), null, alpha
        self._effects = {effect.name: effect for effect in effects}
        self._random = np.random.default_rng(seed)
        self._films = [shot.film for shot in self.shots]
        self._changes = [shot.change for shot in self.shots]
        self.noise: TileNoise = null.at(case.meter, case.camera)
        self.nuisances: tuple[CameraNuisance, ...] = camera_nuisances(self._films, case.meter)
        if signatures is None:
            signatures = signatures_of(effects, self._films, case.meter)
        self.signatures = dict(signatures)
        self.search = self._searching(self.signatures)
        self.threshold = self.search.threshold(alpha, seed=seed)

    def _searching(self, signatures: Mapping[str, Sequence[Signature]]) -> OpticalSearch:
        spurious = {
            name: [self.null.variances(name, one) for one in several]
            for name, several in signatures.items()
        }
        return OpticalSearch(signatures, self.noise, self.nuisances, self._changes, spurious)

    def answer(self, residuals: Sequence[FloatArray] | None = None) -> OpticalAnswer:
        """Return what the rule makes of residuals (F, T, 6) of the shots; None for their own."""
        measured = [s.residual for s in self.shots] if residuals is None else list(residuals)
        scores = self.search.score(measured)
        count = sum(one.size for one in measured)
        most = self.null.largest_excess(self.alpha)
        before = self._square(measured)
        answer = OpticalAnswer(
            Verdict.UNKNOWN if before / count > most else Verdict.NO_GAP,
            scores=tuple(scores),
            statistic=max(score.statistic for score in scores),
            threshold=self.threshold,
            excess=before / count,
            largest_excess=most,
        )
        able = [score for score in scores if score.statistic > self.threshold]
        if not able:
            return answer
        named, left, beyond = self._plausible(measured, able)
        gained = before - left
        explained = gained / max(gained + max(left - most * count, 0.0), 1e-9)
        answer = replace(
            answer,
            verdict=Verdict.UNKNOWN,
            explained=float(np.clip(explained, 0.0, 1.0)),
            beyond=beyond,
        )
        if beyond is not None or explained < decision.EXPLAINED:
            return answer
        alternatives = self._alternatives(measured, scores, named[0]) if len(named) == 1 else ()
        weights = decision.bootstrap_weights(len(self.shots), decision.BOOTSTRAPS, self._random)
        alone = [
            (one, self._without(measured, [other for other in named if other is not one]))
            for one in named
        ]
        return replace(
            answer,
            verdict=Verdict.SET if alternatives else Verdict.NAMED,
            named=tuple(named),
            alternatives=alternatives,
            estimates=self._estimates(alone, weights),
            stability=self._stability(alone, alternatives, weights),
        )

    def _plausible(
        self, measured: Sequence[FloatArray], able: Sequence[EffectScore]
    ) -> tuple[list[Fitted], float, BeyondRange | None]:
        """Return the effects that are added, the square that they leave, and which of them asks for
        a size beyond its range; what takes off as much within its own range takes their place.
        """
        named, left = self._named(measured, able[0])
        beyond = self._beyond(measured, named)
        if beyond is None:
            return named, left, None
        for other in able[1 : decision.SCREENED]:
            others, rest = self._named(measured, other)
            if rest < left + decision.SAME and self._beyond(measured, others) is None:
                return others, rest, None
        return named, left, beyond

    def _beyond(
        self, measured: Sequence[FloatArray], named: Sequence[Fitted]
    ) -> BeyondRange | None:
        """Return the size beyond its plausible range that images ask an effect for, None where they
        are explained as well within."""
        for one in named:
            rest = self._without(measured, [other for other in named if other is not one])
            found = self._beyond_of(rest, one)
            if found is not None:
                return found
        return None

    def _beyond_of(self, residuals: Sequence[FloatArray], one: Fitted) -> BeyondRange | None:
        """Return as `_beyond` of one effect, next to nothing."""
        values = one.score.values
        parameters = {parameter.name: parameter for parameter in one.effect.parameters}
        directions = tuple(
            _opened(d, parameters[d.name], values[d.name]) for d in one.signature.directions
        )
        if directions == one.signature.directions:
            return None
        opened = replace(one.signature, directions=directions)
        search = self._searching({one.effect.name: (opened,)})
        further = search.score(residuals)[0].values
        if search.apart(further, values) <= decision.SAME:
            return None
        for parameter in one.effect.parameters:
            value = further[parameter.name]
            if not parameter.low <= value <= parameter.high:
                return BeyondRange(one.effect, parameter, value)
        return None

    def _square(self, residuals: Sequence[FloatArray]) -> float:
        """Return the square of a residual, whitened and free of nuisances."""
        whitened = self.search.whitened(residuals)
        return float(whitened @ whitened)

    def _without(
        self, residuals: Sequence[FloatArray], named: Sequence[Fitted]
    ) -> list[FloatArray]:
        """Return what named effects leave of residuals."""
        return without_effects(self.case, self.shots, residuals, named)

    def _named(
        self, measured: Sequence[FloatArray], first: EffectScore
    ) -> tuple[list[Fitted], float]:
        """Return the effects that are added, and the square that they leave."""
        named = [self._refined(measured, first)]
        rest = self._without(measured, named)
        left = self._square(rest)
        floor = self.null.largest_excess(self.alpha) * sum(one.size for one in measured)
        while len(named) < MOST_EFFECTS:
            others = [s for s in self.search.score(rest) if s.name != named[0].effect.name]
            second = next((s for s in others if s.statistic > self.threshold), None)
            if second is None:
                break
            added = self._refined(rest, second)
            # The first one took what belongs to the second, too.
            again = self._refined(self._without(measured, [added]), named[0].score)
            both = [again, added]
            rest = self._without(measured, both)
            least = self._square(rest)
            if left - least < decision.FURTHER * max(left - floor, 0.0) or left <= floor:
                break
            named, left = both, least
        return named, left

    def _refined(self, residuals: Sequence[FloatArray], score: EffectScore) -> Fitted:
        """Return an effect fitted with a signature made at the size found, and its shape searched
        about the best probe's."""
        effect = self._effects[score.name]
        best = self._tried(effect, score.values, residuals)
        reach = 1.0
        for _ in range(ROUNDS):
            for parameter in effect.parameters:
                if parameter.none is not None:
                    continue
                for value in _beside(parameter, best.score.values[parameter.name], reach):
                    values = {**best.score.values, parameter.name: value}
                    other = self._tried(effect, values, residuals)
                    if other.score.fit > best.score.fit:
                        best = other
            reach *= 0.5
            best = self._tried(effect, best.score.values, residuals)
        return best

    def _tried(
        self, effect: Effect, values: Mapping[str, float], residuals: Sequence[FloatArray]
    ) -> Fitted:
        """Return an effect fitted with a signature made at some values."""
        probed = _probed_at(effect, values)
        signatures = signatures_of([probed], self._films, self.case.meter)
        score = self._searching(signatures).score(residuals)[0]
        return Fitted(effect, score, signatures[effect.name][0])

    def _alternatives(
        self, measured: Sequence[FloatArray], scores: Sequence[EffectScore], best: Fitted
    ) -> tuple[str, ...]:
        """Return the effects that the data do not distinguish from the best one, and that need not
        be beyond their range."""
        order = sorted(scores, key=lambda score: score.name != best.effect.name)
        past = {score.name: score for score in scores if score.statistic > self.threshold}
        near = [name for name in self.search.alike(order)[1:] if name in past]
        return tuple(
            name
            for name in near
            if self._beyond(measured, [self._refined(measured, past[name])]) is None
        )

    def _estimates(
        self, alone: Sequence[tuple[Fitted, Sequence[FloatArray]]], weights: FloatArray
    ) -> dict[str, tuple[Estimate, ...]]:
        """Return the parameters of named effects, each with the residuals that the others leave,
        with intervals by a bootstrap over trajectories, (draws, shots) weights."""
        found = {}
        for one, rest in alone:
            search = self._searching({one.effect.name: (one.signature,)})
            products = search.products(rest)
            values = [
                search.score_products(np.tensordot(weight, products, axes=1))[0].values
                for weight in weights
            ]
            variance = self.null.variances(one.effect.name, one.signature)
            spread = {
                d.name: 1.96 * abs(d.step) * float(np.sqrt(v))
                for d, v in zip(one.signature.directions, variance, strict=True)
            }
            found[one.effect.name] = tuple(
                _estimate(p, one.score.values[p.name], [v[p.name] for v in values], spread)
                for p in one.effect.parameters
            )
        return found

    def _stability(
        self,
        alone: Sequence[tuple[Fitted, Sequence[FloatArray]]],
        alternatives: Sequence[str],
        weights: FloatArray,
    ) -> float:
        """Return the share of bootstrap repetitions, (draws, shots) weights, that give the same
        answer: the effect that is named, or one of the set, comes first and is past the threshold;
        of two named, each next to the other."""
        named = {one.effect.name for one, _ in alone}

        def contest(one: Fitted, rest: Sequence[FloatArray]) -> decision.Contest:
            taken = named - {one.effect.name}
            products = self.search.products(rest)

            def winner(weight: FloatArray) -> str | None:
                scores = self.search.score_products(np.tensordot(weight, products, axes=1))
                first = next(score for score in scores if score.name not in taken)
                return first.name if first.statistic > self.threshold else None

            return winner, {one.effect.name, *alternatives}

        return decision.stability([contest(*one) for one in alone], weights)


def mean_squares(
    shots: Sequence[Shot], residuals: Sequence[FloatArray], noise: TileNoise, case: OpticalCase
) -> FloatArray:
    """Return the mean square of each shot's residual, in expected variances, the camera's gain and
    black level being fitted to all of them."""
    nuisances = camera_nuisances([shot.film for shot in shots], case.meter)
    whitened = freed(residuals, noise, nuisances, [shot.change for shot in shots])
    ends = np.cumsum([one.size for one in residuals])[:-1]
    return np.array([np.mean(part**2) for part in np.split(whitened, ends)])


def without_effects(
    case: OpticalCase,
    shots: Sequence[Shot],
    residuals: Sequence[FloatArray],
    named: Sequence[Fitted],
) -> list[FloatArray]:
    """Return what named effects leave of the residuals of shots."""
    active = [one.active for one in named]
    return [
        residual - case.changed_by(shot, active)
        for residual, shot in zip(residuals, shots, strict=True)
    ]


def _probed_at(effect: Effect, values: Mapping[str, float]) -> Effect:
    """Return an effect that is probed once, at some values."""
    (directions, _), *_ = probes_of(effect)
    steps = {d.name: d.step for d in directions}
    parameters = []
    for parameter in effect.parameters:
        value = values[parameter.name]
        if parameter.none is not None:
            least = SMALLEST_STEP * abs(steps[parameter.name])
            if abs(value - parameter.none) < least:
                side = np.sign(value - parameter.none) or np.sign(steps[parameter.name])
                value = parameter.none + float(side) * least
        parameters.append(replace(parameter, probes=(value,)))
    return replace(effect, parameters=tuple(parameters))


def _opened(direction: Direction, parameter: EffectParameter, value: float) -> Direction:
    """Return the direction of a parameter with a range that goes on beyond the end that a value
    stands at; as it is within."""
    end = parameter.end_at(value)
    if end is None:
        return direction
    beyond = parameter.beyond(end)
    return replace(direction, low=min(direction.low, beyond), high=max(direction.high, beyond))


def _beside(parameter: EffectParameter, value: float, reach: float) -> list[float]:
    """Return values of a shape on both sides of one."""
    probes = sorted(parameter.probes)
    low, high = parameter.low, parameter.high
    if low > 0.0 and high / low > 5.0:
        gaps = np.diff(np.log(probes))
        factor = float(np.exp(0.5 * reach * (gaps.mean() if len(gaps) else np.log(3.0))))
        found = [value / factor, value * factor]
    else:
        gaps = np.diff(probes)
        step = 0.5 * reach * (float(gaps.mean()) if len(gaps) else 0.3 * (high - low))
        found = [value - step, value + step]
    return [one for one in found if low <= one <= high]


def _estimate(
    parameter: EffectParameter, value: float, drawn: Sequence[float], spread: Mapping[str, float]
) -> Estimate:
    """Return a parameter with its interval: that of the bootstrap and of the model's own error."""
    low, high = np.percentile(drawn, [2.5, 97.5]).tolist()
    own = spread.get(parameter.name, 0.0)
    below, above = np.hypot(max(value - low, 0.0), own), np.hypot(max(high - value, 0.0), own)
    return Estimate(
        parameter.name,
        parameter.unit,
        value,
        max(value - float(below), min(parameter.low, value)),
        min(value + float(above), max(parameter.high, value)),
    )
