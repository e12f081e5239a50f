# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The models of the image that the optics table compares, by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.learning.recipe import check_epochs
from dotsim_ros.twin.footage import OpticalPress, Rest
from studies.optics.judge import Factory, Idle, ImageModel, WarpedIdle
from studies.rivals.optics import per_pixel, tacto, taxim
from studies.rivals.optics.pixels import idle_ground, warped_ground
from studies.run import expect_known

ImageModelName = Literal[
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
NAMES: tuple[ImageModelName, ...] = get_args(ImageModelName)
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

CLIPPED = ("tacto", "tacto_refined", "tacto_warped")
"""Models that get the clipped skin instead of the gel's."""
REFINED = ("idle_refined", "tacto_refined", "carried", *WARPED, "paper_mobile_warped", "ours")
"""Models that get an idle image refined by the frames that they are fitted on, with samples between
its pixels, as `train-optics` makes it. The published ones have the idle image alone; `_refined` is
what they would gain."""
MADE_BY = ("../studies/rivals", "../studies/optics", "learning", "optics")
"""Source that fits a model and predicts with it."""


@dataclass(frozen=True)
class FitSettings:
    """How models are fitted.

    Attributes:
        seed: of all draws.
        network_epochs: of a published network's training; None for its own number. The others take
            a minute or two.
        network_width: of the published networks' images, pixels; None for their own choice.

    Raises:
        ValueError: a seed below zero, or no epoch.
    """

    seed: int = 0
    network_epochs: int | None = None
    network_width: int | None = None

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}, expected 0 or more")
        check_epochs(self.network_epochs, "network_epochs")

    def epochs_of(self, network: str) -> int | None:
        """Return the epochs of a network's training; None for the network's own number."""
        return self.network_epochs if network in PUBLISHED else None

    def width_of(self, network: str) -> int | None:
        """Return the width of a network's images, pixels; None for the network's own choice."""
        return self.network_width if network in PUBLISHED else None


def factory_of(name: str, settings: FitSettings, *, state: Path) -> Factory:
    """Return what makes a model.

    Args:
        name: one of `NAMES`.
        settings: how it is fitted.
        state: folder in which a network's training leaves its state, to resume from.

    Raises:
        ValueError: no such model.
    """
    expect_known("model", [name], NAMES)
    ground = warped_ground if name in WARPED else idle_ground
    match name.removesuffix("_warped"):
        case "idle" | "idle_refined":
            return lambda _train, _rest, _camera: Idle(name)
        case "carried":
            return lambda _train, _rest, _camera: WarpedIdle()
        case "tacto" | "tacto_refined":
            return lambda t, r, c: tacto.fit(t, r, c, seed=settings.seed, ground=ground)
        case "taxim":
            return lambda t, r, c: taxim.fit(t, r, c, seed=settings.seed, ground=ground)
        case "difftactile":
            return lambda t, r, c: per_pixel.fit(t, r, c, seed=settings.seed, ground=ground)

    def make(train: Sequence[OpticalPress], rest: Rest, camera: Camera) -> ImageModel:
        # Loaded on use: the other models need none of it.
        from dotsim_ros.learning.fitting import fit_network

        return fit_network(
            name,
            train,
            rest,
            camera,
            seed=settings.seed,
            epochs=settings.epochs_of(name),
            size=settings.width_of(name),
            directory=state,
            progress=lambda p: print(
                f"{name}: epoch {p.epoch} of {p.epochs}, {p.psnr_db:.2f} dB in training, "
                f"{p.left_s / 60.0:.1f} min left"
            ),
        )

    return make
