# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A policy that follows a path by touch: an image goes in, a velocity of the sensor comes out.

It is run by ONNX Runtime; torch is loaded by `save_policy` alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dotsim_ros.control.policy.card import (
    COMMAND_SIZE,
    POLICY,
    USUAL_MEAN,
    USUAL_ROOT,
    PolicyCard,
    read_policy,
)
from dotsim_ros.control.policy.images import CHANNEL_COUNT, PolicyInput, fingerprint
from dotsim_ros.io.arrays import Float32Array, FloatArray, ImageArray
from dotsim_ros.io.documents import shortened, value_text
from dotsim_ros.optics.network.carded_weights import GRAPH
from dotsim_ros.optics.network.session import Network

if TYPE_CHECKING:
    from torch import nn


INPUT = "picture"
THREADS = 1
"""A second one gains a third on an idle machine, and costs tails next to a simulation."""


class Policy:
    """A trained policy with the path that it follows.

    Args:
        network: the graph.
        card: what the policy is.
        usual_mean, usual_root: (F,) and (F, F); see `policy_card`.
        path: name of the path to follow.

    Attributes:
        card: what the policy is.
        name: of the policy.
        image_shape: height and width of its images; others of that aspect ratio are scaled.
        paths: names of the paths that it can follow.
        path: the one that it follows.
        rate_hz: of images and commands.
        largest_distance: images with a larger `image_distance` are of another sensor.
    """

    def __init__(
        self,
        network: Network,
        card: PolicyCard,
        *,
        usual_mean: Float32Array,
        usual_root: Float32Array,
        path: str,
    ) -> None:
        self._network, self.card = network, card
        self._usual_mean, self._usual_root = usual_mean, usual_root
        self._row = card.paths.index(path)
        self._view = card.view
        self._idle: ImageArray | None = None
        self._input: PolicyInput | None = None
        self.path, self.paths, self.name = path, card.paths, card.name
        self.image_shape = self._view.image_shape
        self.rate_hz, self.largest_distance = card.rate_hz, card.largest_distance

    def _check(self, image: ImageArray, idle: ImageArray) -> None:
        self._view.check(image, "image")
        self._view.check(idle, "idle image")
        if image.shape != idle.shape:
            raise ValueError(
                f"the image is {image.shape[1]}x{image.shape[0]} and the idle image "
                f"{idle.shape[1]}x{idle.shape[0]}, expected one size; take the idle image again"
            )

    def _input_for(self, idle: ImageArray) -> PolicyInput:
        if self._input is None or self._idle is None or not np.array_equal(idle, self._idle):
            self._idle = idle.copy()
            self._input = PolicyInput(self._view.crop(idle))
        return self._input

    def __call__(self, image: ImageArray, idle: ImageArray) -> FloatArray:
        """Return (6,) the velocity that the sensor should have, along its own axes.

        Args:
            image: (h, w, 3) uint8, red, green, blue.
            idle: the same without contact.

        Returns:
            Linear velocity of the origin of `densetact_base` in m/s, then the angular velocity in
            rad/s.

        Raises:
            ValueError: an image is no colour image, or not of the policy's aspect ratio, or the
                two are not of one size.
        """
        self._check(image, idle)
        given = self._input_for(idle)(self._view.crop(image))
        commands = self._network({INPUT: given[None]})
        return np.asarray(commands[0, self._row], dtype=np.float64)

    def image_distance(self, image: ImageArray, idle: ImageArray) -> float:
        """Return how unlike the training images a pair is: about 1 for those, far above
        `largest_distance` for images of something else, or for an image that does not go with the
        idle image.

        Args:
            image, idle: as for a call.

        Raises:
            ValueError: as for a call.
        """
        self._check(image, idle)
        deviation = self._usual_root @ (fingerprint(image, idle) - self._usual_mean)
        return float(np.sqrt(np.mean(np.square(deviation, dtype=np.float64))))


def load_policy(folder: Path, path: str = "", *, thread_count: int = THREADS) -> Policy:
    """Return the policy that a folder holds.

    Args:
        folder: that `dotsim_ros train-policy` wrote.
        path: name of the path to follow; the policy's first where empty.
        thread_count: of the network.

    Raises:
        FileNotFoundError: no policy there.
        ValueError: a file is corrupt or of another version, the policy has no such path, or its
            graph cannot be run, or takes or gives something else.
    """
    card, arrays = read_policy(folder)
    path = path or card.paths[0]
    if path not in card.paths:
        raise ValueError(
            f"the policy {value_text(card.name)} follows no path {value_text(path)}; choose one of "
            f"{shortened(', '.join(card.paths))}"
        )
    network = Network(
        folder / GRAPH,
        inputs={INPUT: (1, CHANNEL_COUNT, card.side_px, card.side_px)},
        output=(1, len(card.paths), COMMAND_SIZE),
        thread_count=thread_count,
        noun=POLICY.noun,
    )
    return Policy(
        network,
        card,
        usual_mean=arrays[USUAL_MEAN],
        usual_root=arrays[USUAL_ROOT],
        path=path,
    )


def save_policy(
    folder: Path,
    network: nn.Module,
    card: PolicyCard,
    *,
    usual_mean: Float32Array,
    usual_root: Float32Array,
) -> PolicyCard:
    """Write a policy: weights in half precision, the graph that refers to them, and the card.

    Args:
        folder: made where it does not exist.
        network: on the CPU; maps (1, CHANNEL_COUNT, side, side) to (1, paths, 6), m/s and rad/s.
        card: what it is; the hashes are filled in here.
        usual_mean, usual_root: (F,) and (F, F); see `policy_card`.

    Returns:
        The card with the hashes.
    """
    # Loaded on use: it takes torch.
    from dotsim_ros.control.policy.export import write_policy

    usual = {USUAL_MEAN: usual_mean, USUAL_ROOT: usual_root}
    return write_policy(folder, network, card, usual)
