# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Trained networks as files that run without torch: a graph in ONNX next to weights in safetensors.

The graph refers to the weights in the safetensors file as external data, so they are stored once.
What the exporter has folded together (batch normalisation into convolutions) stays in the graph.
"""

from __future__ import annotations

import hashlib
import io
import json
import struct
import warnings
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from torch import nn

from dotsim_ros.io.files import whole_file
from dotsim_ros.optics.network.card import FINENESS, NetworkCard
from dotsim_ros.optics.network.carded_weights import (
    CARD,
    GRAPH,
    WEIGHTS,
    AnyCard,
    weights_hash,
    write_weights,
)
from dotsim_ros.optics.network.input import FADE, FRAME

INPUTS = ("frame", "rest", "image")
OUTPUT = "added"
OPSET = 20


def graph_of(network: nn.Module, size: tuple[int, int], fineness: int) -> onnx.ModelProto:
    """Return a network in evaluation mode as an ONNX model for one frame.

    Args:
        network: as `networks` describes.
        size: width and height of its images.
        fineness: how often wider and higher they are than the geometry.
    """
    width, height = size[0] // fineness, size[1] // fineness
    frame = torch.zeros(1, FRAME.stop, height, width)
    rest = torch.zeros(1, FADE.stop, height, width)
    image = torch.zeros(1, 3, fineness * height, fineness * width)
    return exported(network, (frame, rest, image), INPUTS, OUTPUT)


def exported(
    network: nn.Module, inputs: tuple[torch.Tensor, ...], input_names: Sequence[str], output: str
) -> onnx.ModelProto:
    """Return a network in evaluation mode as an ONNX model for inputs of these shapes.

    Raises:
        RuntimeError: torch exports nothing.
    """
    with warnings.catch_warnings(), redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            network,
            inputs,
            input_names=list(input_names),
            output_names=[output],
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    if program is None:
        raise RuntimeError("torch.onnx.export returned no program")
    return without_origins(program.model_proto)


def without_origins(model: onnx.ModelProto) -> onnx.ModelProto:
    """Return the model without the exporter's notes on each entry: the lines of code that it came
    from, with the folders of the machine that it was made on."""
    graph = model.graph
    entries = [graph, *graph.node, *graph.initializer, *graph.value_info, *graph.input]
    for entry in [*entries, *graph.output, *model.functions]:
        entry.ClearField("doc_string")
        entry.ClearField("metadata_props")
    return model


def _places(path: Path) -> dict[str, tuple[int, int]]:
    """Return offset and length in bytes of each array in a safetensors file.

    The file begins with the length of its header (8 bytes, little-endian); the header gives the
    places relative to its own end.
    """
    with path.open("rb") as stream:
        (length,) = struct.unpack("<Q", stream.read(8))
        header = json.loads(stream.read(length))
    header.pop("__metadata__", None)
    return {
        name: (8 + length + entry["data_offsets"][0], np.subtract(*entry["data_offsets"][::-1]))
        for name, entry in header.items()
    }


def refer_to_weights(
    model: onnx.ModelProto, weights: Mapping[str, NDArray[Any]], path: Path
) -> None:
    """Let the graph read those of its weights that the file holds from there."""
    places = _places(path)
    for tensor in model.graph.initializer:
        array = onnx.numpy_helper.to_array(tensor)
        known = weights.get(tensor.name)
        if known is None or known.dtype != array.dtype or not np.array_equal(known, array):
            continue
        offset, length = places[tensor.name]
        tensor.ClearField("raw_data")
        tensor.ClearField("float_data")
        tensor.data_location = onnx.TensorProto.EXTERNAL
        for key, value in (("location", WEIGHTS), ("offset", offset), ("length", length)):
            tensor.external_data.add(key=key, value=str(value))


def write_network(
    directory: Path,
    network: nn.Module,
    card: NetworkCard,
) -> NetworkCard:
    """Write a network's three files.

    Args:
        directory: made where it does not exist.
        network: on the CPU, in evaluation mode.
        card: what it is; the hashes are filled in here.

    Returns:
        The card with the hashes.
    """
    weights = {name: value.numpy() for name, value in network.state_dict().items()}
    model = graph_of(network, (card.width, card.height), FINENESS[card.kind])
    return write_carded(directory, model, weights, card)


def write_carded(
    folder: Path, model: onnx.ModelProto, weights: Mapping[str, NDArray[Any]], card: AnyCard
) -> AnyCard:
    """Write graph, weights and card of a network, each file whole or not at all.

    Args:
        folder: made where it does not exist.
        model: its graph; arrays of the name and size of a weight become references to the file.
        weights: by name; the file may hold more than the graph needs.
        card: what it is; the hashes are filled in here.

    Returns:
        The card with the hashes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # The header holds the hash of the graph, and the graph where the header ends: a hash of the
    # same length stands in for it.
    card = replace(card, weights_sha256=weights_hash(weights), graph_sha256="0" * 64)
    draft = folder / f".draft-{WEIGHTS}"
    try:
        write_weights(draft, weights, card)
        refer_to_weights(model, weights, draft)
    finally:
        draft.unlink(missing_ok=True)
    graph = model.SerializeToString(deterministic=True)
    card = replace(card, graph_sha256=hashlib.sha256(graph).hexdigest())
    with whole_file(folder / GRAPH) as part:
        part.write_bytes(graph)
    write_weights(folder / WEIGHTS, weights, card)
    with whole_file(folder / CARD) as part:
        part.write_text(card.text() + "\n", encoding="utf-8")
    return card
