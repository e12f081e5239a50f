# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The card of a network of images: its kind, sensor and camera, and what it was trained on.

A card names the sensor and the camera, so that weights are never used on another.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.geometry.camera import Camera, PinholeCamera
from dotsim_ros.io.documents import value_text
from dotsim_ros.optics.network.carded_weights import CardKind, read_weights

FORMAT = 1
"""Raised whenever a network's input or output changes its meaning."""

SMALLEST_PX, LARGEST_PX = 16, 4096
BASES = {
    "ours": "warped",
    "paper": "idle",
    "paper_direct": "none",
    "paper_mobile": "idle",
    "paper_mobile_warped": "warped",
    "unet": "idle",
    "neighbourhood": "warped",
}
"""What each kind of network's output is added to."""
TRAINED = tuple(kind for kind in BASES if kind != "neighbourhood")
"""Kinds that training fits to many images; the last one is read from a few frames."""
FINENESS = dict.fromkeys(BASES, 1) | {"ours": 2}
"""How often wider and higher each kind's images are than the geometry that it is given."""


@dataclass(frozen=True)
class NetworkCard:
    """What weights are, where they come from, and how well they predict.

    Attributes:
        version: of the format.
        kind: of the network.
        sensor: name of the sensor.
        camera: `camera_hash` of its camera.
        width, height: of the network's images.
        weights_sha256: of the weights, by `weights_hash`.
        graph_sha256: of the graph's file.
        data: what it was trained on.
        commit, date, command: that it was trained by.
        metrics: figures by name.

    Raises:
        ValueError: the kind is unknown, or a length is out of range.
    """

    version: int
    kind: str
    sensor: str
    camera: str
    width: int
    height: int
    weights_sha256: str
    graph_sha256: str
    data: dict[str, Any] = field(default_factory=dict)
    commit: str = ""
    date: str = ""
    command: str = ""
    metrics: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.kind not in BASES:
            raise ValueError(f"kind is {value_text(self.kind)}, expected one of {', '.join(BASES)}")
        fineness = FINENESS[self.kind]
        for name, length in (("width", self.width), ("height", self.height)):
            if not SMALLEST_PX <= length <= LARGEST_PX or length % fineness:
                raise ValueError(
                    f"{name} is {length}, expected {SMALLEST_PX} to {LARGEST_PX} pixels, a "
                    f"multiple of {fineness}"
                )

    def text(self) -> str:
        """Return the card as JSON."""
        return json.dumps(asdict(self), indent=2)


NETWORK = CardKind(NetworkCard, FORMAT, "network", "dotsim_ros train-optics")


def camera_hash(camera: Camera) -> str:
    """Return a hash that differs between cameras whose images differ by more than resolution."""
    numbers = [
        camera.width / camera.height,
        camera.focal_px / camera.height,
        *((camera.principal_point_px + 0.5) / camera.height),
        *camera.distortion,
        *camera.pose.position_m,
        *camera.pose.rotation().ravel(),
        # Networks are older than other projections and pixels, and keep their hash.
        *((1.0,) if camera.projection == PinholeCamera.projection else ()),
        *((camera.pixel_aspect,) if camera.pixel_aspect != 1.0 else ()),
    ]
    text = " ".join(f"{number:.6f}" for number in np.asarray(numbers) + 0.0)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def read_network(directory: Path) -> NetworkCard:
    """Return the card of a network after a check that its files are whole; errors as
    `read_weights`."""
    return read_weights(directory, NETWORK)[0]


def check_card(card: NetworkCard, *, sensor: str, camera: Camera, source: Path) -> None:
    """Refuse a network that was trained for another sensor.

    Args:
        card: of the network.
        sensor: name of the sensor that is to use it.
        camera: of that sensor.
        source: the network's folder, for the message.

    Raises:
        ValueError: the network is for another sensor or another camera.
    """
    if card.sensor != sensor:
        raise ValueError(
            f"{source} was trained for the sensor {value_text(card.sensor)}, not for {sensor!r}; "
            "train one for this sensor with dotsim_ros train-optics, or leave camera.residual empty"
        )
    if card.camera != camera_hash(camera):
        raise ValueError(
            f"{source} was trained for another camera of {sensor!r} (hash "
            f"{value_text(card.camera)}, this camera's is {camera_hash(camera)}): its direction, "
            "lens or place has changed since; train the network again with dotsim_ros train-optics "
            "or leave camera.residual empty"
        )
