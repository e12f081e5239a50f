# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The images' part of a search: its rule, its noise file, whose camera it is, what is said."""

from __future__ import annotations

from dataclasses import replace

import cv2
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
    beside_a_lamp,
    changes_of,
    drawn,
    film_of,
    null_residual,
    out_of_focus,
    seen_from,
    truth,
    vignetted,
)

from dotsim_ros.effects.effect import Active
from dotsim_ros.effects.library import load_effects
from dotsim_ros.gap.findings import Verdict
from dotsim_ros.gap.images.case import OpticalCase, Shot
from dotsim_ros.gap.images.fit import ImageSearch
from dotsim_ros.gap.images.null import fit_optical_null, load_optical_null, save_optical_null
from dotsim_ros.gap.images.reading import check_same_unit, pattern_likeness
from dotsim_ros.gap.images.search import OpticalSearch, camera_nuisances, signatures_of
from dotsim_ros.gap.images.tile_noise import estimate_noise
from dotsim_ros.gap.report.wording import asked

LIBRARY = load_effects()
EFFECTS = [LIBRARY[name] for name in CHOSEN]


def case_of(films, residuals):
    """Return films with residuals as a case, as if they had been measured."""
    shots = [
        Shot(f"press_{k}", None, film.pixels, film, residual, change)
        for k, (film, residual, change) in enumerate(
            zip(films, residuals, changes_of(films), strict=True)
        )
    ]
    return OpticalCase(tuple(shots), METER, truth().camera)


@pytest.fixture(scope="module")
def references():
    """Films, changes and residuals of trajectories in which nothing is wrong."""
    films = [film_of(number) for number in REFERENCES]
    changes = changes_of(films)
    random = np.random.default_rng(7)
    return films, changes, [drawn(change, random) for change in changes]


@pytest.fixture(scope="module")
def null(references):
    films, _, residuals = references
    return fit_optical_null(
        case_of(films, residuals), EFFECTS, sensor="synthetic", source="eight synthetic films"
    )


@pytest.fixture(scope="module")
def signatures():
    return signatures_of(EFFECTS, FILMS, METER)


@pytest.fixture(scope="module")
def searched(null, signatures):
    case = case_of(FILMS, null_residual(0))
    return ImageSearch(case, case.shots, EFFECTS, null, alpha=0.02, seed=0, signatures=signatures)


def residuals_with(law, seed):
    return [
        METER.difference(np.stack([law(p.astype(np.float64)) for p in film.pixels]), film.pixels)
        + one
        for film, one in zip(FILMS, null_residual(seed), strict=True)
    ]


def test_another_law_of_vignetting_is_named_with_its_interval(searched):
    answer = searched.answer(residuals_with(vignetted, 1))
    assert answer.verdict is Verdict.NAMED
    assert [one.effect.name for one in answer.named] == ["vignetting"]
    (estimate,) = answer.estimates["vignetting"]
    assert estimate.name == "edge_loss"
    assert estimate.low < estimate.value < estimate.high
    assert estimate.value == pytest.approx(0.1, rel=0.25)
    assert answer.stability == 1.0


def test_two_effects_at_once_are_both_named(searched):
    answer = searched.answer(
        residuals_with(lambda p: vignetted(p) * np.array([0.9, 0.995, 1.0]), 2)
    )
    assert answer.verdict is Verdict.NAMED
    assert {one.effect.name for one in answer.named} == {"vignetting", "led_imbalance_red"}
    (loss,) = answer.estimates["led_imbalance_red"]
    assert loss.value == pytest.approx(0.1, abs=0.03)
    assert answer.stability == 1.0


def test_a_second_effect_that_one_trajectory_alone_shows_is_not_stable(searched):
    throughout = residuals_with(vignetted, 2)
    both = residuals_with(lambda p: vignetted(p) * np.array([0.95, 0.9975, 1.0]), 2)
    answer = searched.answer([both[0], *throughout[1:]])
    assert [one.effect.name for one in answer.named] == ["vignetting", "led_imbalance_red"]
    # How much that one trajectory counts in a draw decides.
    assert 0.2 < answer.stability < 0.67


def darker_edges(loss):
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    square = ((x - CENTRE[0]) ** 2 + (y - CENTRE[1]) ** 2) / (0.5 * HEIGHT) ** 2
    return lambda pixels: pixels * (1.0 - loss * square)[..., None]


def test_a_size_that_is_beyond_the_plausible_is_unknown_and_one_at_the_end_is_not(searched):
    answer = searched.answer(residuals_with(darker_edges(0.4), 4))
    assert answer.verdict is Verdict.UNKNOWN
    assert answer.named == ()
    assert answer.beyond is not None
    assert (answer.beyond.effect.name, answer.beyond.parameter.name) == ("vignetting", "edge_loss")
    assert answer.beyond.value == pytest.approx(0.4, rel=0.1)
    told = asked("images", answer.beyond.parameter, answer.beyond.value)
    assert told.startswith("the images ask for edge_loss = 0.4")
    assert told.endswith("its plausible range is 0 to 0.3")
    # As large as is plausible is no sign of anything else.
    answer = searched.answer(residuals_with(darker_edges(0.3), 4))
    assert answer.verdict is Verdict.NAMED
    assert answer.beyond is None
    (loss,) = answer.estimates["vignetting"]
    assert loss.value == pytest.approx(0.3, rel=0.02)


def test_what_would_have_to_be_beyond_its_range_is_no_alternative(references):
    vignetting = LIBRARY["vignetting"]
    (loss,) = vignetting.parameters

    def faint(high):
        size = replace(loss, high=high, probes=(0.05,))
        return replace(vignetting, name="faint", parameters=(size,))

    films, _, residuals = references
    case = case_of(films, residuals)
    null = fit_optical_null(case, [vignetting, faint(0.3)], sensor="synthetic", source="films")
    residuals = residuals_with(darker_edges(0.1), 1)
    case = case_of(FILMS, residuals)
    alternatives = {}
    for high in (0.05, 0.3):
        effects = [vignetting, faint(high)]
        search = ImageSearch(case, case.shots, effects, null, alpha=0.02, seed=0)
        answer = search.answer(residuals)
        alternatives[high] = {*answer.alternatives, *(one.effect.name for one in answer.named)}
    assert alternatives == {0.05: {"vignetting"}, 0.3: {"vignetting", "faint"}}


@pytest.fixture(scope="module")
def lens_and_light(references):
    """The search for what depth and normals of the skin enter, next to what is taken for it."""
    effects = [
        LIBRARY[name]
        for name in (
            *("ambient_light", "camera_displacement", "camera_extrinsics", "daylight", "defocus"),
            *("gamma", "vignetting"),
        )
    ]
    films, _, residuals = references
    null = fit_optical_null(
        case_of(films, residuals), effects, sensor="synthetic", source="eight synthetic films"
    )
    case = case_of(FILMS, null_residual(0))
    return ImageSearch(case, case.shots, effects, null, alpha=0.02, seed=0)


def film_residuals(law, seed):
    """Return the residuals of films that a law (film) -> (F, H, W, 3) changed."""
    return [
        METER.difference(law(film), film.pixels) + one
        for film, one in zip(FILMS, null_residual(seed), strict=True)
    ]


DIRECTION = np.array([np.cos(1.2), np.sin(1.2), 0.0])
MOVED_M = np.array([3e-4, 0.0, -2e-4])
LAWS = {
    # A blur that depends on depth, a lamp at one side, and the parallax that a turn has not.
    "defocus": (
        out_of_focus,
        {"pupil_area_m2": (0.25 * np.pi * 0.9e-3**2, 3e-7), "focus_m": (9e-3, 1.8e-3)},
    ),
    "daylight": (
        lambda film: beside_a_lamp(film, DIRECTION, 10.0),
        {"added_share": (10.0 / 255.0, 0.016), "azimuth_rad": (1.2, 0.2)},
    ),
    "camera_displacement": (
        lambda film: seen_from(film, MOVED_M),
        dict(zip(("x_m", "y_m", "z_m"), ((x, 0.5e-4) for x in MOVED_M), strict=True)),
    ),
}


@pytest.mark.parametrize("name", LAWS)
def test_what_depth_and_normals_enter_is_named_with_its_size(lens_and_light, name):
    law, expected = LAWS[name]
    answer = lens_and_light.answer(film_residuals(law, 1 + list(LAWS).index(name)))
    assert answer.verdict is Verdict.NAMED
    assert [one.effect.name for one in answer.named] == [name]
    found = {one.name: one.value for one in answer.estimates[name]}
    for parameter, (value, tolerance) in expected.items():
        assert found[parameter] == pytest.approx(value, abs=tolerance)


def test_lens_and_light_are_not_named_where_they_are_not(lens_and_light):
    for seed in range(2):
        assert lens_and_light.answer(null_residual(seed)).verdict is Verdict.NO_GAP
    veiled = lens_and_light.answer(film_residuals(lambda film: film.pixels + 5.0, 4))
    assert "daylight" not in [one.effect.name for one in veiled.named]
    tilt = LIBRARY["camera_extrinsics"]
    turned = [Active(tilt, tilt.checked({"tilt_x_rad": 0.02, "tilt_y_rad": 0.0, "roll_rad": 0.02}))]
    answer = lens_and_light.answer(film_residuals(lambda film: film.with_effects(turned), 5))
    assert [one.effect.name for one in answer.named] == ["camera_extrinsics"]
    assert answer.alternatives == ()


def test_the_noise_of_images_comes_back_from_its_file(null, signatures, tmp_path):
    path = tmp_path / "noise.npz"
    save_optical_null(null, path)
    again = load_optical_null(path)
    assert (again.sensor, again.source) == ("synthetic", "eight synthetic films")
    assert again.spurious == null.spurious
    np.testing.assert_array_equal(again.excess, null.excess)
    for name, several in signatures.items():
        for one in several:
            np.testing.assert_array_equal(again.variances(name, one), null.variances(name, one))
    # Tiles of another camera take the deviations of the nearest ones; its own noise where known.
    told = again.at(METER, np.full_like(null.noise.camera, np.nan))
    np.testing.assert_array_equal(told.model, null.noise.model)
    np.testing.assert_array_equal(told.camera, null.noise.camera)
    np.testing.assert_array_equal(
        again.at(METER, 2.0 * null.noise.camera).camera, 2.0 * null.noise.camera
    )


def test_broken_noise_files_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="find-gap --fit-optical-noise makes one"):
        load_optical_null(tmp_path / "none.npz")
    np.savez(tmp_path / "other.npz", version=np.array(99))
    with pytest.raises(ValueError, match="no noise of images of version 1"):
        load_optical_null(tmp_path / "other.npz")


def test_an_effect_whose_scatter_is_not_known_is_not_searched_for(null):
    assert null.knows(LIBRARY["gamma"])
    assert not null.knows(LIBRARY["motion_blur"])
    # A file of the user's that takes a shipped effect's name, with another parameter.
    gamma = LIBRARY["gamma"]
    (exponent,) = gamma.parameters
    assert not null.knows(replace(gamma, parameters=(replace(exponent, name="power"),)))


def test_a_reference_tells_the_scatter_of_effects_that_the_file_does_not_know(null, references):
    films, _, residuals = references
    case = case_of(films, residuals)
    vignetting = LIBRARY["vignetting"]
    poorer = replace(null, spurious=tuple(s for s in null.spurious if s.effect != "vignetting"))
    assert not poorer.knows(vignetting)
    # The same data tell the same, as if the file had been made with the effect.
    again = poorer.with_effects([vignetting], case)
    assert sorted(again.spurious, key=repr) == sorted(null.spurious, key=repr)
    assert again.noise.trajectory_count == len(REFERENCES)
    # Fewer trajectories raise the thresholds.
    few = poorer.with_effects([vignetting], replace(case, shots=case.shots[:3]))
    assert few.noise.trajectory_count == 3
    searches = [
        ImageSearch(case, case.shots, EFFECTS, one, alpha=0.02, seed=0) for one in (again, few)
    ]
    assert searches[1].threshold > searches[0].threshold


def test_the_shipped_noise_knows_every_effect_of_the_camera():
    null = load_optical_null()
    assert null.sensor == "sensor_a"
    assert all(null.knows(effect) for effect in LIBRARY.values() if effect.image is not None)
    # Trajectories of one sensor scatter, but not by orders of magnitude.
    assert 0.7 < null.usual_excess < 1.3
    assert null.usual_excess < null.largest_excess(0.02) < 3.0


def pattern(seed):
    random = np.random.default_rng(seed)
    spots = cv2.GaussianBlur(random.standard_normal((240, 320)), (0, 0), 3.0)
    level = np.where(spots > 0.0, 150.0, 70.0)
    y, x = np.mgrid[0:240, 0:320]
    level[np.hypot(x - 160, y - 120) > 115] = 0.0
    return np.repeat(level[..., None], 3, axis=2).astype(np.uint8)


def test_the_pattern_tells_units_apart_whatever_happened_to_the_camera():
    own = pattern(1)
    assert pattern_likeness(own, own) > 0.99
    turned = cv2.warpAffine(own, cv2.getRotationMatrix2D((160, 120), 3.0, 1.0), (320, 240))
    dimmed = (0.6 * np.roll(own, 4, axis=1)).astype(np.uint8)
    for changed in (turned, dimmed):
        check_same_unit(own, changed, owner="the twin's")
    for other in (pattern(2), own[:, ::-1].copy()):
        assert pattern_likeness(own, other) < 0.45
        with pytest.raises(ValueError, match="another pattern than the twin's"):
            check_same_unit(own, other, owner="the twin's")
    with pytest.raises(ValueError, match="the idle images are 160x120, the twin's is 320x240"):
        check_same_unit(own, own[::2, ::2], owner="the twin's")


def brighter_edges(film, loss):
    """Return what an error of the model in the brightness of the edges does to a film."""
    return METER.difference(darker_edges(loss)(film.pixels), film.pixels)


def test_the_estimated_noise_is_that_which_was_drawn(null):
    true, noise = truth(), null.noise
    ratio = noise.deviation(CHANGES[0]) / true.deviation(CHANGES[0])
    assert 0.85 < np.median(ratio[..., :3]) < 1.15
    assert 0.85 < np.median(ratio[..., 3:]) < 1.15
    white = [one.white for one in noise.correlations]
    assert np.median(white) == pytest.approx(0.6, abs=0.2)


def largest(scores):
    return max(score.statistic for score in scores)


def test_nulls_get_few_names(searched):
    search = searched.search
    threshold = search.threshold(0.02)
    false = [
        seed for seed in range(NULLS) if largest(search.score(null_residual(seed))) > threshold
    ]
    # 2 % of 40 are wanted.
    assert len(false) <= 2


def test_an_error_that_the_model_repeats_is_no_effect(references, signatures, searched):
    # The model draws the edges too bright, by another share in every trajectory.
    films, changes, residuals = references
    random = np.random.default_rng(5)

    def erring(films, residuals):
        slips = [brighter_edges(film, random.normal(0.0, 0.03)) for film in films]
        return [slip + one for slip, one in zip(slips, residuals, strict=True)]

    wrong = erring(films, residuals)
    told = estimate_noise(wrong, changes, truth().camera, METER.grid.centre_px)
    theirs = signatures_of(EFFECTS, films, METER)
    reference = OpticalSearch(theirs, told, camera_nuisances(films, METER), changes)
    spurious = reference.spurious_variances(wrong)
    aware = OpticalSearch(signatures, told, searched.nuisances, CHANGES, spurious)
    unaware = OpticalSearch(signatures, told, searched.nuisances, CHANGES)
    draws = [erring(FILMS, null_residual(seed)) for seed in range(10)]
    threshold = aware.threshold(0.02)
    false = [one for one in draws if largest(aware.score(one)) > threshold]
    fooled = [one for one in draws if largest(unaware.score(one)) > threshold]
    assert len(false) <= 1
    assert len(fooled) > len(false)
    # Three times as much is still seen.
    scores = aware.score(residuals_with(darker_edges(0.2), 0))
    assert scores[0].name == "vignetting"
    assert scores[0].statistic > threshold


def test_null_draws_are_those_of_whole_residuals(signatures, searched):
    # So many trajectories that Student's distribution is normal.
    known = replace(truth(), trajectory_count=10**6)
    search = OpticalSearch(signatures, known, searched.nuisances, CHANGES)
    whole = [largest(search.score(null_residual(1000 + seed))) for seed in range(200)]
    cheap = search.null_statistics(2000, seed=1)
    assert np.mean(whole) == pytest.approx(np.mean(cheap), rel=0.25)
    assert np.quantile(whole, 0.9) == pytest.approx(np.quantile(cheap, 0.9), rel=0.25)


def test_ambient_light_and_gamma_are_flagged_as_a_pair(searched):
    search = searched.search
    pairs = search.likeness()
    together = pairs[frozenset(("ambient_light", "gamma"))]
    assert together > 0.85
    assert together == max(pairs.values())
    assert pairs[frozenset(("gamma", "vignetting"))] < 0.8
    scores = search.score(residuals_with(lambda p: p + 4.0 * LIT[..., None], 5))
    assert set(search.alike(scores)[:2]) == {"ambient_light", "gamma"}


def test_the_gain_of_the_camera_is_no_effect(searched):
    plain = searched.search.whitened(null_residual(2))
    dimmed = searched.search.whitened(residuals_with(lambda p: 0.9 * p, 2))
    # What saturates nowhere is a gain to the last bit, but in the shift of the pattern.
    np.testing.assert_allclose(dimmed, plain, atol=1e-6)


def test_a_small_offset_is_the_camera_s_and_a_large_one_is_not(signatures, null, searched):
    noise, (gain, level) = null.noise, searched.nuisances
    free = replace(level, deviation=np.inf)
    known = OpticalSearch(signatures, noise, (gain, level), CHANGES)
    blind = OpticalSearch(signatures, noise, (gain, free), CHANGES)
    residual = residuals_with(lambda p: p + 4.0 * LIT[..., None], 5)
    found = {score.name: score for score in known.score(residual)}
    lost = {score.name: score for score in blind.score(residual)}
    assert found["ambient_light"].fit > 20.0
    assert not lost["ambient_light"].is_excited


def test_what_the_data_do_not_show_is_not_excited(null, searched):
    # Nothing moves in these films.
    signatures = signatures_of([LIBRARY["motion_blur"], LIBRARY["gamma"]], FILMS, METER)
    search = OpticalSearch(signatures, null.noise, searched.nuisances, CHANGES)
    scores = search.score(null_residual(0))
    found = {score.name: score for score in scores}
    assert not found["motion_blur"].is_excited
    assert found["gamma"].is_excited
