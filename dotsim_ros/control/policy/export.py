# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Policies as files that run without torch: a graph in ONNX next to half-precision weights.

The graph widens each weight to single precision, which ONNX Runtime does once, when it opens the
graph: it is as fast as single precision and half as large.
"""

from __future__ import annotations

import io
import warnings
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from torch import nn

from dotsim_ros.control.policy.card import PolicyCard
from dotsim_ros.control.policy.images import CHANNEL_COUNT
from dotsim_ros.learning.export import without_origins, write_carded

INPUT, OUTPUT = "picture", "commands"
OPSET = 20
LEAST_SIZE = 64
"""Arrays with fewer numbers stay in the graph, in single precision."""

Arrays = dict[str, NDArray[Any]]


def graph_of(network: nn.Module, side_px: int) -> onnx.ModelProto:
    """Return a network in evaluation mode as an ONNX model for one crop."""
    crop = torch.zeros(1, CHANNEL_COUNT, side_px, side_px)
    with warnings.catch_warnings(), redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            network,
            (crop,),
            input_names=[INPUT],
            output_names=[OUTPUT],
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    if program is None:
        raise RuntimeError("torch.onnx.export returned no program")
    return without_origins(program.model_proto)


def halve_weights(model: onnx.ModelProto) -> Arrays:
    """Let a model widen its larger weights from half precision; return these, by name.

    Raises:
        ValueError: a weight is too large for half precision, or not finite.
    """
    halves: Arrays = {}
    widened = []
    for tensor in model.graph.initializer:
        array = onnx.numpy_helper.to_array(tensor)
        if array.dtype != np.float32 or array.size < LEAST_SIZE:
            continue
        with np.errstate(over="ignore"):
            half = array.astype(np.float16)
        if not np.all(np.isfinite(half)):
            raise ValueError(f"weights {tensor.name!r} do not fit half precision; train again")
        name = tensor.name
        stored = f"{name}.half"
        tensor.CopyFrom(onnx.numpy_helper.from_array(half, stored))
        widened.append(onnx.helper.make_node("Cast", [stored], [name], to=onnx.TensorProto.FLOAT))
        halves[stored] = half
    nodes = [*widened, *model.graph.node]
    model.graph.ClearField("node")
    model.graph.node.extend(nodes)
    return halves


def write_policy(folder: Path, network: nn.Module, card: PolicyCard, usual: Arrays) -> PolicyCard:
    """Write the three files of a policy, each whole or not at all; see `save_policy`.

    Args:
        folder: made where it does not exist.
        network: on the CPU, in evaluation mode.
        card: what it is; the hashes are filled in here.
        usual: further arrays for the weights' file.

    Returns:
        The card with the hashes.
    """
    model = graph_of(network, card.side_px)
    return write_carded(folder, model, {**halve_weights(model), **usual}, card)
