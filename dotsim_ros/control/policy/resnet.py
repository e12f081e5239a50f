# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The policy's network for torch: ResNet-18 with one row of six outputs for each path; its export.

ResNet-18 is that of He et al., "Deep residual learning for image recognition", CVPR 2016, as
torchvision builds it; its first layer takes the channels of `images.PolicyInput`.

The exported graph widens each weight from half to single precision, which ONNX Runtime does once,
when it opens the graph: it is as fast as single precision and half as large.
"""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval
from torchvision.models.resnet import BasicBlock, ResNet, resnet18

from dotsim_ros.control.policy.images import CHANNEL_COUNT
from dotsim_ros.control.policy.network import (
    COMMAND_SIZE,
    INPUT,
    USUAL_MEAN,
    USUAL_ROOT,
    PolicyCard,
)
from dotsim_ros.io.arrays import Float32Array
from dotsim_ros.learning.export import exported, write_carded

OUTPUT = "commands"
LEAST_SIZE = 64
"""Arrays with fewer numbers stay in the graph, in single precision."""
LINEAR_UNIT_M_S = 0.005
ANGULAR_UNIT_RAD_S = 0.1
"""What an output of 1 of the last layer means."""
PLACE_SIZE = 3


class PolicyResNet(nn.Module):
    """Maps crops (N, CHANNEL_COUNT, side, side) to commands (N, path_count, 6), m/s and rad/s; for
    training alone a second last layer gives the place of the contact."""

    unit: Tensor

    def __init__(self, path_count: int) -> None:
        super().__init__()
        self.path_count = path_count
        trunk: ResNet = resnet18(weights=None)
        feature_count = trunk.fc.in_features
        trunk.conv1 = nn.Conv2d(CHANNEL_COUNT, 64, 7, stride=2, padding=3, bias=False)
        nn.init.kaiming_normal_(trunk.conv1.weight, mode="fan_out", nonlinearity="relu")
        trunk.fc = nn.Identity()
        self.trunk = trunk
        self.commands = nn.Linear(feature_count, path_count * COMMAND_SIZE)
        self.place = nn.Linear(feature_count, PLACE_SIZE)
        unit = [LINEAR_UNIT_M_S] * 3 + [ANGULAR_UNIT_RAD_S] * 3
        self.register_buffer("unit", torch.tensor(unit))

    def with_place(self, crop: Tensor) -> tuple[Tensor, Tensor]:
        """Return commands (N, path_count, 6) in units of `unit`, and the place (N, PLACE_SIZE)."""
        features = self.trunk(crop)
        commands = self.commands(features).reshape(-1, self.path_count, COMMAND_SIZE)
        return commands, self.place(features)

    def forward(self, crop: Tensor) -> Tensor:
        """Return the commands."""
        return self.with_place(crop)[0] * self.unit


def without_normalisation(network: PolicyResNet) -> PolicyResNet:
    """Return a copy in evaluation mode whose convolutions contain the batch normalisation."""
    network = copy.deepcopy(network).eval()
    _fuse(network.trunk, 1)
    for block in network.trunk.modules():
        if isinstance(block, BasicBlock):
            _fuse(block, 1)
            _fuse(block, 2)
            if block.downsample is not None:
                block.downsample[0] = fuse_conv_bn_eval(*block.downsample)
                block.downsample[1] = nn.Identity()
    return network


def _fuse(module: nn.Module, number: int) -> None:
    convolution, normalisation = f"conv{number}", f"bn{number}"
    fused = fuse_conv_bn_eval(getattr(module, convolution), getattr(module, normalisation))
    setattr(module, convolution, fused)
    setattr(module, normalisation, nn.Identity())


def graph_of(network: nn.Module, side_px: int) -> onnx.ModelProto:
    """Return a network in evaluation mode as an ONNX model for one crop."""
    crop = torch.zeros(1, CHANNEL_COUNT, side_px, side_px)
    return exported(network, (crop,), [INPUT], OUTPUT)


def halve_weights(model: onnx.ModelProto) -> dict[str, NDArray[Any]]:
    """Let a model widen its larger weights from half precision; return these, by name.

    Raises:
        ValueError: a weight is too large for half precision, or not finite.
    """
    halves: dict[str, NDArray[Any]] = {}
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
        network: on the CPU, in evaluation mode; maps (1, CHANNEL_COUNT, side, side) to
            (1, paths, 6), m/s and rad/s.
        card: what it is; the hashes are filled in here.
        usual_mean, usual_root: (F,) and (F, F); see `USUAL_MEAN`.

    Returns:
        The card with the hashes.
    """
    model = graph_of(network, card.side_px)
    usual = {USUAL_MEAN: usual_mean, USUAL_ROOT: usual_root}
    return write_carded(folder, model, {**halve_weights(model), **usual}, card)
