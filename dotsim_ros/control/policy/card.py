# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The card of a policy: what it was trained for, on what, and how well it performs."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from dotsim_ros.control.policy.images import FINGERPRINT, PolicyView
from dotsim_ros.optics.network.carded_weights import WEIGHTS, CardKind, read_weights

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
        version: of the format.
        name: of the policy.
        sensor: name of the sensor whose simulated images it was trained on.
        indenter: name of what the sensor is held against.
        paths: names of the paths that it follows, in the order of the network's outputs.
        rate_hz: of images and commands.
        image_height, image_width, share, side_px: the fields of `PolicyView`.
        largest_distance: from which on `image_distance` means another sensor.
        weights_sha256, graph_sha256: of the weights (by `weights_hash`) and of the graph's file.
        data: what it was trained on.
        metrics: figures by name.
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
        # Refuses a part of an image that is none.
        PolicyView((self.image_height, self.image_width), self.share, self.side_px)

    @property
    def view(self) -> PolicyView:
        """What part of an image the network sees."""
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
