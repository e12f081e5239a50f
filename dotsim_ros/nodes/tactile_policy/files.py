# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The files that `tactile_policy` is given: a policy's folder and an idle image. Needs no ROS."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dotsim_ros.io.documents import shortened
from dotsim_ros.io.files import expanded, shipped_path
from msg_adapters.image import LARGEST_PIXEL_COUNT


def policy_folder(text: str) -> Path:
    """Return the folder of a policy: a path, or a name below params/policies.

    Raises:
        ValueError: no name.
        FileNotFoundError: no such folder.
    """
    if not text:
        raise ValueError(
            "the parameter policy is empty, expected the folder that train-policy wrote, or a name "
            "below params/policies"
        )
    path = expanded(text)
    if path.is_dir():
        return path
    if "/" in text:
        raise FileNotFoundError(f"no policy folder {text}")
    return shipped_path("policies", text, "policy", "the folder that train-policy wrote")


def read_image(path: Path) -> NDArray[np.uint8]:
    """Return the (H, W, 3) uint8 pixels of an image file, red, green, blue.

    Raises:
        FileNotFoundError: no such file.
        ValueError: it is no image, or one of more than `LARGEST_PIXEL_COUNT` pixels.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no idle image {path}")
    try:
        with warnings.catch_warnings():
            # Pillow warns of large images, which are refused here.
            warnings.simplefilter("ignore")
            with Image.open(path) as crop:
                width, height = crop.size
                if width * height > LARGEST_PIXEL_COUNT:
                    raise ValueError(
                        f"{path} has {width}x{height} pixels, expected at most "
                        f"{LARGEST_PIXEL_COUNT} pixels"
                    )
                return np.asarray(crop.convert("RGB"), dtype=np.uint8)
    # What its readers meet in a broken file, and an image that it thinks too large to be one.
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError(
            f"{path} is no image that can be read ({shortened(error)}); expected a whole PNG or "
            "JPEG file"
        ) from error
