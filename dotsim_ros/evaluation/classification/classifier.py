"""A small network that tells indenters from what a touch adds to the idle image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import torch
from torch import nn

from dotsim_ros.arrays import Float32Array, ImageArray, IntArray

GREY_LEVELS = 24.0
"""Of a difference that counts as one: about what a press changes."""
CHANNELS = (3, 24, 48, 64, 96)
BATCH = 32


@dataclass(frozen=True)
class ClassifierSettings:
    """How a classifier is trained; the same for every row.

    Attributes:
        width_px, height_px: of what it sees.
        epochs: over the images to learn from.
        learning_rate: the largest of a cycle.
        noise_levels: deviation of the noise added to each pixel of simulated images, grey levels:
            that of the camera.
        gain: largest relative change of a whole image's difference, drawn for each image.
        shift_px: largest shift of an image, pixels of what it sees.
    """

    width_px: int = 64
    height_px: int = 48
    epochs: int = 25
    learning_rate: float = 3e-3
    noise_levels: float = 1.2
    gain: float = 0.15
    shift_px: int = 1


def touched(
    images: ImageArray, idle: ImageArray, settings: ClassifierSettings, random: np.random.Generator
) -> Float32Array:
    """Return what a touch adds to the idle image, small, (F, 3, h, w).

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
    size = (settings.width_px, settings.height_px)
    small = [
        cv2.resize(image - idle.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        for image in images
    ]
    return np.ascontiguousarray(np.stack(small).transpose(0, 3, 1, 2) / GREY_LEVELS)


class TouchClassifier(nn.Module):
    """Four convolutions with stride, a mean over the image, and one linear layer."""

    def __init__(self, classes: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for before, after in pairwise(CHANNELS):
            layers += [
                nn.Conv2d(before, after, 3, stride=2, padding=1, bias=False),
                nn.BatchNorm2d(after),
                nn.ReLU(),
            ]
        self.features = nn.Sequential(*layers)
        self.drop = nn.Dropout(0.2)
        self.head = nn.Linear(2 * CHANNELS[-1], classes)

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        """Return the classes' logits (F, classes) of (F, 3, h, w)."""
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
        seen: (F, 3, h, w), what touches add.
        labels: (F,) from 0.
        classes: how many there are.
        settings: of the training.
        seed: of the weights, the order and the changes to the images.
    """
    torch.manual_seed(seed)
    network = TouchClassifier(classes)
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
    """Return images a little brighter or dimmer, and shifted."""
    gains = 1.0 + settings.gain * (2.0 * torch.rand(len(images), 1, 1, 1) - 1.0)
    reach = settings.shift_px
    shift = torch.randint(-reach, reach + 1, (2,)).tolist()
    return gains * torch.roll(images, shift, dims=(2, 3))


def classified(network: TouchClassifier, seen: Float32Array) -> IntArray:
    """Return the class (F,) of each image (F, 3, h, w)."""
    with torch.no_grad():
        logits = [network(part) for part in torch.from_numpy(seen).split(BATCH)]
    return np.asarray(torch.cat(logits).argmax(dim=1).numpy())


def confusion(truth: Sequence[int], told: Sequence[int], classes: int) -> list[list[int]]:
    """Return how often each class (rows) was taken for each (columns)."""
    counts = np.zeros((classes, classes), dtype=int)
    np.add.at(counts, (np.asarray(truth), np.asarray(told)), 1)
    return [[int(count) for count in row] for row in counts]
