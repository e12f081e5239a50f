# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The most that a network of small images could reach: the ideal completion at its size.

A network whose images have fewer pixels than the sensor's adds a completion that is enlarged to the
sensor's size. Here the completion is the measured image less the mean idle image, reduced to each
size and enlarged again as the networks' is, so that no training enters: no network of that size
that adds to the idle image does better, but for chance. Mean of the frames' PSNR over the whole
frame.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.data.trajectory import Topics, read_trajectory
from dotsim_ros.optics.idle_check import read_idle_images
from dotsim_ros.optics.network.input import resized
from dotsim_ros.twin.image_metrics import image_psnr_db
from studies.data import SENSOR_A
from studies.run import expect_positive


def residual_size(
    *,
    data: Path = SENSOR_A,
    indenters: tuple[str, ...] = ("1_sphere", "3_lying_cylinder"),
    widths: tuple[int, ...] = (64, 160, 240),
    topic: str = "/tactile/image_raw/compressed",
) -> dict[str, Any]:
    """The most that a network of small images could reach: the ideal completion at its size.

    Args:
        data: folder of a data set.
        indenters: that are judged; all where none is given.
        widths: of the images in pixels.
        topic: of the images.
    """
    expect_positive(smallest_width=min(widths))
    measured_set = read_data_set(data)
    idle = read_idle_images(measured_set.idle_images()).astype(np.float64).mean(axis=0)
    height, width = idle.shape[:2]
    scores: dict[str, list[float]] = {"idle": [], **{str(small): [] for small in widths}}
    entries = [entry for entry in measured_set.entries if entry.has_images]
    judged = [entry for entry in entries if not indenters or entry.indenter in indenters]
    if not judged:
        known = ", ".join(sorted({entry.indenter for entry in entries}))
        raise ValueError(f"no images of {' '.join(indenters)}; the data set has {known}")
    for entry in judged:
        images = read_trajectory(entry.bag, topics=Topics(image=topic), channels=("image",)).image
        assert images is not None
        for measured in images.pixels:
            completion = measured - idle
            scores["idle"].append(image_psnr_db(measured, np.rint(idle).astype(np.uint8)))
            for small in widths:
                size = (small, round(small * height / width))
                image = idle + resized(resized(completion, size), (width, height))
                shown = np.clip(np.rint(image), 0, 255).astype(np.uint8)
                scores[str(small)].append(image_psnr_db(measured, shown))
    return {"psnr_db": {name: float(np.mean(values)) for name, values in scores.items()}}
