# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The policy's network for torch: ResNet-18 with one row of six outputs for each path.

ResNet-18 is that of He et al., "Deep residual learning for image recognition", CVPR 2016, as
torchvision builds it; its first layer takes the channels of `policy_images.NetworkInput`.
"""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval
from torchvision.models.resnet import BasicBlock, ResNet, resnet18

from dotsim_ros.control.policy.card import COMMAND_SIZE
from dotsim_ros.control.policy.images import CHANNEL_COUNT

LINEAR_UNIT_M_S = 0.005
ANGULAR_UNIT_RAD_S = 0.1
"""What an output of 1 of the last layer means."""
PLACE_SIZE = 3


class PolicyResNet(nn.Module):
    """Maps crops (N, CHANNEL_COUNT, side, side) to commands (N, path_count, 6), m/s and rad/s.

    Args:
        path_count: how many paths.

    Attributes:
        trunk: gives 512 features.
        commands: the last layer.
        place: a second last layer, for training alone: where the contact is.
    """

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
