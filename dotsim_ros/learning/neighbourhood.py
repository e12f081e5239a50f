# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Shading learnt from few photographs: a pixel's colour from the slopes around it.

On a gel without a pattern all that a press changes is light: that of the LEDs on the slope of the
point itself, and that which reaches it from around, by reflection between the parts of the gel, by
scattering in it, by shadows. So a small network of single pixels, as DiffTactile's and FOTS's, is
given more than the pixel's own normal and place: the change of normal and depth, blurred at scales
from a pixel's neighbours to a fifth of the image. Light from around need not be told apart into its
ways to be learnt, and twenty photographs have pixels enough for a few thousand weights.

A camera of such sensors may set its white balance and its exposure again in every photograph, by
more than what a press changes far away. That is no property of the gel: each photograph that is
fitted on has three gains of its own, which are fitted along and then forgotten; the image that is
predicted is that of their mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.learning.examples import ImageExamples, make_examples
from dotsim_ros.learning.fitting import FittedNetwork, network_size
from dotsim_ros.learning.networks import CHANGE_SCALE, OFFSET_SCALE, moved
from dotsim_ros.learning.training import Trained, psnr_db
from dotsim_ros.optics.network.input import FADE, GEOMETRY, PLACE
from dotsim_ros.twin.footage import OpticalPress, Rest

KIND = "neighbourhood"
CELLS_PX = (1, 4, 16, 32)
"""Cells over which the geometry is averaged before it is blurred, in pixels of the network's image:
together the scales of the surroundings that a pixel is told of."""
BLUR_CELLS = 1.6
BLUR_REACH = 4
GEOMETRY_COUNT = GEOMETRY.stop - GEOMETRY.start
FEATURE_COUNT = 2 + GEOMETRY_COUNT * (1 + len(CELLS_PX))


@dataclass(frozen=True)
class NeighbourhoodRecipe:
    """Size and training of the network.

    Attributes:
        widths: of the hidden layers.
        steps: of AdamW.
        batch: pixels a step.
        learning_rate: the highest; it rises and falls over one cycle.
        weight_decay: of the weights, not of the photographs' gains.
    """

    widths: tuple[int, ...] = (48, 48, 48)
    steps: int = 2000
    batch: int = 8192
    learning_rate: float = 4e-3
    weight_decay: float = 1e-4


class NeighbourhoodModel(nn.Module):
    """A perceptron on each pixel's place and surroundings: a gain and an offset of its colour.

    The interface is that of `networks`; what is added is exactly 0 at rest.

    Args:
        widths: of the hidden layers.
    """

    mean: Tensor
    scale: Tensor
    blur: Tensor

    def __init__(self, widths: Sequence[int] = NeighbourhoodRecipe.widths) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for inputs, outputs in pairwise((FEATURE_COUNT, *widths)):
            layers += [nn.Conv2d(inputs, outputs, 1), nn.SiLU()]
        head = nn.Conv2d(widths[-1], 6, 1)
        nn.init.zeros_(head.weight)
        nn.init.zeros_(head.bias)  # type: ignore[arg-type]
        self.layers = nn.Sequential(*layers, head)
        self.register_buffer("mean", torch.zeros(1, FEATURE_COUNT, 1, 1))
        self.register_buffer("scale", torch.ones(1, FEATURE_COUNT, 1, 1))
        place = torch.arange(-BLUR_REACH, BLUR_REACH + 1, dtype=torch.float32)
        weight = torch.exp(-0.5 * (place / BLUR_CELLS) ** 2)
        self.register_buffer("blur", (weight / weight.sum()).expand(GEOMETRY_COUNT, 1, 1, -1))

    def features(self, frame: Tensor, rest: Tensor) -> Tensor:
        """Return (N, `FEATURE_COUNT`, h, w) place and surroundings of each pixel."""
        rest = rest.expand(frame.shape[0], -1, -1, -1)
        change = CHANGE_SCALE * (frame[:, GEOMETRY] - rest[:, GEOMETRY])
        parts = [rest[:, PLACE], change]
        for cell in CELLS_PX:
            # Beyond the frame nothing is taken to have changed.
            small = functional.avg_pool2d(change, cell, ceil_mode=True) if cell > 1 else change
            across = functional.conv2d(
                small, self.blur, padding=(0, BLUR_REACH), groups=GEOMETRY_COUNT
            )
            both = functional.conv2d(
                across, self.blur.transpose(2, 3), padding=(BLUR_REACH, 0), groups=GEOMETRY_COUNT
            )
            if cell > 1:
                both = functional.interpolate(both, size=change.shape[2:], mode="bilinear")
            parts.append(both)
        return torch.cat(parts, dim=1)

    def shaded(self, features: Tensor, image: Tensor) -> Tensor:
        """Return what is to be added to an image (N, 3, h, w), before it is faded."""
        gain, offset = self.layers((features - self.mean) / self.scale).split(3, dim=1)
        return OFFSET_SCALE * (gain * image + offset)

    def forward(self, frame: Tensor, rest: Tensor, image: Tensor) -> Tensor:
        """Return what is to be added to the warped image; exactly 0 at rest."""
        rest = rest.expand(frame.shape[0], -1, -1, -1)
        acts = moved(frame, rest) * rest[:, FADE]
        return acts * self.shaded(self.features(frame, rest), image)


@dataclass(frozen=True)
class _Pixels:
    """All pixels of the examples, each array (frames, pixels, channels)."""

    features: Tensor
    image: Tensor
    measured: Tensor
    acts: Tensor


def _pixels(network: NeighbourhoodModel, examples: ImageExamples) -> _Pixels:
    with torch.no_grad():
        features = network.features(examples.frame, examples.rest)
        network.mean.copy_(features.mean((0, 2, 3), keepdim=True))
        network.scale.copy_(features.std((0, 2, 3), keepdim=True).clamp_min(1e-6))
        acts = moved(examples.frame, examples.rest) * examples.rest[:, FADE]
    parts = (features, examples.image, examples.measured, acts)
    return _Pixels(*(part.flatten(2).transpose(1, 2).contiguous() for part in parts))


def fit_neighbourhood(
    train: Sequence[OpticalPress],
    rest: Rest,
    camera: Camera,
    *,
    seed: int = 0,
    size: int | None = None,
    recipe: NeighbourhoodRecipe | None = None,
) -> FittedNetwork:
    """Return the network of least squared error of the colour, each photograph's gains aside.

    Args:
        train: presses, of few frames.
        rest: of the gel untouched.
        camera: of the measured images.
        seed: of the first weights and of the pixels drawn.
        size: width of the network's images in pixels; None as `fitting.network_size`.
        recipe: how it is trained; None for the default.

    Raises:
        ValueError: as `examples.make_examples`, or nothing has moved in any press.
        FloatingPointError: the training diverged.
    """
    recipe = recipe or NeighbourhoodRecipe()
    pixels_wide = network_size(KIND, camera, size, torch.device("cpu"))
    examples = make_examples(KIND, train, rest, camera, pixels_wide).only_touched()
    frames = len(examples.frame)
    if not frames:
        raise ValueError(f"the gel has moved in none of {len(train)} presses; press deeper")
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        network = NeighbourhoodModel(recipe.widths)
    pixels = _pixels(network, examples)
    gains = torch.zeros(frames, 1, 3, requires_grad=True)
    groups = [
        {"params": network.parameters(), "weight_decay": recipe.weight_decay},
        {"params": [gains], "weight_decay": 0.0},
    ]
    optimiser = torch.optim.AdamW(groups, lr=recipe.learning_rate)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, [recipe.learning_rate] * 2, recipe.steps
    )
    drawn = torch.Generator().manual_seed(seed)
    errors = []
    for _ in range(recipe.steps):
        of = torch.randint(frames, (recipe.batch,), generator=drawn)
        at = torch.randint(pixels.features.shape[1], (recipe.batch,), generator=drawn)
        features, image, measured, acts = (
            # As an image one pixel high, which convolutions take faster than one pixel each.
            part[of, at].T[None, :, None]
            for part in (pixels.features, pixels.image, pixels.measured, pixels.acts)
        )
        balance = torch.exp(gains - gains.mean(0))[of, 0].T[None, :, None]
        predicted = (image + acts * network.shaded(features, image)) * balance
        loss = torch.mean((predicted - measured) ** 2)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        errors.append(float(loss.item()))
    last = sum(errors[-100:]) / len(errors[-100:])
    if not last < float("inf"):
        raise FloatingPointError("the training diverged; look for frames that are not finite")
    trained = Trained(network.eval(), recipe.steps, 0.0, [psnr_db(last)])
    return FittedNetwork(KIND, trained, camera, pixels_wide)
