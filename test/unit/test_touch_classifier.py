# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a classifier of touches sees: the touch wherever it lies, and not the light."""

import cv2
import numpy as np
import pytest
import torch

from dotsim_ros.io.arrays import ImageArray
from studies.classification.classifier import (
    ClassifierSettings,
    classified,
    touched_as_taken,
    train_classifier,
)

IDLE = np.full((120, 160, 3), 100, dtype=np.uint8)
SETTINGS = ClassifierSettings(side_px=30, epochs=12)


def disc(x: int, y: int, axes: tuple[int, int] = (15, 15), level: int = 140) -> ImageArray:
    """Return the idle image with an ellipse on it."""
    image = cv2.ellipse(IDLE.copy(), (x, y), axes, 0.0, 0.0, 360.0, (level, 80, 100), -1)
    return np.asarray(image)


def test_a_touch_is_seen_alike_wherever_it_lies() -> None:
    seen = touched_as_taken(np.stack([disc(60, 50), disc(102, 74)]), IDLE, SETTINGS)
    assert seen.shape == (2, 4, 30, 30)
    assert np.allclose(seen[0], seen[1], atol=0.1)
    # The disc is 31 pixels wide, the window half of the image's height.
    assert np.mean(seen[0, 3] > 0.5) == pytest.approx(np.pi * (15.5 / 60.0) ** 2, rel=0.1)


def test_shapes_are_told_apart_at_new_places_and_turns() -> None:
    torch.set_num_threads(1)
    random = np.random.default_rng(0)
    places = [(int(random.integers(50, 110)), int(random.integers(40, 80))) for _ in range(96)]
    shapes = [(12, 12), (22, 6)]
    images = np.stack([disc(x, y, shapes[k % 2]) for k, (x, y) in enumerate(places)])
    labels = np.arange(len(images)) % 2
    network = train_classifier(touched_as_taken(images, IDLE, SETTINGS), labels, 2, SETTINGS, 0)
    upright = np.stack([disc(70, 61, (12, 12)), disc(71, 60, (6, 22)), disc(66, 55, (22, 6))])
    told = classified(network, touched_as_taken(upright, IDLE, SETTINGS))
    assert told.tolist() == [0, 1, 1]
