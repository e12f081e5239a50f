# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The images' part of a search: its rule, its noise file, whose camera it is, what is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from gap_findings import named, no_gap, unknown
from optical_films import (
    CENTRE,
    CHOSEN,
    FILMS,
    FRAMES,
    HEIGHT,
    METER,
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
from dotsim_ros.effects.overlay import Estimate
from dotsim_ros.gap.find import combined
from dotsim_ros.gap.findings import (
    Candidate,
    ChannelGap,
    OpticalFindings,
    TileGap,
    Verdict,
    as_record,
    findings_of,
)
from dotsim_ros.gap.images.case import OpticalCase, Shot
from dotsim_ros.gap.images.fit import ImageSearch
from dotsim_ros.gap.images.null import fit_optical_null, load_optical_null, save_optical_null
from dotsim_ros.gap.images.reading import check_same_unit, pattern_likeness
from dotsim_ros.gap.images.search import signatures_of
from dotsim_ros.gap.report.page import report_files
from dotsim_ros.gap.report.wording import Facts, optical_sentence

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
def null():
    films = [film_of(number) for number in REFERENCES]
    random = np.random.default_rng(7)
    residuals = [drawn(change, random) for change in changes_of(films)]
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
    beyond = (answer.beyond.parameter, answer.beyond.value)
    facts = Facts(nearest=[answer.beyond.effect], beyond=beyond)
    told = optical_sentence(Verdict.UNKNOWN, facts)
    assert "vignetting, but the images ask for edge_loss = 0.4" in told
    assert "its plausible range is 0 to 0.3" in told
    # As large as is plausible is no sign of anything else.
    answer = searched.answer(residuals_with(darker_edges(0.3), 4))
    assert answer.verdict is Verdict.NAMED
    assert answer.beyond is None
    (loss,) = answer.estimates["vignetting"]
    assert loss.value == pytest.approx(0.3, rel=0.02)


def test_what_would_have_to_be_beyond_its_range_is_no_alternative():
    vignetting = LIBRARY["vignetting"]
    (loss,) = vignetting.parameters

    def faint(high):
        size = replace(loss, high=high, probes=(0.05,))
        return replace(vignetting, name="faint", parameters=(size,))

    films = [film_of(number) for number in REFERENCES]
    random = np.random.default_rng(7)
    case = case_of(films, [drawn(change, random) for change in changes_of(films)])
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
def lens_and_light():
    """The search for what depth and normals of the skin enter, next to what is taken for it."""
    effects = [
        LIBRARY[name]
        for name in (
            *("ambient_light", "camera_displacement", "camera_extrinsics", "daylight", "defocus"),
            *("gamma", "vignetting"),
        )
    ]
    films = [film_of(number) for number in REFERENCES]
    random = np.random.default_rng(7)
    residuals = [drawn(change, random) for change in changes_of(films)]
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


def test_an_effect_whose_scatter_is_not_known_is_told_apart(null, signatures):
    assert null.knows(LIBRARY["gamma"])
    assert not null.knows(LIBRARY["motion_blur"])
    with pytest.raises(ValueError, match="does not hold the effect motion_blur"):
        null.variances("motion_blur", signatures["gamma"][0])
    # A file of the user's that takes a shipped effect's name, with another parameter.
    gamma = LIBRARY["gamma"]
    (exponent,) = gamma.parameters
    assert not null.knows(replace(gamma, parameters=(replace(exponent, name="power"),)))


def test_a_reference_tells_the_scatter_of_effects_that_the_file_does_not_know(null):
    films = [film_of(number) for number in REFERENCES]
    random = np.random.default_rng(7)
    case = case_of(films, [drawn(change, random) for change in changes_of(films)])
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


def markdown_of(findings):
    """Return the report without what is drawn of skin and force: an image takes a second."""
    findings = replace(findings, worst=None, places=(), gaps=())
    return report_files(findings, {}, LIBRARY)["report.md"].decode()


def test_effects_that_were_not_tried_are_in_the_report_and_the_record():
    found = replace(optical(Verdict.NO_GAP), not_tried=("my_tint",))
    both = combined(no_gap(), found)
    assert findings_of(as_record(both)) == both
    text = markdown_of(both)
    assert "## Not tried" in text
    assert "my_tint" in text
    assert "--fit-optical-noise" in text
    older = as_record(both)
    del older["optical"]["not_tried"]
    assert findings_of(older).optical.not_tried == ()


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


def optical(verdict):
    """Return a part of the images with a verdict."""
    found = verdict in (Verdict.NAMED, Verdict.SET)
    loss = Estimate("edge_loss", "", 0.1, 0.08, 0.12)
    vignetting = Candidate(
        "vignetting", "Vignetting", True, 88.0, 0.1, 0.9, None, (loss,) if found else ()
    )
    return OpticalFindings(
        verdict,
        f"Images: {verdict.value}.",
        named=("vignetting",) if found else (),
        alternatives=("gamma",) if verdict is Verdict.SET else (),
        statistic=88.0,
        threshold=11.0,
        candidates=(vignetting, Candidate("motion_blur", "Motion blur", False, 0.0, 0.0)),
        gap=ChannelGap("image", "levels", 2.0, 1.9, 0.8, 0.8),
        share_closed=0.97 if found else None,
        share_closed_low=0.9 if found else None,
        share_closed_high=1.0 if found else None,
        stability=1.0 if found else None,
        tiles=(TileGap(0.4, 0.5, 3.0, 1.0), TileGap(0.6, 0.5, 2.0, 1.0)),
        warnings=("2 trajectories with images are few",),
        trajectories=("idle", "press_0"),
        frame_count=1 + FRAMES,
        noise_source="19 trajectories of sensor_a",
    )


@pytest.mark.parametrize(
    ("gel", "images", "expected"),
    [
        (no_gap, Verdict.NO_GAP, Verdict.NO_GAP),
        (no_gap, Verdict.NAMED, Verdict.NAMED),
        (named, Verdict.UNKNOWN, Verdict.NAMED),
        (unknown, Verdict.NO_GAP, Verdict.UNKNOWN),
        (no_gap, Verdict.UNKNOWN, Verdict.UNKNOWN),
        (no_gap, Verdict.UNUSABLE, Verdict.NO_GAP),
        (named, Verdict.UNUSABLE, Verdict.NAMED),
    ],
)
def test_both_parts_make_one_verdict(gel, images, expected):
    both = combined(gel(), optical(images))
    assert both.verdict is expected
    assert both.sentence.startswith(gel().sentence)
    assert both.sentence.endswith(f"Images: {images.value}.")
    assert both.named == gel().named + optical(images).named
    assert findings_of(as_record(both)) == both
    assert "2 trajectories with images are few" in both.warnings
    # Images alone.
    assert combined(replace(no_gap(), sentence=""), optical(images)).verdict is images


def test_the_report_keeps_the_parts_apart(tmp_path: Path):
    both = combined(named(), optical(Verdict.NAMED))
    text = markdown_of(both)
    assert "## Images" in text
    assert "1. Vignetting (vignetting), added" in text
    assert "Share of the images' gap closed, in expected deviations of all tiles: 97 %" in text
    assert "19 trajectories of sensor_a" in text
    assert "1. Coulomb slip at another friction (coulomb_slip), added" in text
    # What no image excites stands next to what no press does.
    assert "| Motion blur |" in text
    refused = markdown_of(combined(no_gap(), optical(Verdict.UNUSABLE)))
    assert "Images: unusable." in refused
    assert "Images: candidates by rank" not in refused
