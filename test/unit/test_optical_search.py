# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The search for optical effects on synthetic films: nulls, power, what cannot be told apart."""

from dataclasses import replace

import numpy as np
import pytest
from optical_films import (
    CENTRE,
    CHANGES,
    CHOSEN,
    FILMS,
    HEIGHT,
    LIT,
    METER,
    NULLS,
    REFERENCES,
    WIDTH,
    changes_of,
    drawn,
    film_of,
    null_residual,
    truth,
    vignetted,
)

from dotsim_ros.effects.library import load_effects
from dotsim_ros.gap.images.search import (
    OpticalSearch,
    alike,
    camera_nuisances,
    signatures_of,
)
from dotsim_ros.gap.images.tile_noise import estimate_noise


@pytest.fixture(scope="module")
def signatures():
    library = load_effects()
    return signatures_of([library[name] for name in CHOSEN], FILMS, METER)


@pytest.fixture(scope="module")
def references():
    """Films, changes and residuals of trajectories in which nothing is wrong."""
    films = [film_of(number) for number in REFERENCES]
    changes = changes_of(films)
    random = np.random.default_rng(7)
    return films, changes, [drawn(change, random) for change in changes]


@pytest.fixture(scope="module")
def noise(references):
    """The covariance as estimated from other trajectories, not as it is."""
    _, changes, residuals = references
    return estimate_noise(residuals, changes, truth().camera, METER.grid.centre_px)


@pytest.fixture(scope="module")
def nuisances():
    return camera_nuisances(FILMS, METER)


@pytest.fixture(scope="module")
def spurious(references, noise):
    films, changes, residuals = references
    library = load_effects()
    signatures = signatures_of([library[name] for name in CHOSEN], films, METER)
    search = OpticalSearch(signatures, noise, camera_nuisances(films, METER), changes)
    return search.spurious_variances(residuals)


@pytest.fixture(scope="module")
def search(signatures, noise, nuisances, spurious):
    return OpticalSearch(signatures, noise, nuisances, CHANGES, spurious)


def with_law(law, seed):
    """Return a residual of images that a law (H, W, 3) -> (H, W, 3) changed."""
    noise = null_residual(seed)
    changed = [np.stack([law(p.astype(np.float64)) for p in film.pixels]) for film in FILMS]
    return [
        METER.difference(image, film.pixels) + one
        for image, film, one in zip(changed, FILMS, noise, strict=True)
    ]


def test_the_estimated_noise_is_that_which_was_drawn(noise):
    true = truth()
    ratio = noise.deviation(CHANGES[0]) / true.deviation(CHANGES[0])
    assert 0.85 < np.median(ratio[..., :3]) < 1.15
    assert 0.85 < np.median(ratio[..., 3:]) < 1.15
    white = [one.white for one in noise.correlations]
    assert np.median(white) == pytest.approx(0.6, abs=0.2)


def largest(scores):
    return max(score.statistic for score in scores)


def test_nulls_get_few_names(search):
    threshold = search.threshold(0.02)
    false = [
        seed for seed in range(NULLS) if largest(search.score(null_residual(seed))) > threshold
    ]
    # 2 % of 40 are wanted.
    assert len(false) <= 2


def test_an_error_that_the_model_repeats_is_no_effect(references, signatures, noise, nuisances):
    # The model draws the edges too bright, by another share in every trajectory.
    films, changes, residuals = references
    random = np.random.default_rng(5)

    def erring(films, residuals):
        slips = [vignetting_error(film, random.normal(0.0, 0.03)) for film in films]
        return [slip + one for slip, one in zip(slips, residuals, strict=True)]

    wrong = erring(films, residuals)
    told = estimate_noise(wrong, changes, truth().camera, METER.grid.centre_px)
    library = load_effects()
    theirs = signatures_of([library[name] for name in CHOSEN], films, METER)
    reference = OpticalSearch(theirs, told, camera_nuisances(films, METER), changes)
    spurious = reference.spurious_variances(wrong)
    aware = OpticalSearch(signatures, told, nuisances, CHANGES, spurious)
    unaware = OpticalSearch(signatures, told, nuisances, CHANGES)
    draws = [erring(FILMS, null_residual(seed)) for seed in range(10)]
    threshold = aware.threshold(0.02)
    false = [one for one in draws if largest(aware.score(one)) > threshold]
    fooled = [one for one in draws if largest(unaware.score(one)) > threshold]
    assert len(false) <= 1
    assert len(fooled) > len(false)
    # Three times as much is still seen.
    scores = aware.score(with_law(lambda p: p * falling(0.2)[..., None], 0))
    assert scores[0].name == "vignetting"
    assert scores[0].statistic > threshold


def falling(loss):
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    square = ((x - CENTRE[0]) ** 2 + (y - CENTRE[1]) ** 2) / (0.5 * HEIGHT) ** 2
    return 1.0 - loss * square


def vignetting_error(film, loss):
    return METER.difference(film.pixels * falling(loss)[None, ..., None], film.pixels)


def test_null_draws_are_those_of_whole_residuals(signatures, nuisances):
    # So many trajectories that Student's distribution is normal.
    known = replace(truth(), trajectory_count=10**6)
    search = OpticalSearch(signatures, known, nuisances, CHANGES)
    whole = [largest(search.score(null_residual(1000 + seed))) for seed in range(200)]
    cheap = search.null_statistics(2000, seed=1)
    assert np.mean(whole) == pytest.approx(np.mean(cheap), rel=0.25)
    assert np.quantile(whole, 0.9) == pytest.approx(np.quantile(cheap, 0.9), rel=0.25)


def test_a_vignetting_of_ten_percent_is_found_and_not_called_gamma(search):
    threshold = search.threshold(0.02)
    for seed in range(5):
        scores = search.score(with_law(vignetted, seed))
        assert scores[0].name == "vignetting"
        assert scores[0].statistic > threshold
        assert scores[0].explained > 0.8
        assert scores[0].values["edge_loss"] == pytest.approx(0.1, rel=0.25)
        assert "gamma" not in alike(scores, search.likeness())


def test_ambient_light_and_gamma_are_flagged_as_a_pair(search):
    pairs = {frozenset((one.first, one.second)): one.cosine for one in search.likeness()}
    together = pairs[frozenset(("ambient_light", "gamma"))]
    assert together > 0.85
    assert together == max(pairs.values())
    assert pairs[frozenset(("gamma", "vignetting"))] < 0.8
    scores = search.score(with_law(lambda p: p + 4.0 * LIT[..., None], 5))
    assert set(alike(scores, search.likeness())[:2]) == {"ambient_light", "gamma"}


def test_the_gain_of_the_camera_is_no_effect(search):
    plain = search.whitened(null_residual(2))
    dimmed = search.whitened(with_law(lambda p: 0.9 * p, 2))
    # What saturates nowhere is a gain to the last bit, but in the shift of the pattern.
    np.testing.assert_allclose(dimmed, plain, atol=1e-6)


def test_a_small_offset_is_the_camera_s_and_a_large_one_is_not(signatures, noise, nuisances):
    gain, level = nuisances
    free = replace(level, deviation=np.inf)
    known = OpticalSearch(signatures, noise, nuisances, CHANGES)
    blind = OpticalSearch(signatures, noise, (gain, free), CHANGES)
    residual = with_law(lambda p: p + 4.0 * LIT[..., None], 5)
    found = {score.name: score for score in known.score(residual)}
    lost = {score.name: score for score in blind.score(residual)}
    assert found["ambient_light"].fit > 20.0
    assert not lost["ambient_light"].is_excited


def test_what_the_data_do_not_show_is_not_excited(noise, nuisances):
    library = load_effects()
    # Nothing moves in these films.
    signatures = signatures_of([library["motion_blur"], library["gamma"]], FILMS, METER)
    scores = OpticalSearch(signatures, noise, nuisances, CHANGES).score(null_residual(0))
    found = {score.name: score for score in scores}
    assert not found["motion_blur"].is_excited
    assert found["gamma"].is_excited
