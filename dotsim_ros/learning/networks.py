# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Networks from what the camera sees of the gel to an image: one interface for all kinds.

Every network maps `frame` (N, 7, h, w), `rest` (N or 1, 10, h, w) and `image` (N, 3, f h, f w),
laid out as in `dotsim_ros.optics.network.input`, to what is to be added to its base: an image
(N, 3, f h, f w) in units of 255 grey levels, to be added to the warped image, to the idle frame,
or to nothing. The factor f is 2 for ours and 1 for the others.

- `paper`: DeepLabV3 with a ResNet-50 (Chen et al., "Rethinking Atrous Convolution for Semantic
  Image Segmentation", 2017) from normals and depth, added to the idle frame, as
  DOT-Sim publishes it, but from random weights: the backbone's pretrained ones are not used.
- `paper_direct`: the same network giving the image itself, its ablation.
- `paper_mobile`: the same input and base by DeepLabV3 with a MobileNetV3 (Howard et al., "Searching
  for MobileNetV3", 2019), a tenth of the work: what can be trained to its end without CUDA.
- `paper_mobile_warped`: the same network added to the warped image.
- `unet`: the same input and base by a U-Net (Ronneberger et al., 2015), which DOT-Sim's text names.
- `ours`: `LocalModel`, below, added to the warped image.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from dotsim_ros.optics.network.input import CARRIED, DEPTH, FADE, FRAME, GEOMETRY, PLACE


class DeepLab(nn.Module):
    """DeepLabV3 of torchvision with four channels in and three out.

    Args:
        is_mobile: with MobileNetV3-Large in place of ResNet50.
    """

    def __init__(self, *, is_mobile: bool = False) -> None:
        super().__init__()
        from torchvision.models import segmentation

        untrained: dict[str, Any] = {"weights": None, "weights_backbone": None, "num_classes": 3}
        if is_mobile:
            self.body = segmentation.deeplabv3_mobilenet_v3_large(**untrained)
            entry = nn.Conv2d(4, 16, 3, stride=2, padding=1, bias=False)
            self.body.backbone["0"][0] = entry
        else:
            self.body = segmentation.deeplabv3_resnet50(**untrained)
            entry = nn.Conv2d(4, 64, 7, stride=2, padding=3, bias=False)
            self.body.backbone["conv1"] = entry

    def forward(self, frame: Tensor, rest: Tensor, image: Tensor) -> Tensor:
        """Return what is to be added to the base; of the frame only the geometry plays a part."""
        return self.body(frame[:, GEOMETRY])["out"]


def _double_convolution(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
        nn.Conv2d(outputs, outputs, 3, padding=1, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


class UNet(nn.Module):
    """A U-Net of four levels on normals and depth, each with twice the channels of that above."""

    def __init__(self) -> None:
        super().__init__()
        widths = [32, 64, 128, 256]
        self.down = nn.ModuleList(
            _double_convolution(a, b) for a, b in zip([4, *widths], widths, strict=False)
        )
        self.up = nn.ModuleList(
            _double_convolution(a + b, a)
            for a, b in zip(widths[-2::-1], widths[:0:-1], strict=True)
        )
        self.out = nn.Conv2d(widths[0], 3, 1)

    def forward(self, frame: Tensor, rest: Tensor, image: Tensor) -> Tensor:
        """Return what is to be added to the base; of the frame only the geometry plays a part."""
        x = frame[:, GEOMETRY]
        levels: list[Tensor] = []
        for block in self.down:
            x = block(functional.max_pool2d(x, 2) if levels else x)
            levels.append(x)
        for block, level in zip(self.up, levels[-2::-1], strict=True):
            x = functional.interpolate(x, size=level.shape[2:], mode="bilinear")
            x = block(torch.cat([level, x], dim=1))
        return self.out(x)


class Block(nn.Module):
    """Two convolutions next to an identity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=1)
        nn.init.zeros_(self.second.weight)
        nn.init.zeros_(self.second.bias)  # type: ignore[arg-type]

    def forward(self, x: Tensor) -> Tensor:
        """Return features of the same shape."""
        return x + self.second(functional.relu(self.first(functional.relu(x))))


class LocalModel(nn.Module):
    """A local linear model of the image, whose coefficients a small network reads off the geometry.

    What shading does to a coat is to multiply its colours by a gain that varies slowly, what light
    scattered or reflected does is to add to them, and where the simulated motion is uncertain the
    best guess is a blurred pattern. So

        added = gain * c + offset + sharpening * laplacian(c)

    with c the warped image, and seven coefficients that a network gives at half the resolution of
    c from normals, depth, their change against rest, the place, and the warped image and its
    change. The pattern itself never needs to be learned, so few frames suffice. Everything is
    multiplied by a measure of whether anything has moved, exactly zero at rest, and by the fade of
    the lit disc. (A shift of the pattern as further coefficients fits the errors of pose of single
    presses, and does no good on others.)
    """

    def __init__(self) -> None:
        super().__init__()
        # Channels at half the geometry's resolution; at a quarter and an eighth.
        width, deep_width = 16, 48
        self.entry = nn.Conv2d(_GIVEN, width, 2, stride=2)
        self.fine = Block(width)
        self.down = nn.Conv2d(width, deep_width, 2, stride=2)
        self.middle = nn.Sequential(Block(deep_width), Block(deep_width))
        self.deeper = nn.Conv2d(deep_width, deep_width, 2, stride=2)
        self.deep = nn.Sequential(Block(deep_width), Block(deep_width))
        self.up_deep = nn.Conv2d(deep_width, deep_width, 1)
        self.up = nn.Conv2d(deep_width, width, 1)
        self.last = Block(width)
        self.head = nn.Conv2d(width, 4 * sum(_COEFFICIENTS), 1)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)  # type: ignore[arg-type]

    def coefficients(self, frame: Tensor, rest: Tensor) -> Tensor:
        """Return (N, 7, h, w) the local model's coefficients."""
        change = frame - rest[:, FRAME]
        given = torch.cat(
            [
                2.0 * frame[:, GEOMETRY] - 1.0,
                CHANGE_SCALE * change[:, GEOMETRY],
                rest[:, PLACE],
                rest[:, FADE],
                frame[:, CARRIED],
                change[:, CARRIED],
            ],
            dim=1,
        )
        x = self.fine(self.entry(given))
        middle = self.middle(self.down(x))
        deep = self.deep(self.deeper(middle))
        middle = middle + _enlarged(self.up_deep(deep), middle)
        x = x + _enlarged(self.up(middle), x)
        return functional.pixel_shuffle(self.head(functional.relu(self.last(x))), 2)

    def forward(self, frame: Tensor, rest: Tensor, image: Tensor) -> Tensor:
        """Return what is to be added to the warped image; exactly 0 at rest."""
        rest = rest.expand(frame.shape[0], -1, -1, -1)
        acts = moved(frame, rest) * rest[:, FADE]
        coefficients = _enlarged(self.coefficients(frame, rest) * acts, image)
        gain, offset, sharpening = coefficients.split(_COEFFICIENTS, dim=1)
        padded = functional.pad(image, (1, 1, 1, 1), mode="replicate")
        left, right = padded[:, :, 1:-1, :-2], padded[:, :, 1:-1, 2:]
        above, below = padded[:, :, :-2, 1:-1], padded[:, :, 2:, 1:-1]
        return (
            gain * image
            + OFFSET_SCALE * offset
            + sharpening * (left + right + above + below - 4.0 * image)
        )


_COEFFICIENTS = (3, 3, 1)
"""Channels of gain, offset, sharpening."""
_GIVEN = 4 + 4 + 2 + 1 + 3 + 3
"""Channels that the coefficients are read off."""
CHANGE_SCALE = 4.0
OFFSET_SCALE = 0.3
"""Bring coefficients and inputs to one order of magnitude, as equal weight decay requires."""
MOVED_SHARE = 2e-6
"""Mean square change of the depth, over the largest depth, at which half of what is learned
acts: 0.1 mm of tip depth on a dome."""


def _enlarged(small: Tensor, like: Tensor) -> Tensor:
    return functional.interpolate(small, size=like.shape[2:], mode="bilinear")


def moved(frame: Tensor, rest: Tensor) -> Tensor:
    """Return (N, 1, 1, 1) from 0 where nothing has moved, exactly, to 1 in a press."""
    change = frame[:, DEPTH] - rest[:, DEPTH]
    square = torch.mean(change * change, dim=(1, 2, 3), keepdim=True)
    return square / (square + MOVED_SHARE)


KINDS: dict[str, Callable[[], nn.Module]] = {
    "ours": LocalModel,
    "paper": DeepLab,
    "paper_direct": DeepLab,
    "paper_mobile": partial(DeepLab, is_mobile=True),
    "paper_mobile_warped": partial(DeepLab, is_mobile=True),
    "unet": UNet,
}


def make_network(kind: str) -> nn.Module:
    """Return an untrained network.

    Raises:
        ValueError: no such kind.
    """
    if kind not in KINDS:
        raise ValueError(f"network {kind!r} is none of {', '.join(sorted(KINDS))}")
    return KINDS[kind]()
