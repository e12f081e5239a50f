# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A network fitted to measured presses, and its images for others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.arrays import Float32Array, ImageArray
from dotsim_ros.learning.examples import inputs_of, make_examples, network_input
from dotsim_ros.learning.networks import make_network
from dotsim_ros.learning.recipe import RECIPES, TrainingRecipe, check_epochs
from dotsim_ros.learning.training import NetworkTraining, Trained, TrainingProgress
from dotsim_ros.optics.network.card import BASES, FORMAT, NetworkCard, camera_hash
from dotsim_ros.optics.network.input import CompletionInput, resized
from dotsim_ros.twin.footage import OpticalPress, Rest

PREDICTED_TOGETHER = 4
"""Frames in one pass of a network that is not trained."""

CPU_WIDTH = dict.fromkeys(BASES, 160) | {"ours": 320, "neighbourhood": 320}
"""Largest width of a network's images, in pixels, where there is no CUDA."""


@dataclass(frozen=True)
class FittedNetwork:
    """A network and the camera that it was trained for: a model of images.

    Attributes:
        kind: of the network.
        trained: the network, and how its training went.
        camera: of the images.
        size: width and height of the network's images.
    """

    kind: str
    trained: Trained
    camera: Camera
    size: tuple[int, int]

    @property
    def name(self) -> str:
        """How tables call it."""
        return self.kind

    def card(self, sensor_name: str) -> NetworkCard:
        """Return the card of a sensor's network, without what it was trained on and by."""
        width, height = self.size
        camera = camera_hash(self.camera)
        return NetworkCard(FORMAT, self.kind, sensor_name, camera, width, height, "", "")

    def predict(self, press: OpticalPress, rest: Rest) -> ImageArray:
        """Return the images (F, H, W, 3) of a press; its measured images are not read."""
        given = network_input(self.kind, rest, self.camera, self.size)
        added = added_images(self.trained.network, given, *inputs_of(press, given))
        full = (self.camera.width, self.camera.height)
        images = []
        for completion, warped in zip(added, press.warped, strict=True):
            base = {"warped": warped, "idle": rest.idle}.get(BASES[self.kind], np.uint8(0))
            image = base + resized(completion, full)
            images.append(np.clip(np.rint(image), 0.0, 255.0).astype(np.uint8))
        return np.stack(images)


def added_images(
    network: nn.Module, given: CompletionInput, frames: Tensor, images: Tensor
) -> Float32Array:
    """Return what a network adds (F, f h, f w, 3), in grey levels."""
    rest = torch.from_numpy(given.rest)[None]
    together = zip(frames.split(PREDICTED_TOGETHER), images.split(PREDICTED_TOGETHER), strict=True)
    with torch.inference_mode():
        parts = [network(frame, rest, image) for frame, image in together]
    return np.ascontiguousarray(255.0 * torch.cat(parts).permute(0, 2, 3, 1).numpy())


def check_width(width: int, widest: int | None = None) -> None:
    """Refuse a width (px) of a network's images.

    Args:
        width: in pixels.
        widest: the measured images' width; None while that is not known.

    Raises:
        ValueError: it is no multiple of 16 from 64 up to the widest.
    """
    if width < 64 or width % 16 or (widest is not None and width > widest):
        raise ValueError(
            f"size is {width}, expected the width of the network's images in pixels: a multiple "
            f"of 16 from 64 to {'' if widest is None else f'{widest}, '}the width measured"
        )


def network_size(
    kind: str, camera: Camera, size: int | None, device: torch.device
) -> tuple[int, int]:
    """Return width and height of a network's images.

    Args:
        kind: of the network.
        camera: of the measured images.
        size: the width asked for; None for the measured one on CUDA, a smaller one on a CPU.
        device: where it is trained.

    Raises:
        ValueError: the width is no multiple of 16 from 64 up to the measured one, or its height
            no multiple of 8.
    """
    width = size
    if width is None:
        width = camera.width if device.type == "cuda" else min(camera.width, CPU_WIDTH[kind])
    check_width(width, camera.width)
    height = round(camera.height * width / camera.width)
    if height % 8:
        raise ValueError(
            f"size {width} gives images of {width}x{height}, expected a height that is a multiple "
            "of 8; choose another width"
        )
    return width, height


def fit_network(
    kind: str,
    train: Sequence[OpticalPress],
    rest: Rest,
    camera: Camera,
    *,
    seed: int = 0,
    epochs: int | None = None,
    size: int | None = None,
    directory: Path | None = None,
    recipe: TrainingRecipe | None = None,
    progress: Callable[[TrainingProgress], None] | None = None,
) -> FittedNetwork:
    """Train a network on measured presses.

    The same seed on the same machine and number of threads gives the same network.

    Args:
        kind: one of `networks.KINDS`.
        train: presses, restricted to the frames to train on.
        rest: what the camera sees of the gel untouched.
        camera: of the measured images.
        seed: of the first weights and of the order of the frames.
        epochs: passes over all frames, resumed runs included; None for the recipe's number.
        size: width of the network's images in pixels; None for the measured one on CUDA and
            `CPU_WIDTH` at most on a CPU.
        directory: where the training leaves its state and resumes from; None for nowhere.
        recipe: how it is trained; None for the kind's own.
        progress: called after every epoch.

    Raises:
        ValueError: no such kind, a size or number of epochs out of range, fewer than ten frames,
            images of another size than the camera's, or a folder with another training's state.
        FloatingPointError: the training diverged.
    """
    check_epochs(epochs)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        network = make_network(kind)
    pixels = network_size(kind, camera, size, device)
    examples = make_examples(kind, train, rest, camera, pixels)
    if kind == "ours":
        # Its output is zero at rest whatever its weights are.
        examples = examples.only_touched()
        if not len(examples.frame):
            raise ValueError(
                f"the gel has moved in none of {len(train)} presses; record presses that touch it"
            )
    recipe = recipe or RECIPES[kind]
    if epochs is not None:
        recipe = replace(recipe, epochs=epochs)
    training = NetworkTraining(
        kind,
        network,
        examples,
        recipe,
        seed=seed,
        device=device,
        directory=directory,
    )
    return FittedNetwork(kind, training.run(progress), camera, pixels)
