# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fits of effects and nuisances to whitened evidence, on drawn data of known truth."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from dotsim_ros.effects.effect import FORCE, Effect, EffectParameter
from dotsim_ros.gap.decision import (
    HEAVIER,
    MARGIN,
    PATTERNS_HEAVIER,
    bootstrap_weights,
    limit_factor,
    pattern_factor,
    threshold_of,
)
from dotsim_ros.gap.presses.assumptions import SHARED, PressNuisance, centred
from dotsim_ros.gap.presses.certainty import CHI_SQUARE, profile_ends
from dotsim_ros.gap.presses.covariance import Whitening
from dotsim_ros.gap.presses.evidence import Case, EvidenceTrajectory, Segment, Variant
from dotsim_ros.gap.presses.inference import (
    Evidence,
    cosines,
    draw_null,
    fit,
    fit_nuisances,
    lengths,
    log_evidence,
)
from dotsim_ros.gap.presses.screening import Screen, best_trial

TRAJECTORIES, EACH = 6, 80


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(5)


def evidence_of(random: np.random.Generator) -> Evidence:
    n = TRAJECTORIES * EACH
    return Evidence(
        np.zeros(n), random.standard_normal((n, 2)), np.repeat(np.arange(TRAJECTORIES), EACH)
    )


def nothing(evidence: Evidence) -> np.ndarray:
    return np.zeros((len(evidence.residual), 0))


def test_a_size_and_a_nuisance_are_found_within_their_errors(random: np.random.Generator) -> None:
    evidence = evidence_of(random)
    column = random.standard_normal(len(evidence.residual))
    noise = random.standard_normal(len(evidence.residual))
    seen = evidence.with_residual(3.0 * column + evidence.nuisance @ [1.0, -0.5] + noise)
    found = fit(seen, column[:, None])
    assert found.size[0] == pytest.approx(3.0, abs=4.0 / np.sqrt(len(noise)))
    assert found.nuisance == pytest.approx([1.0, -0.5], abs=4.0 / np.sqrt(len(noise)))
    assert fit(seen, nothing(seen)).objective > found.objective + 100.0


def test_an_effect_in_small_units_leaves_the_nuisances_free(random: np.random.Generator) -> None:
    evidence = evidence_of(random)
    column = random.standard_normal((len(evidence.residual), 1))
    data = evidence.with_residual(evidence.nuisance @ np.array([2.0, -1.0]) + 0.1 * column[:, 0])
    # As metres a newton are: 1e-5 of them is a large size.
    found, small = fit(data, column), fit(data, 1e7 * column)
    assert small.nuisance == pytest.approx(found.nuisance, rel=1e-6)
    assert small.objective == pytest.approx(found.objective, rel=1e-6)


def test_one_bad_trajectory_does_not_name_an_effect(random: np.random.Generator) -> None:
    evidence = evidence_of(random)
    column = random.standard_normal(len(evidence.residual))
    bad = evidence.trajectory == 2
    noise = random.standard_normal(len(evidence.residual))
    seen = evidence.with_residual(noise + 5.0 * column * bad)
    found = fit(seen, column[:, None])
    assert found.size[0] < 0.5
    assert found.weight[2] < 0.2
    assert found.weight[[0, 1, 3, 4, 5]].min() > 0.7


def test_cosines_leave_out_what_a_nuisance_can_do(random: np.random.Generator) -> None:
    evidence = evidence_of(random)
    free = Evidence(evidence.residual, 1e4 * evidence.nuisance, evidence.trajectory)
    a, b = random.standard_normal((2, len(evidence.residual)))
    columns = np.stack([a, a + 1e-3 * free.nuisance[:, 0], b], axis=1)
    rho = cosines(free, columns)
    assert rho[0, 1] == pytest.approx(1.0, abs=1e-5)
    assert abs(rho[0, 2]) < 0.2
    assert lengths(free, columns)[1] == pytest.approx(lengths(free, columns)[0], rel=1e-5)


def test_nulls_have_unit_noise_and_the_priors_nuisances(random: np.random.Generator) -> None:
    evidence = evidence_of(random)
    drawn = np.stack([draw_null(evidence, random) for _ in range(400)])
    expected = 1.0 + np.sum(evidence.nuisance**2, axis=1)
    assert np.mean(drawn.var(axis=0) / expected) == pytest.approx(1.0, abs=0.05)


def test_the_threshold_is_the_nulls_quantile_and_grows_beyond_their_number() -> None:
    gains = np.random.default_rng(0).chisquare(1, 4000).tolist()
    assert threshold_of(gains, 0.02) == pytest.approx(5.41, rel=0.1)
    few = gains[:20]
    assert threshold_of(few, 0.001) > threshold_of(few, 0.02)


@pytest.mark.parametrize(("is_representative", "least"), [(False, HEAVIER), (True, MARGIN)])
def test_a_limit_is_what_true_nulls_show_and_a_margin_at_least(
    is_representative: bool, least: float
) -> None:
    factor = partial(limit_factor, is_representative=is_representative)
    measured = {"latency": 9.7, "adhesion": 0.1}
    assert factor("latency", measured) == 9.7
    assert factor("adhesion", measured) == least
    assert factor("one's own", measured) == 9.7
    assert factor("one's own", {"adhesion": 0.1}) == HEAVIER
    assert factor("one's own", {}) == HEAVIER
    patterns = partial(pattern_factor, is_representative=is_representative)
    assert patterns(5.0) == 5.0
    assert patterns(0.0) == PATTERNS_HEAVIER
    assert patterns(0.1) == (MARGIN if is_representative else PATTERNS_HEAVIER)


def segment_of(random: np.random.Generator, count: int) -> Segment:
    effect = Effect(
        "any", "Any", (EffectParameter("size", "1", 0.0, 0.0, 1.0, (0.5,)),), (FORCE,), "", bool
    )
    return Segment(
        Variant(effect, {}),
        0.5,
        0.3 * random.standard_normal(count),
        random.standard_normal(count),
        -0.05,
        0.06,
    )


def test_segments_screened_together_gain_what_each_gains_alone(
    random: np.random.Generator,
) -> None:
    evidence = evidence_of(random)
    seen = evidence.with_residual(1.3 * random.standard_normal(len(evidence.residual)))
    segments = [segment_of(random, len(seen.residual)) for _ in range(4)]
    base, gains, sizes = Screen(evidence, segments).tries(seen.residual)
    assert base == pytest.approx(fit_nuisances(seen).objective)
    alone = [best_trial(seen, [s], base) for s in segments]
    assert gains == pytest.approx([trial.gain for trial in alone])
    assert sizes == pytest.approx([trial.size for trial in alone])
    assert Screen(evidence).tries(seen.residual)[0] == base


def test_a_trajectory_that_counts_twice_is_one_that_is_there_twice(
    random: np.random.Generator,
) -> None:
    evidence = evidence_of(random)
    column = random.standard_normal(len(evidence.residual))
    seen = evidence.with_residual(0.3 * column + random.standard_normal(len(column)))
    places = [0, 1, 1, 3, 4, 5]
    counts = np.bincount(places, minlength=TRAJECTORIES).astype(float)
    repeated = fit(seen.of(places), column[seen.rows_of(places), None])
    segment = Segment(segment_of(random, 1).variant, 0.0, 0.0 * column, column, -5.0, 5.0)
    base, gains, sizes = Screen(seen, [segment]).tries(seen.residual, counts)
    assert sizes[0] == pytest.approx(repeated.size[0])
    assert base - gains[0] == pytest.approx(repeated.objective)
    assert base == pytest.approx(fit_nuisances(seen.of(places)).objective)


def test_a_bootstrap_leaves_no_trajectory_out(random: np.random.Generator) -> None:
    weights = bootstrap_weights(5, 4000, random)
    assert weights.min() > 0.0
    assert weights.sum(axis=1) == pytest.approx(np.full(4000, 5.0))
    # A share of five that is uniform on all of them: (n - 1) / (n + 1) of variance 1.
    assert weights.mean(axis=0) == pytest.approx(np.ones(5), abs=0.06)
    assert weights.var(axis=0) == pytest.approx(np.full(5, 4.0 / 6.0), rel=0.15)


def test_the_evidence_of_many_data_is_that_of_the_integral(random: np.random.Generator) -> None:
    # One trajectory whose noise is as expected, so that its scale hardly matters.
    n = 400
    column, noise = random.standard_normal(n), random.standard_normal(n)
    noise *= np.sqrt(n) / np.linalg.norm(noise)
    seen = Evidence(0.2 * column + noise, np.zeros((n, 1)), np.zeros(n, dtype=np.int64))
    found = fit(seen, column[:, None])
    gained = log_evidence(seen, found, column[:, None], np.array([1.0]))
    gained -= log_evidence(seen, fit_nuisances(seen), np.zeros((n, 0)), np.zeros(0))
    # Of normal noise of one deviation and a normal prior of one deviation, in closed form.
    square, right = column @ column, column @ seen.residual
    exact = 0.5 * right**2 / (square + 1.0) - 0.5 * np.log(square + 1.0)
    assert gained == pytest.approx(exact, abs=0.5)


def test_a_profile_of_a_linear_effect_ends_at_its_standard_errors(
    random: np.random.Generator,
) -> None:
    evidence = evidence_of(random)
    column = random.standard_normal(len(evidence.residual))
    noise = random.standard_normal(len(evidence.residual))
    seen = evidence.with_residual(2.0 * column + noise)
    variant = segment_of(random, 1).variant
    segment = Segment(variant, 0.0, np.zeros_like(column), column, 0.0, 5.0)
    size = best_trial(seen, [segment], fit_nuisances(seen).objective).size
    low, high = profile_ends(seen, [segment], size, (0.0, 5.0), CHI_SQUARE)
    error = 1.0 / lengths(evidence, column[:, None])[0]
    assert high - size == pytest.approx(1.96 * error, rel=0.1)
    assert size - low == pytest.approx(1.96 * error, rel=0.1)
    # What the data hardly tell may be anywhere within its range.
    blind = Segment(segment.variant, 0.0, segment.offset, 1e-3 * column, 0.0, 5.0)
    assert profile_ends(seen, [blind], 5.0, (0.0, 5.0), 1e4) == pytest.approx((0.0, 5.0))


def test_what_the_twin_is_known_to_be_off_by_is_no_residual(random: np.random.Generator) -> None:
    nuisances = centred(
        [PressNuisance("E", "log", 0.1, SHARED), PressNuisance("delay", "s", 0.005, SHARED)],
        {"delay": 0.007},
    )
    shape = (4, 5)
    predicted = random.standard_normal(shape)
    columns = random.standard_normal((2, *shape))
    # A column is of one deviation.
    observed = predicted + 0.007 / 0.005 * columns[1]
    used = np.ones(shape, dtype=bool)
    trajectory = EvidenceTrajectory(
        recording=None,
        is_reference=False,
        places=None,
        observed=observed,
        predicted=predicted,
        whitening=Whitening(used, np.eye(used.sum())),
        nuisance=columns,
        pattern=np.zeros((1, *shape)),
    )
    case = Case([trajectory], nuisances, {}, None, None, None)
    evidence = case.evidence([0])
    assert np.allclose(evidence.residual, 0.0)
    assert np.allclose(predicted + case.moved(0, np.zeros(2)), observed)
    assert np.allclose(case.moved(0, np.array([1.0, 0.0])) - case.moved(0, np.zeros(2)), columns[0])
