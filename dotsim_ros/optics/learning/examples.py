"""Measured frames as tensors: what a network is given, and what it should give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dotsim_ros.geometry.camera import FisheyeCamera
from dotsim_ros.optics.frames import OpticalPress, Rest
from dotsim_ros.optics.network_input import (
    DEPTH,
    NetworkInput,
    resized,
)

LEAST_FRAMES = 10
"""Frames below which nothing is learned."""


@dataclass(frozen=True)
class Examples:
    """Frames of one sensor at one size.

    Attributes:
        frame: (F, 7, h, w) as `NetworkInput.frame`.
        rest: (1, 10, h, w) as `NetworkInput.rest`.
        measured: (F, 3, h, w) measured images over 255.
    """

    frame: Tensor
    rest: Tensor
    measured: Tensor

    def to(self, device: torch.device) -> Examples:
        """Return the examples on a device."""
        return Examples(self.frame.to(device), self.rest.to(device), self.measured.to(device))

    @property
    def touched(self) -> Tensor:
        """(F,) whether anything has moved."""
        return (self.frame[:, DEPTH] != self.rest[:, DEPTH]).flatten(1).any(dim=1)

    def only_touched(self) -> Examples:
        """Return the frames in which something has moved."""
        return Examples(self.frame[self.touched], self.rest, self.measured[self.touched])


def check_presses(presses: Sequence[OpticalPress], rest: Rest, camera: FisheyeCamera) -> None:
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


def network_input(rest: Rest, camera: FisheyeCamera, size: tuple[int, int]) -> NetworkInput:
    """Return what brings a sensor's frames to a network's size and units."""
    return NetworkInput(camera, size, depth_m=rest.depth_m, normal=rest.normal, idle=rest.idle)


def frames_of(press: OpticalPress, given: NetworkInput) -> Tensor:
    """Return the network's input (F, 7, h, w) for a press."""
    frames = [
        given.frame(*seen) for seen in zip(press.depth_m, press.normal, press.carried, strict=True)
    ]
    return torch.from_numpy(np.stack(frames))


def make_examples(
    presses: Sequence[OpticalPress], rest: Rest, camera: FisheyeCamera, size: tuple[int, int]
) -> Examples:
    """Return presses as examples.

    Args:
        presses: what was measured.
        rest: of the gel untouched.
        camera: of the presses' size.
        size: width and height of the network's images.

    Raises:
        ValueError: as `check_presses`, or the size has another aspect ratio than the camera's.
    """
    check_presses(presses, rest, camera)
    given = network_input(rest, camera, size)
    measured = [
        resized(image, size).transpose(2, 0, 1) for press in presses for image in press.measured
    ]
    return Examples(
        torch.cat([frames_of(press, given) for press in presses]),
        torch.from_numpy(given.rest)[None],
        torch.from_numpy(np.stack(measured).astype(np.float32) / 255.0),
    )
