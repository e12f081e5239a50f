# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Names of the image models that are compared. Importing them loads no model."""

from typing import Literal, get_args

ImageModel = Literal[
    "idle",
    "idle_refined",
    "tacto",
    "tacto_refined",
    "taxim",
    "difftactile",
    "paper",
    "paper_direct",
    "paper_mobile",
    "paper_mobile_warped",
    "unet",
    "carried",
    "tacto_warped",
    "taxim_warped",
    "difftactile_warped",
    "ours",
]
NAMES: tuple[ImageModel, ...] = get_args(ImageModel)
MOBILE = ("paper_mobile", "paper_mobile_warped")
"""The paper's network with a backbone that can be trained to its end without CUDA, added to the
idle image as published, and to the warped one."""
PUBLISHED = ("paper", "paper_direct", *MOBILE, "unet")
"""Published networks, which take hours without CUDA unless their images are small."""
WARPED = ("tacto_warped", "taxim_warped", "difftactile_warped")
"""Published models that complete the warped image, in place of our network."""
BOUND = "bound"
"""The row that learns from measured images of other trajectories: no simulation passes it."""
ClassifiedBy = Literal[
    "bound",
    "idle",
    "tacto",
    "taxim",
    "difftactile",
    "paper",
    "paper_direct",
    "paper_mobile",
    "paper_mobile_warped",
    "unet",
    "carried",
    "ours",
]
"""What the classifiers learn from: images of these models, or measured ones (`BOUND`)."""
