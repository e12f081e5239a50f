# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Policies and networks that somebody made to break their reader: one line that says what is wrong.

The shipped ones are spoilt; hashes are recreated, as whoever wants to be believed would do.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from dotsim_ros.control.policy.network import USUAL_MEAN, USUAL_ROOT, load_policy
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.files import parameter_path
from dotsim_ros.nodes.tactile_policy.files import read_image
from dotsim_ros.optics.network import carded_weights
from dotsim_ros.optics.network.carded_weights import CARD_KEY, GRAPH, WEIGHTS, weights_hash
from dotsim_ros.optics.network.completion import CompletionNetwork
from dotsim_ros.specification import load_sensor

Card = dict[str, Any]
Weights = dict[str, np.ndarray[Any, Any]]
SHIPPED = {"policy": "policies/densetact2_sphere", "network": "networks/sensor_a"}


def contents(folder: Path) -> tuple[Card, Weights]:
    with safe_open(folder / WEIGHTS, framework="numpy") as content:
        card = json.loads(content.metadata()[CARD_KEY])
        return card, {name: content.get_tensor(name) for name in content.keys()}  # noqa: SIM118


@pytest.fixture(scope="module")
def shipped():
    return {
        noun: (*contents(parameter_path(name)), (parameter_path(name) / GRAPH).read_bytes())
        for noun, name in SHIPPED.items()
    }


def opened(noun: str, folder: Path) -> Any:
    if noun == "policy":
        return load_policy(folder)
    camera = Camera.from_specification(load_sensor("sensor_a").camera)
    return CompletionNetwork(folder, sensor="sensor_a", camera=camera)


def write(folder: Path, weights: Weights, card: Card | str, graph: bytes) -> None:
    text = card if isinstance(card, str) else json.dumps(card, indent=2)
    save_file(weights, folder / WEIGHTS, {CARD_KEY: text})
    (folder / GRAPH).write_bytes(graph)


def refusal(noun: str, folder: Path) -> str:
    with pytest.raises(ValueError, match=r"again|expected") as caught:
        opened(noun, folder)
    words = str(caught.value)
    assert str(folder) in words
    assert "\n" not in words
    assert "pickle" not in words
    return words


def test_the_shipped_ones_are_taken_also_where_they_are_written_anew(shipped, tmp_path):
    for noun, name in SHIPPED.items():
        opened(noun, parameter_path(name))
        (tmp_path / noun).mkdir()
        write_with_graph(shipped, noun, tmp_path / noun, shipped[noun][2])
        opened(noun, tmp_path / noun)


CARDS: dict[str, tuple[str, str, Any]] = {
    "a policy's `paths` is a number": ("policy", "paths", 3),
    "a policy's `paths` is empty": ("policy", "paths", []),
    "a policy's `paths` are names of files": ("policy", "paths", [["../../etc/passwd"]]),
    "a policy's `rate_hz` is text": ("policy", "rate_hz", "25"),
    "a policy's `rate_hz` is NaN": ("policy", "rate_hz", float("nan")),
    "a policy's `rate_hz` is zero": ("policy", "rate_hz", 0),
    "a policy's `side_px` is 10^9": ("policy", "side_px", 10**9),
    "a policy's `image_height` is negative": ("policy", "image_height", -480),
    "a policy's `image_width` is 10^9": ("policy", "image_width", 10**9),
    "a policy's `share` is infinite": ("policy", "share", float("inf")),
    "a policy's `largest_distance` is a mapping": ("policy", "largest_distance", {"a": 1}),
    "a policy's `version` is a list": ("policy", "version", [1]),
    "a policy's `name` is null": ("policy", "name", None),
    "a network's `kind` is unknown": ("network", "kind", "theirs"),
    "a network's `width` is 10^9": ("network", "width", 10**9),
    "a network's `height` is odd": ("network", "height", 241),
    "a network's `sensor` is a number": ("network", "sensor", 5),
}


@pytest.mark.fault("networks and cards", "a card of nonsense")
@pytest.mark.parametrize("what", CARDS)
def test_a_card_of_nonsense_is_refused(shipped, tmp_path, what, answered):
    noun, entry, value = CARDS[what]
    card, weights, graph = shipped[noun]
    write(tmp_path, weights, {**card, entry: value}, graph)
    answered(refusal(noun, tmp_path), what=what)


TEXTS = {"no JSON": "{", "null": "null", "a list": "[1]", "3,000 brackets": "[" * 3000}


@pytest.mark.fault("networks and cards", "a card that is none")
@pytest.mark.parametrize("what", TEXTS)
def test_a_card_that_is_none_is_refused(shipped, tmp_path, what, answered):
    _, weights, graph = shipped["network"]
    write(tmp_path, weights, TEXTS[what], graph)
    answered(refusal("network", tmp_path), what=f"the card in a network's weights is {what}")


def without_mean(weights: Weights) -> None:
    del weights[USUAL_MEAN]


def short_root(weights: Weights) -> None:
    weights[USUAL_ROOT] = weights[USUAL_ROOT][:5]


def whole_mean(weights: Weights) -> None:
    weights[USUAL_MEAN] = weights[USUAL_MEAN].astype(np.int64)


def nan_mean(weights: Weights) -> None:
    weights[USUAL_MEAN] = np.full_like(weights[USUAL_MEAN], np.nan)


def infinite_weight(weights: Weights) -> None:
    name = min(name for name in weights if name.endswith(".half"))
    weights[name] = np.full_like(weights[name], np.inf)


STATISTICS = {
    "the training images' mean is missing": without_mean,
    "the training images' statistics have another shape": short_root,
    "the training images' mean is of whole numbers": whole_mean,
    "the training images' mean is NaN": nan_mean,
    "weights are infinite": infinite_weight,
}


@pytest.mark.fault("networks and cards", "weights of nonsense")
@pytest.mark.parametrize("what", STATISTICS)
def test_weights_of_nonsense_are_refused(shipped, tmp_path, what, answered):
    card, weights, graph = shipped["policy"]
    weights = dict(weights)
    STATISTICS[what](weights)
    write(tmp_path, weights, {**card, "weights_sha256": weights_hash(weights)}, graph)
    answered(refusal("policy", tmp_path), what=f"a policy: {what}")


@pytest.mark.fault("networks and cards", "weights that promise more than the file holds")
def test_weights_that_promise_more_than_the_file_holds_are_refused(shipped, tmp_path, answered):
    header = json.dumps(
        {"a": {"dtype": "F32", "shape": [10**12], "data_offsets": [0, 4 * 10**12]}}
    ).encode()
    (tmp_path / WEIGHTS).write_bytes(len(header).to_bytes(8, "little") + header)
    (tmp_path / GRAPH).write_bytes(shipped["network"][2])
    answered(refusal("network", tmp_path))
    (tmp_path / WEIGHTS).write_bytes((2**62).to_bytes(8, "little"))
    refusal("network", tmp_path)


@pytest.mark.fault("networks and cards", "weights of a type that is none of NumPy's")
def test_weights_of_a_type_that_is_none_of_numpys_are_refused(shipped, tmp_path, answered):
    header = json.dumps({"a": {"dtype": "F8_E4M3", "shape": [2], "data_offsets": [0, 2]}}).encode()
    (tmp_path / WEIGHTS).write_bytes(len(header).to_bytes(8, "little") + header + bytes(2))
    (tmp_path / GRAPH).write_bytes(shipped["network"][2])
    answered(refusal("network", tmp_path))


@pytest.mark.fault("networks and cards", "a file of weights of 3 GB")
def test_a_file_that_is_too_large_is_not_read(shipped, tmp_path, answered):
    # A hole in the file: it takes no place.
    with (tmp_path / WEIGHTS).open("wb") as stream:
        stream.truncate(3_000_000_000)
    (tmp_path / GRAPH).write_bytes(shipped["network"][2])
    answered(refusal("network", tmp_path))
    assert carded_weights.LARGEST_FILE_BYTES < 3_000_000_000


def write_with_graph(shipped: Any, noun: str, folder: Path, graph: bytes) -> None:
    card, weights, _ = shipped[noun]
    card = {**card, "graph_sha256": hashlib.sha256(graph).hexdigest()}
    card["weights_sha256"] = weights_hash(weights)
    write(folder, weights, card, graph)


def renamed_weights(graph: bytes) -> bytes:
    """Return a graph that takes its weights from a file outside of its folder."""
    return graph.replace(b"weights.safetensors", b"/../../../etc/hosts")


def renamed_input(graph: bytes) -> bytes:
    return graph.replace(b"picture", b"pixture")


GRAPHS: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "is empty": ("network", lambda graph: b""),
    "is text": ("network", lambda graph: b"no graph at all"),
    "is cut short": ("network", lambda graph: graph[:2000]),
    "takes its weights from `/../../../etc/hosts`": ("policy", renamed_weights),
    "takes an input of another name": ("policy", renamed_input),
}


@pytest.mark.fault("networks and cards", "a graph of nonsense")
@pytest.mark.parametrize("what", GRAPHS)
def test_a_graph_of_nonsense_is_refused(shipped, tmp_path, what, answered):
    noun, spoil = GRAPHS[what]
    write_with_graph(shipped, noun, tmp_path, spoil(shipped[noun][2]))
    words = refusal(noun, tmp_path)
    # The rest is ONNX Runtime's, which changes with its version.
    said = words if "expected" in words else re.sub(r" \(.*\)", "", words)
    answered(said, what=f"a network's graph {what}")


@pytest.mark.fault("networks and cards", "a network's graph is another's")
def test_a_graph_of_other_inputs_is_refused(shipped, tmp_path, answered):
    card, weights, graph = shipped["network"]
    # The card is believed by its hashes: the sizes are checked against the graph.
    write(tmp_path, weights, {**card, "width": 160, "height": 120}, graph)
    answered(refusal("network", tmp_path))


IMAGES = {
    "is no image": b"no image",
    "is cut short": b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR",
    "announces 30000 x 30000 pixels": None,
}


@pytest.mark.fault("networks and cards", "an idle image of nonsense")
@pytest.mark.parametrize("what", IMAGES)
def test_an_idle_image_of_nonsense_is_refused(tmp_path, what, answered):
    import zlib

    content = IMAGES[what]
    if content is None:
        head = b"IHDR" + (30000).to_bytes(4, "big") * 2 + bytes([8, 2, 0, 0, 0])
        content = b"\x89PNG\r\n\x1a\n\0\0\0\r" + head + zlib.crc32(head).to_bytes(4, "big")
        content += b"\0\0\0\0IEND" + zlib.crc32(b"IEND").to_bytes(4, "big")
    path = tmp_path / "idle.png"
    path.write_bytes(content)
    with pytest.raises(ValueError, match="expected") as caught:
        read_image(path)
    answered(caught.value, what=f"`idle_image` of `tactile_policy` {what}")
