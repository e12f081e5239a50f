# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A policy that follows a path by touch: an image goes in, a velocity of the sensor comes out.

It is run by ONNX Runtime, without torch. Its card says what it was trained for, on what, and how
well it performs.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.control.policy.images import (
    CHANNEL_COUNT,
    FINGERPRINT,
    PolicyInput,
    PolicyView,
    fingerprint,
)
from dotsim_ros.io.arrays import Float32Array, FloatArray, ImageArray
from dotsim_ros.io.documents import shortened, value_text
from dotsim_ros.optics.network.carded_weights import GRAPH, WEIGHTS, CardKind, read_weights
from dotsim_ros.optics.network.session import Network

INPUT = "picture"
THREADS = 1
"""A second one gains a third on an idle machine, and costs tails next to a simulation."""
FORMAT = 1
"""Raised whenever a policy's input or output changes its meaning."""

COMMAND_SIZE = 6
USUAL_MEAN = "usual.mean"
USUAL_ROOT = "usual.root"
"""Names in the weights' file: mean (F,) of the training images' fingerprints, and the matrix
(F, F) that makes their deviations independent, of unit variance."""


@dataclass(frozen=True)
class PolicyCard:
    """What a policy is.

    Attributes:
        sensor, indenter: names of whose simulated images it was trained on.
        paths: names of the paths that it follows, in the order of the network's outputs.
        image_height, image_width, share, side_px: the fields of `PolicyView`.
        largest_distance: from which on `image_distance` means another sensor.
        weights_sha256, graph_sha256: of the weights (by `weights_hash`) and of the graph's file.
        data, metrics: what it was trained on, and figures by name.
        commit, date, command: that it was trained by.

    Raises:
        ValueError: a number is out of range, or the paths have no names.
    """

    version: int
    name: str
    sensor: str
    indenter: str
    paths: tuple[str, ...]
    rate_hz: float
    image_height: int
    image_width: int
    share: float
    side_px: int
    largest_distance: float
    weights_sha256: str = ""
    graph_sha256: str = ""
    data: dict[str, Any] = field(default_factory=dict)
    metrics: dict[str, Any] = field(default_factory=dict)
    commit: str = ""
    date: str = ""
    command: str = ""

    def __post_init__(self) -> None:
        # JSON knows no tuples.
        object.__setattr__(self, "paths", tuple(self.paths))
        if not self.paths or "" in self.paths or len(set(self.paths)) < len(self.paths):
            raise ValueError(f"paths is {list(self.paths)}, expected names, each of them once")
        for name, largest in (("rate_hz", 1000.0), ("largest_distance", 1e9)):
            if not 0.0 < getattr(self, name) <= largest:
                raise ValueError(
                    f"{name} is {getattr(self, name):g}, expected above 0 and at most {largest:g}"
                )
        # Refuses a part of an image that there is not.
        _ = self.view

    @property
    def view(self) -> PolicyView:
        """What part of an image the network sees; raises a ValueError where there is none."""
        return PolicyView((self.image_height, self.image_width), self.share, self.side_px)

    def text(self) -> str:
        """Return the card as JSON."""
        return json.dumps(asdict(self), indent=2)


POLICY = CardKind(PolicyCard, FORMAT, "policy", "dotsim_ros train-policy")


def read_policy(folder: Path) -> tuple[PolicyCard, dict[str, NDArray[Any]]]:
    """Return card and arrays of a policy after a check that its files are whole.

    Raises:
        FileNotFoundError, ValueError: as `read_weights`, and where the training images' statistics
            are missing or of another shape.
    """
    card, arrays = read_weights(folder, POLICY)
    for name, shape in ((USUAL_MEAN, (FINGERPRINT,)), (USUAL_ROOT, (FINGERPRINT, FINGERPRINT))):
        found = arrays.get(name)
        if found is None or found.shape != shape or found.dtype.kind != "f":
            had = "is missing" if found is None else f"is {found.dtype} of shape {found.shape}"
            raise ValueError(
                f"{folder / WEIGHTS}: {name} {had}, expected numbers of shape {shape}; train the "
                "policy again"
            )
    return card, arrays


class Policy:
    """A trained policy with the path that it follows.

    Attributes:
        image_shape: height and width of its images; others of that aspect ratio are scaled.
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

        Raises:
            ValueError: as for a call.
        """
        self._check(image, idle)
        deviation = self._usual_root @ (fingerprint(image, idle) - self._usual_mean)
        return float(np.sqrt(np.mean(np.square(deviation, dtype=np.float64))))


def load_policy(folder: Path, path: str = "") -> Policy:
    """Return the policy that a folder holds.

    Args:
        path: name of the path to follow; the policy's first where empty.

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
        thread_count=THREADS,
        noun=POLICY.noun,
    )
    return Policy(
        network,
        card,
        usual_mean=arrays[USUAL_MEAN],
        usual_root=arrays[USUAL_ROOT],
        path=path,
    )
