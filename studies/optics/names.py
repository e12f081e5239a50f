# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Names of the image models that are compared. Importing them loads no model."""

MOBILE = ("paper_mobile", "paper_mobile_warped")
"""The paper's network with a backbone that can be trained to its end without CUDA, added to the
idle image as published, and to the warped one."""
PUBLISHED = ("paper", "paper_direct", *MOBILE, "unet")
"""Published networks, which take hours without CUDA unless their images are small."""
NETWORKS = ("ours", *PUBLISHED)
"""Kinds of networks of `dotsim_ros.learning`."""
WARPED = ("tacto_warped", "taxim_warped", "difftactile_warped")
"""Published models that complete the warped image, in place of our network."""
NAMES = (
    "idle",
    "idle_refined",
    "tacto",
    "tacto_refined",
    "taxim",
    "difftactile",
    *PUBLISHED,
    "carried",
    *WARPED,
    "ours",
)
OPTIONAL = (*MOBILE, "unet")
"""Models that are compared only on request."""
BOUND = "bound"
"""The row that learns from measured images of other trajectories: no simulation passes it."""
CLASSIFIED_BY = (BOUND, "idle", "tacto", "taxim", "difftactile", *PUBLISHED, "carried", "ours")
"""What the classifiers learn from: images of these models, or measured ones (`BOUND`)."""
BLIND_OR_SLOW = ("idle", "paper_direct", *OPTIONAL)
"""Of these, what is left out unless it is asked for: it shows no contact, or trains for hours."""
