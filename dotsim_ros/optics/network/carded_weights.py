"""Weights of a network and the card that describes them: a folder of three files.

- `weights.safetensors`: the weights; its header carries the card.
- `network.onnx`: the network's graph, whose weights are those of the file beside it.
- `card.json`: the same card, for people to read.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from dotsim_ros.files import whole_file

WEIGHTS = "weights.safetensors"
GRAPH = "network.onnx"
CARD = "card.json"
CARD_KEY = "card"


class Card(Protocol):
    """The description of weights, a data class: JSON with a `version` and these entries."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def weights_sha256(self) -> str:
        """Hash of the weights, by `weights_hash`."""

    @property
    def graph_sha256(self) -> str:
        """Hash of the graph's file."""

    def text(self) -> str:
        """Return the card as JSON."""


AnyCard = TypeVar("AnyCard", bound=Card)


@dataclass(frozen=True)
class CardKind(Generic[AnyCard]):
    """What a card is of.

    Attributes:
        card: its class.
        version: of the format.
        noun: what messages call it.
        command: that trains one.
    """

    card: type[AnyCard]
    version: int
    noun: str
    command: str


def weights_hash(weights: Mapping[str, NDArray[Any]]) -> str:
    """Return the SHA-256 of weights: names, shapes and values."""
    digest = hashlib.sha256()
    for name in sorted(weights):
        array = np.ascontiguousarray(weights[name])
        digest.update(f"{name} {array.dtype} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def card_from(text: str, path: Path, kind: CardKind[AnyCard]) -> AnyCard:
    """Return the card that a text holds.

    Args:
        text: JSON.
        path: where it was read, for messages.
        kind: which card is expected.

    Raises:
        ValueError: it is no card, or one of another version.
    """
    try:
        record = json.loads(text)
        version = record["version"]
    except (json.JSONDecodeError, TypeError, KeyError) as error:
        raise ValueError(f"{path} has no card that can be read ({error})") from error
    if version != kind.version:
        raise ValueError(
            f"{path} is of version {version}, expected {kind.version}; train the {kind.noun} anew "
            f"with this version of the package: {kind.command} --help"
        )
    known = {entry.name for entry in fields(kind.card)}
    if set(record) != known:
        raise ValueError(
            f"{path}: its card has the entries {sorted(record)}, expected {sorted(known)}; train "
            f"the {kind.noun} anew"
        )
    return kind.card(**record)


def read_weights(folder: Path, kind: CardKind[AnyCard]) -> tuple[AnyCard, dict[str, NDArray[Any]]]:
    """Return card and weights of a folder after a check that its files are whole.

    Raises:
        FileNotFoundError: no such folder, or one without weights or graph.
        ValueError: a file is corrupt, does not belong to the other, or is of another version.
    """
    path, graph = folder / WEIGHTS, folder / GRAPH
    for needed in (path, graph):
        if not needed.is_file():
            raise FileNotFoundError(
                f"{folder} holds no {kind.noun}: there is no {needed.name}; make one with "
                f"{kind.command}"
            )
    again = f"again or train the {kind.noun} anew"
    try:
        with safe_open(path, framework="numpy") as content:
            card = card_from((content.metadata() or {}).get(CARD_KEY, "null"), path, kind)
            weights = {name: content.get_tensor(name) for name in content.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise ValueError(f"{path} is corrupt ({error}); copy it {again}") from error
    if weights_hash(weights) != card.weights_sha256:
        raise ValueError(
            f"{path} is corrupt: its weights are not those that its card was written for; copy it "
            f"{again}"
        )
    if hashlib.sha256(graph.read_bytes()).hexdigest() != card.graph_sha256:
        raise ValueError(
            f"{graph} is corrupt or belongs to other weights than {path.name} beside it; copy both "
            f"{again}"
        )
    return card, weights


def write_weights(path: Path, weights: Mapping[str, NDArray[Any]], card: Card) -> None:
    """Write weights and card as a safetensors file, whole or not at all."""
    arrays = {name: np.ascontiguousarray(array) for name, array in weights.items()}
    with whole_file(path) as part:
        part.write_bytes(save(arrays, metadata={CARD_KEY: card.text()}))
