"""The card of a policy: what it was trained for, on what, and what it is worth."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from dotsim_ros.optics.network_card import CARD_KEY, GRAPH, WEIGHTS, weights_hash
from dotsim_ros.tasks.policy_images import PolicyView

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

    @property
    def view(self) -> PolicyView:
        """What part of an image the network sees."""
        return PolicyView((self.image_height, self.image_width), self.share, self.side_px)

    def text(self) -> str:
        """Return the card as JSON."""
        return json.dumps(asdict(self), indent=2)


def card_from(text: str, path: Path) -> PolicyCard:
    """Return the card that a text holds.

    Args:
        text: JSON.
        path: where it was read, for messages.

    Raises:
        ValueError: it is no card, or one of another version.
    """
    try:
        record = json.loads(text)
        version = record["version"]
    except (json.JSONDecodeError, TypeError, KeyError) as error:
        raise ValueError(f"{path} has no card that can be read ({error})") from error
    if version != FORMAT:
        raise ValueError(
            f"{path} is of version {version}, expected {FORMAT}; train the policy anew with this "
            "version of the package: dotsim_ros train-policy --help"
        )
    known = {entry.name for entry in fields(PolicyCard)}
    if set(record) != known:
        raise ValueError(
            f"{path}: its card has the entries {sorted(record)}, expected {sorted(known)}; train "
            "the policy anew"
        )
    record["paths"] = tuple(record["paths"])
    return PolicyCard(**record)


def read_policy(folder: Path) -> tuple[PolicyCard, dict[str, NDArray[Any]]]:
    """Return card and arrays of a policy after a check that its files are whole.

    Raises:
        FileNotFoundError: no such folder, or one without weights or graph.
        ValueError: a file is corrupt, does not belong to the other, or is of another version.
    """
    path, graph = folder / WEIGHTS, folder / GRAPH
    for needed in (path, graph):
        if not needed.is_file():
            raise FileNotFoundError(
                f"{folder} holds no policy: there is no {needed.name}; make one with "
                "dotsim_ros train-policy"
            )
    try:
        with safe_open(path, framework="numpy") as content:
            card = card_from((content.metadata() or {}).get(CARD_KEY, "null"), path)
            arrays = {name: content.get_tensor(name) for name in content.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise ValueError(
            f"{path} is corrupt ({error}); copy it again or train the policy anew"
        ) from error
    if weights_hash(arrays) != card.weights_sha256:
        raise ValueError(
            f"{path} is corrupt: its weights are not those that its card was written for; copy it "
            "again or train the policy anew"
        )
    if hashlib.sha256(graph.read_bytes()).hexdigest() != card.graph_sha256:
        raise ValueError(
            f"{graph} is corrupt or belongs to other weights than {path.name} beside it; copy both "
            "again or train the policy anew"
        )
    if not np.all(np.isfinite(arrays[USUAL_ROOT])):
        raise ValueError(f"{path} holds weights that are not finite; train the policy anew")
    return card, arrays
