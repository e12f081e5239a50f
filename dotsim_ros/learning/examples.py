# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Measured frames as tensors: what a network is given, and what it should give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.optics.network.card import FINENESS
from dotsim_ros.optics.network.input import (
    DEPTH,
    CompletionInput,
    resized,
)
from dotsim_ros.twin.footage import OpticalPress, Rest

LEAST_FRAMES = 10
"""Frames below which nothing is learned."""


@dataclass(frozen=True)
class ImageExamples:
    """Frames of one sensor at one size.

    Attributes:
        frame: (F, 7, h, w) as `CompletionInput.frame`.
        rest: (1, 10, h, w) as `CompletionInput.rest`.
        image: (F, 3, f h, f w) as `CompletionInput.image`.
        measured: (F, 3, f h, f w) measured images over 255.
    """

    frame: Tensor
    rest: Tensor
    image: Tensor
    measured: Tensor

    def to(self, device: torch.device) -> ImageExamples:
        """Return the examples on a device."""
        return ImageExamples(
            self.frame.to(device),
            self.rest.to(device),
            self.image.to(device),
            self.measured.to(device),
        )

    @property
    def touched(self) -> Tensor:
        """(F,) whether anything has moved."""
        return (self.frame[:, DEPTH] != self.rest[:, DEPTH]).flatten(1).any(dim=1)

    def only_touched(self) -> ImageExamples:
        """Return the frames in which something has moved."""
        touched = self.touched
        return ImageExamples(
            self.frame[touched], self.rest, self.image[touched], self.measured[touched]
        )


def check_presses(presses: Sequence[OpticalPress], rest: Rest, camera: Camera) -> None:
    """Refuse presses that no network can be trained on.

    Raises:
        ValueError: fewer than ten frames in all, or images of another size than the camera's.
    """
    shape = (camera.height, camera.width)
    if rest.idle.shape != (*shape, 3):
        raise ValueError(
            f"the idle frame is {rest.idle.shape[1]}x{rest.idle.shape[0]}, expected "
            f"{camera.width}x{camera.height} as the camera"
        )
    for press in presses:
        if press.measured.shape[1:] != (*shape, 3) or press.measured.dtype != np.uint8:
            raise ValueError(
                f"{press.name}: measured images have shape {press.measured.shape} and type "
                f"{press.measured.dtype}, expected (F, {shape[0]}, {shape[1]}, 3) uint8"
            )
    count = sum(len(press.measured) for press in presses)
    if count < LEAST_FRAMES:
        raise ValueError(
            f"{count} frames in {len(presses)} presses, expected {LEAST_FRAMES} at least; record "
            "more presses with images"
        )


def network_input(kind: str, rest: Rest, camera: Camera, size: tuple[int, int]) -> CompletionInput:
    """Return what brings a sensor's frames to the size and the units of a network.

    Args:
        kind: of the network.
        rest: of the gel untouched.
        camera: of the same size.
        size: width and height of the network's images.
    """
    fineness = FINENESS[kind]
    return CompletionInput(
        camera,
        (size[0] // fineness, size[1] // fineness),
        fineness=fineness,
        depth_m=rest.depth_m,
        normal=rest.normal,
        idle=rest.idle,
    )


def inputs_of(press: OpticalPress, given: CompletionInput) -> tuple[Tensor, Tensor]:
    """Return the network's input for a press: frame (F, 7, h, w) and image (F, 3, f h, f w)."""
    frames = [
        given.frame(*seen) for seen in zip(press.depth_m, press.normal, press.warped, strict=True)
    ]
    images = [given.image(warped) for warped in press.warped]
    return torch.from_numpy(np.stack(frames)), torch.from_numpy(np.stack(images))


def make_examples(
    kind: str,
    presses: Sequence[OpticalPress],
    rest: Rest,
    camera: Camera,
    size: tuple[int, int],
) -> ImageExamples:
    """Return presses as examples.

    Args:
        kind: of the network.
        presses: what was measured.
        rest: of the gel untouched.
        camera: of the presses' size.
        size: width and height of the network's images.

    Raises:
        ValueError: as `check_presses`, or the size has another aspect ratio than the camera's.
    """
    check_presses(presses, rest, camera)
    given = network_input(kind, rest, camera, size)
    measured = [
        resized(image, size).transpose(2, 0, 1) for press in presses for image in press.measured
    ]
    inputs = [inputs_of(press, given) for press in presses]
    return ImageExamples(
        torch.cat([frame for frame, _ in inputs]),
        torch.from_numpy(given.rest)[None],
        torch.cat([image for _, image in inputs]),
        torch.from_numpy(np.stack(measured).astype(np.float32) / 255.0),
    )
