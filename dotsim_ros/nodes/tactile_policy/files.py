"""The files that `tactile_policy` is given: a policy's folder and an idle image. Needs no ROS."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dotsim_ros.files import parameter_path


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
    if Path(text).is_dir():
        return Path(text)
    if "/" in text:
        raise FileNotFoundError(f"no policy folder {text}")
    return parameter_path(f"policies/{text}")


def read_image(path: Path) -> NDArray[np.uint8]:
    """Return the (H, W, 3) uint8 pixels of an image file, red, green, blue.

    Raises:
        FileNotFoundError: no such file.
        ValueError: it is no image.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no idle image {path}")
    try:
        with Image.open(path) as crop:
            return np.asarray(crop.convert("RGB"), dtype=np.uint8)
    except OSError as error:
        raise ValueError(f"{path} is no image that can be read: {error}") from error
