# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What has changed in an image since a reference, as DenseTact's drivers show it. Needs no ROS."""

from __future__ import annotations

import cv2
import numpy as np

from dotsim_ros.io.arrays import ImageArray


def difference_image(image: ImageArray, reference: ImageArray, gain: float) -> ImageArray:
    """Return (H, W, 3) the amplified absolute difference of two images in grey.

    So does the public ROS 2 driver of two DenseTact sensors: grey levels, absolute difference,
    times 8, clipped, in three equal channels.

    Args:
        image, reference: (H, W, 3) uint8, red, green, blue.
        gain: of the difference.
    """
    grey, before = (
        cv2.cvtColor(np.ascontiguousarray(each), cv2.COLOR_RGB2GRAY) for each in (image, reference)
    )
    amplified = cv2.convertScaleAbs(cv2.absdiff(grey, before), alpha=gain)
    return np.asarray(cv2.cvtColor(amplified, cv2.COLOR_GRAY2RGB), dtype=np.uint8)
