# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Scores of images: figures that can be worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from dotsim_ros.twin.image_metrics import LARGEST_PSNR_DB, psnr_db
from studies.optics.image_scores import score_image, ssim_map

SIZE = (40, 50)
WHOLE = {"frame": None}


def noise_image(seed: int = 0) -> NDArray[np.uint8]:
    """Return an image of noise far from both ends of the scale."""
    random = np.random.default_rng(seed)
    return random.integers(100, 156, size=(*SIZE, 3), dtype=np.uint8)


def test_a_shift_of_all_colours_is_every_error() -> None:
    image = noise_image()
    same = score_image(image, image, WHOLE)["frame"]
    assert same.psnr_db == LARGEST_PSNR_DB
    assert (same.mean_l2, same.significant_l2) == (0.0, 0.0)
    assert same.ssim == pytest.approx(1.0)
    score = score_image(image + np.uint8(51), image, WHOLE)["frame"]
    assert score.psnr_db == pytest.approx(20.0 * np.log10(5.0))
    assert (score.mean_l2, score.significant_l2) == pytest.approx((0.2 * 3**0.5,) * 2)


def test_the_worst_hundredth_is_significant() -> None:
    image = noise_image()
    wrong = image.copy()
    wrong.reshape(-1, 3)[:20, 1] += 51
    score = score_image(wrong, image, WHOLE)["frame"]
    assert SIZE[0] * SIZE[1] == 2000
    assert score.significant_l2 == pytest.approx(0.2)
    assert score.mean_l2 == pytest.approx(0.002)
    assert score.psnr_db == pytest.approx(psnr_db(0.2**2 * 20 / 6000))


def test_a_region_is_judged_by_itself() -> None:
    image = noise_image()
    wrong = image.copy()
    wrong[:, :10] += np.uint8(51)
    left = np.zeros(SIZE, dtype=np.bool_)
    left[:, :10] = True
    scores = score_image(wrong, image, {"frame": None, "left": left, "right": ~left})
    assert scores["left"].mean_l2 == pytest.approx(0.2 * np.sqrt(3.0))
    assert scores["frame"].mean_l2 == pytest.approx(0.2 * np.sqrt(3.0) / 5.0)
    assert scores["right"].psnr_db == LARGEST_PSNR_DB
    assert scores["left"].ssim < scores["frame"].ssim < scores["right"].ssim


def test_ssim_falls_with_structure_not_with_brightness() -> None:
    image = noise_image()
    shuffled = noise_image(seed=5)
    brighter = image + np.uint8(10)
    assert ssim_map(shuffled, image).mean() < 0.2
    assert ssim_map(brighter, image).mean() > 0.95


def test_wrong_shapes_are_refused() -> None:
    image = noise_image()
    with pytest.raises(ValueError, match=r"shapes \(40, 49, 3\) and \(40, 50, 3\)"):
        score_image(image[:, :-1], image, WHOLE)
    with pytest.raises(ValueError, match="float64"):
        score_image(image.astype(np.float64), image, WHOLE)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="region 'disc' has shape"):
        score_image(image, image, {"disc": np.zeros(SIZE, dtype=np.bool_)})
