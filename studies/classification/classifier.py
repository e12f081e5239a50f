# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A small network that tells indenters from what a touch adds to the idle image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import torch
from torch import nn

from dotsim_ros.io.arrays import Float32Array, ImageArray, IntArray

GREY_LEVELS = 24.0
"""Of a difference that counts as one: about what a press changes."""
CHANNELS = (24, 48, 64, 96)
BATCH = 32
WINDOW_SHARE = 0.5
"""Side of the window around a touch, of the image's shorter side."""
BLUR_SHARE = 0.04
"""Deviation of the blur before the touch is looked for, of the image's shorter side."""


@dataclass(frozen=True)
class ClassifierSettings:
    """How a classifier is trained; the same for every row.

    Attributes:
        side_px: of the window that it sees.
        epochs: over the images to learn from.
        learning_rate: the largest of a cycle.
        noise_levels: deviation of the noise added to each pixel of simulated images, grey levels:
            that of the camera.
        gain: largest relative change of a whole image's difference, drawn for each image.
        stretch: largest relative change of its size, drawn for each image.
        turn_rad: largest turn of it, drawn for each image.
    """

    side_px: int = 32
    epochs: int = 60
    learning_rate: float = 3e-3
    noise_levels: float = 1.2
    gain: float = 0.15
    stretch: float = 0.1
    turn_rad: float = np.pi


def touched(
    images: ImageArray, idle: ImageArray, settings: ClassifierSettings, random: np.random.Generator
) -> Float32Array:
    """Return what a touch adds to the idle image, in a window around it, (F, 4, side, side).

    The fourth channel is the size of the change, whatever its colour.

    Args:
        images: (F, H, W, 3), simulated.
        idle: (H, W, 3), as it was taken.
        settings: size, and the noise added.
        random: draws the noise.
    """
    noise = random.normal(0.0, settings.noise_levels, images.shape).astype(np.float32)
    return _differences(images + noise, idle, settings)


def touched_as_taken(
    images: ImageArray, idle: ImageArray, settings: ClassifierSettings
) -> Float32Array:
    """Return the same of measured images, which have their noise."""
    return _differences(images.astype(np.float32), idle, settings)


def _differences(
    images: Float32Array, idle: ImageArray, settings: ClassifierSettings
) -> Float32Array:
    windows = [_window(image - idle.astype(np.float32), settings.side_px) for image in images]
    seen = np.stack(windows) / GREY_LEVELS
    size = np.sqrt(np.square(seen).mean(axis=-1, keepdims=True))
    return np.ascontiguousarray(np.concatenate([seen, size], axis=-1).transpose(0, 3, 1, 2))


def _window(change: Float32Array, side_px: int) -> Float32Array:
    """Return a change (H, W, 3) around where it is largest, (side, side, 3).

    What it has everywhere is taken away first: light drifts, and a window must not tell by it.
    """
    change = change - np.median(change, axis=(0, 1)).astype(np.float32)
    shorter = min(change.shape[:2])
    # What the pattern does by moving averages out; what the light does stays.
    smooth = cv2.GaussianBlur(change, (0, 0), BLUR_SHARE * shorter)
    size = np.square(smooth).sum(axis=-1)
    peak = np.unravel_index(size.argmax(), size.shape)
    _, parts, _, centres = cv2.connectedComponentsWithStats(
        (size >= 0.5 * size[peak]).astype(np.uint8)
    )
    centre = centres[parts[peak]]
    scale = side_px / (WINDOW_SHARE * shorter)
    small = cv2.resize(change, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    moved = 0.5 * (side_px - 1) - ((centre + 0.5) * scale - 0.5)
    shift = np.array([[1.0, 0.0, moved[0]], [0.0, 1.0, moved[1]]])
    return np.asarray(cv2.warpAffine(small, shift, (side_px, side_px)), dtype=np.float32)


class TouchClassifier(nn.Module):
    """Four convolutions with stride, a mean over the image, and one linear layer."""

    def __init__(self, channels: int, classes: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for before, after in pairwise((channels, *CHANNELS)):
            layers += [
                nn.Conv2d(before, after, 3, stride=2, padding=1, bias=False),
                nn.BatchNorm2d(after),
                nn.ReLU(),
            ]
        self.features = nn.Sequential(*layers)
        self.drop = nn.Dropout(0.2)
        self.head = nn.Linear(2 * CHANNELS[-1], classes)

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        """Return the classes' logits (F, classes) of (F, channels, h, w)."""
        found = self.features(seen).flatten(2)
        pooled = torch.cat([found.mean(dim=2), found.amax(dim=2)], dim=1)
        logits: torch.Tensor = self.head(self.drop(pooled))
        return logits


def train_classifier(
    seen: Float32Array,
    labels: IntArray,
    classes: int,
    settings: ClassifierSettings,
    seed: int,
) -> TouchClassifier:
    """Return a classifier of images.

    Args:
        seen: (F, channels, h, w), what touches add.
        labels: (F,) from 0.
        classes: how many there are.
        settings: of the training.
        seed: of the weights, the order and the changes to the images.
    """
    torch.manual_seed(seed)
    network = TouchClassifier(seen.shape[1], classes)
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=1e-2)
    batches = -(-len(seen) // BATCH)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, settings.learning_rate, total_steps=settings.epochs * batches
    )
    # A class with more images than others is not worth more.
    counts = np.bincount(labels, minlength=classes)
    weights = torch.as_tensor(len(labels) / (classes * np.maximum(counts, 1)), dtype=torch.float32)
    loss_of = nn.CrossEntropyLoss(weight=weights, label_smoothing=0.05)
    images, targets = torch.from_numpy(seen), torch.from_numpy(labels)
    network.train()
    for _ in range(settings.epochs):
        for chosen in torch.randperm(len(images)).split(BATCH):
            optimizer.zero_grad()
            logits = network(_changed(images[chosen], settings))
            loss_of(logits, targets[chosen]).backward()
            optimizer.step()
            schedule.step()
    return network.eval()


def _changed(images: torch.Tensor, settings: ClassifierSettings) -> torch.Tensor:
    """Return images a little brighter or dimmer, larger or smaller, and turned.

    How a touch lies and from where its light comes tell nothing of its shape.
    """
    count = len(images)
    gains, sizes = (
        1.0 + reach * (2.0 * torch.rand(count) - 1.0) for reach in (settings.gain, settings.stretch)
    )
    turns = settings.turn_rad * (2.0 * torch.rand(count) - 1.0)
    cos, sin = sizes * torch.cos(turns), sizes * torch.sin(turns)
    none = torch.zeros(count)
    rows = torch.stack([cos, -sin, none, sin, cos, none], dim=1).reshape(count, 2, 3)
    places = nn.functional.affine_grid(rows, list(images.shape), align_corners=False)
    turned = nn.functional.grid_sample(images, places, align_corners=False)
    return gains[:, None, None, None] * turned


def classified(network: TouchClassifier, seen: Float32Array) -> IntArray:
    """Return the class (F,) of each image (F, channels, h, w)."""
    with torch.no_grad():
        logits = [network(part) for part in torch.from_numpy(seen).split(BATCH)]
    return np.asarray(torch.cat(logits).argmax(dim=1).numpy())


def confusion(truth: Sequence[int], told: Sequence[int], classes: int) -> list[list[int]]:
    """Return how often each class (rows) was taken for each (columns)."""
    counts = np.zeros((classes, classes), dtype=int)
    np.add.at(counts, (np.asarray(truth), np.asarray(told)), 1)
    return [[int(count) for count in row] for row in counts]
