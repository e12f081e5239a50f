# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Weights of a network and the card that describes them: a folder of three files.

- `weights.safetensors`: the weights; its header carries the card.
- `network.onnx`: the network's graph, whose weights are those of the file next to it.
- `card.json`: the same card, for people to read.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from dotsim_ros.io.documents import parse_json, shortened, value_text
from dotsim_ros.io.files import whole_file

WEIGHTS = "weights.safetensors"
GRAPH = "network.onnx"
CARD = "card.json"
CARD_KEY = "card"
LARGEST_FILE_BYTES = 2_000_000_000


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
        ValueError: it is no card, or one of another version; an entry is missing, unknown, of the
            wrong type or out of range.
    """
    try:
        record = parse_json(text, "the card")
        if not isinstance(record, dict) or "version" not in record:
            raise ValueError(f"the card is {value_text(record)}, without a version")
    except ValueError as error:
        raise ValueError(
            f"{path} has no card that can be read ({shortened(error)}); copy it again or train the "
            f"{kind.noun} again"
        ) from error
    version = record["version"]
    if version != kind.version:
        raise ValueError(
            f"{path} is of version {value_text(version)}, expected {kind.version}; train the "
            f"{kind.noun} again with this version of the package: {kind.command} --help"
        )
    known = {entry.name for entry in fields(kind.card)}
    if set(record) != known:
        raise ValueError(
            f"{path}: its card has the entries {value_text(sorted(record))}, expected "
            f"{sorted(known)}; train the {kind.noun} again"
        )
    for name, hint in get_type_hints(kind.card).items():
        expected = _misfit(record[name], hint)
        if expected:
            raise ValueError(
                f"{path}: {name} of its card is {value_text(record[name])}, expected {expected}; "
                f"train the {kind.noun} again"
            )
    try:
        return kind.card(**record)
    except ValueError as error:
        raise ValueError(f"{path}: its card: {error}; train the {kind.noun} again") from error


def _misfit(value: Any, hint: Any) -> str:
    """Return what a value of JSON should be by a type hint; empty where it is that."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if hint is int:
        return "" if is_number and isinstance(value, int) else "a whole number"
    if hint is float:
        return "" if is_number and math.isfinite(value) else "a finite number"
    if hint is str:
        return "" if isinstance(value, str) else "text"
    if get_origin(hint) is tuple:
        are_texts = isinstance(value, list) and all(isinstance(each, str) for each in value)
        return "" if are_texts else "a list of texts"
    return "" if isinstance(value, dict) else "names and their values"


def read_weights(folder: Path, kind: CardKind[AnyCard]) -> tuple[AnyCard, dict[str, NDArray[Any]]]:
    """Return card and weights of a folder after a check that its files are whole.

    Raises:
        FileNotFoundError: no such folder, or one without weights or graph.
        ValueError: a file is corrupt, too large, does not belong to the other, or is of another
            version; a weight is not finite.
    """
    path, graph = folder / WEIGHTS, folder / GRAPH
    for needed in (path, graph):
        if not needed.is_file():
            raise FileNotFoundError(
                f"{folder} holds no {kind.noun}: there is no {needed.name}; make one with "
                f"{kind.command}"
            )
        size = needed.stat().st_size
        if size > LARGEST_FILE_BYTES:
            raise ValueError(
                f"{needed} has {size} bytes, expected at most {LARGEST_FILE_BYTES}; it is no "
                f"{kind.noun} that {kind.command} wrote"
            )
    again = f"again or train the {kind.noun} again"
    try:
        with safe_open(path, framework="numpy") as content:
            text = (content.metadata() or {}).get(CARD_KEY, "null")
            weights = {name: content.get_tensor(name) for name in content.keys()}  # noqa: SIM118
    # Types that numpy has not, too.
    except (SafetensorError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"{path} is corrupt ({shortened(error)}); copy it {again}") from error
    card = card_from(text, path, kind)
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
    for name, array in weights.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise ValueError(f"{path} holds weights that are not finite ({name}); copy it {again}")
    return card, weights


def write_weights(path: Path, weights: Mapping[str, NDArray[Any]], card: Card) -> None:
    """Write weights and card as a safetensors file, whole or not at all."""
    arrays = {name: np.ascontiguousarray(array) for name, array in weights.items()}
    with whole_file(path) as part:
        part.write_bytes(save(arrays, metadata={CARD_KEY: card.text()}))
