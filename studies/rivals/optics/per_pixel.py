# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""DiffTactile's and FOTS's image: a small network maps normal and position of a pixel to a colour.

Si, Zhang, Ben, Romero, Xian, Liu, Gan: "DIFFTACTILE: A Physics-based Differentiable Tactile
Simulator for Contact-rich Robotic Manipulation", ICLR 2024 (arXiv 2403.08716), and Zhao, Qian,
Duan, Luo: "FOTS: A Fast Optical Tactile Simulator for Sim2Real Learning of Tactile-motor Robot
Manipulation Skills", RA-L 2024 (arXiv 2404.19217): a perceptron of a few layers takes the surface's
normal and the position of one pixel and gives its colour; pixels are independent of each other.

Both learn the colour itself on a sensor without a pattern. On one with a pattern that would charge
them for a texture that five numbers cannot represent, so here the network gives the change of the
colour, which is added to the idle image. FOTS's shadow, which it projects from the object's mesh,
is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.arrays import Float32Array, ImageArray
from dotsim_ros.twin.footage import OpticalPress, Rest
from studies.rivals.optics.pixels import (
    TOWARDS_CAMERA,
    Ground,
    draw_pixels,
    idle_ground,
    pixel_grid,
)

SAMPLES = 3_000_000


@dataclass(frozen=True)
class PerPixelSettings:
    """Size and training of the network.

    Attributes:
        name: how tables call it.
        widths: of the hidden layers.
        steps: of Adam.
        batch: pixels a step.
        learning_rate: at the start; it falls to nothing along a half cosine.
    """

    name: str
    widths: tuple[int, ...]
    steps: int = 4000
    batch: int = 8192
    learning_rate: float = 3.0e-3


DIFFTACTILE = PerPixelSettings("difftactile", (64, 64, 64))
FOTS = PerPixelSettings("fots", (32, 32, 32))


@dataclass(frozen=True)
class PerPixelImage:
    """The fitted network.

    Attributes:
        layers: (weight (inputs, outputs), bias (outputs,)) of each layer; the last has three
            outputs, the change of the colour, full scale 1.
        name: how tables call it.
        ground: what the change is added to.
    """

    layers: tuple[tuple[Float32Array, Float32Array], ...]
    name: str
    ground: Ground = idle_ground

    def predict(self, press: OpticalPress, rest: Rest) -> ImageArray:
        """Return images (F, H, W, 3); see `studies.optics.judge.ImageModel`."""
        grid = pixel_grid(rest)
        images = []
        for normal, below in zip(press.normal, self.ground(press, rest), strict=True):
            values = network_input(grid.position, *grid.normals(normal))
            for weight, bias in self.layers[:-1]:
                values = np.maximum(values @ weight + bias, 0.0)
            weight, bias = self.layers[-1]
            images.append(grid.changed(below, values @ weight + bias))
        return np.stack(images)


def network_input(
    position: Float32Array, normal: Float32Array, relative: Float32Array
) -> Float32Array:
    """Return (N, 8) what the network gets: position, normal, and normal relative to rest.

    The last follows from the others; giving it spares the network to learn the shape at rest.
    """
    return np.concatenate([position, normal, relative - TOWARDS_CAMERA], axis=1)


def fit(
    train: Sequence[OpticalPress],
    rest: Rest,
    camera: Camera,
    *,
    seed: int = 0,
    settings: PerPixelSettings = DIFFTACTILE,
    ground: Ground = idle_ground,
) -> PerPixelImage:
    """Return the network of least squared error of the colour over the seen pixels.

    Args:
        train: frames to fit on.
        rest: of the gel untouched.
        camera: plays no part.
        seed: of the pixels drawn, of the network's first weights and of the order.
        settings: size and training.
        ground: what the change is added to.

    Raises:
        ValueError: no frame.
    """
    # Loaded on use: predicting needs no torch.
    import torch

    samples = draw_pixels(train, rest, count=SAMPLES, seed=seed, ground=ground)
    inputs = torch.from_numpy(network_input(samples.position, samples.normal, samples.relative))
    target = torch.from_numpy(samples.change)
    generator = torch.Generator().manual_seed(seed)
    widths = (inputs.shape[1], *settings.widths, 3)
    weights, biases = [], []
    for fan_in, fan_out in pairwise(widths):
        # He et al., "Delving deep into rectifiers", 2015.
        weight = torch.randn((fan_in, fan_out), generator=generator) * (2.0 / fan_in) ** 0.5
        weights.append(weight.requires_grad_())
        biases.append(torch.zeros(fan_out, requires_grad=True))
    # At first the image is the idle one; most pixels never leave it.
    torch.nn.init.zeros_(weights[-1])
    optimizer = torch.optim.Adam([*weights, *biases], lr=settings.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, settings.steps)
    for _ in range(settings.steps):
        drawn = torch.randint(len(inputs), (settings.batch,), generator=generator)
        values = inputs[drawn]
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            values = torch.relu(values @ weight + bias)
        loss = torch.mean((values @ weights[-1] + biases[-1] - target[drawn]) ** 2)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    layers = tuple(
        (weight.detach().numpy(), bias.detach().numpy())
        for weight, bias in zip(weights, biases, strict=True)
    )
    return PerPixelImage(layers, settings.name, ground)
