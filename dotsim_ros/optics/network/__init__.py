# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The network that completes the warped image: its card, its input, and how it is run. Entry:
`completion_network`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.files import given_path
from dotsim_ros.specification import SensorSpecification

if TYPE_CHECKING:
    from dotsim_ros.optics.network.completion import CompletionNetwork


def completion_network(
    specification: SensorSpecification, camera: Camera
) -> CompletionNetwork | None:
    """Return the network that completes the sensor's image; None where the sensor names none.

    Raises:
        FileNotFoundError: the folder holds no network.
        ValueError: the network is corrupt or for another sensor, camera or version.
    """
    if not specification.camera.residual:
        return None
    # Loaded on use: it takes the time and memory of ONNX Runtime.
    from dotsim_ros.optics.network.completion import CompletionNetwork

    return CompletionNetwork(
        given_path(specification.camera.residual), sensor=specification.name, camera=camera
    )
