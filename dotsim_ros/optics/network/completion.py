# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A trained network as the image's completion, run by ONNX Runtime: no torch at run time.

On a core of an EPYC without VNNI OpenVINO took longer, and 8 bits in place of floats saved a sixth.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.arrays import Float32Array, ImageArray
from dotsim_ros.optics import bands
from dotsim_ros.optics.network.card import BASES, FINENESS, NETWORK, check_card, read_network
from dotsim_ros.optics.network.carded_weights import GRAPH
from dotsim_ros.optics.network.input import FADE, FRAME, CompletionInput, resized
from dotsim_ros.optics.network.session import Network
from dotsim_ros.optics.renderer import View


class CompletionNetwork:
    """A network of one sensor, read from its folder.

    Args:
        directory: that `dotsim_ros train-optics` wrote.
        sensor: name of the sensor that uses it.
        camera: of that sensor, at any resolution of the view that was trained on.
        thread_count: of the network; None for as many as `bands.thread_count`. One and two give the
            same to the last bit.

    Attributes:
        card: what the network is.

    Raises:
        FileNotFoundError: no network there.
        ValueError: a file is corrupt, of another version, or for another sensor or camera; the
            graph cannot be run, or takes or gives something else.
    """

    def __init__(
        self,
        directory: Path,
        *,
        sensor: str,
        camera: Camera,
        thread_count: int | None = None,
    ) -> None:
        self.card = read_network(directory)
        check_card(self.card, sensor=sensor, camera=camera, source=directory)
        self._camera = camera
        width, height = self.card.width, self.card.height
        fineness = FINENESS[self.card.kind]
        geometry = (height // fineness, width // fineness)
        self._network = Network(
            directory / GRAPH,
            inputs={
                "frame": (1, FRAME.stop, *geometry),
                "rest": (1, FADE.stop, *geometry),
                "image": (1, 3, height, width),
            },
            output=(1, 3, height, width),
            thread_count=bands.thread_count() if thread_count is None else thread_count,
            noun=NETWORK.noun,
        )

    def at_rest(self, view: View, idle: ImageArray) -> LearnedCompletion:
        """Return the completion for one idle frame.

        Args:
            view: of the gel untouched.
            idle: (H, W, 3) the idle frame, of the camera's size.

        Raises:
            ValueError: view or idle frame are not of the camera's size.
        """
        fineness = FINENESS[self.card.kind]
        given = CompletionInput(
            self._camera,
            (self.card.width // fineness, self.card.height // fineness),
            fineness=fineness,
            depth_m=view.depth_m,
            normal=view.normal,
            idle=idle,
        )
        return LearnedCompletion(self, given, idle)

    def added(self, frame: Float32Array, rest: Float32Array, image: Float32Array) -> Float32Array:
        """Return what the network adds (3, f h, f w), over 255; see `network_input`."""
        arrays = {"frame": frame[None], "rest": rest[None], "image": image[None]}
        return np.asarray(self._network(arrays)[0])


class LearnedCompletion:
    """What a network adds to the warped image, for one idle frame; see `image.Completion`.

    Args:
        network: that is run.
        given: its input.
        idle: (H, W, 3) the idle frame.
    """

    def __init__(
        self, network: CompletionNetwork, given: CompletionInput, idle: ImageArray
    ) -> None:
        self._network, self._given, self._idle = network, given, idle

    def __call__(
        self, depth_m: Float32Array, normal: Float32Array, warped: ImageArray
    ) -> Float32Array:
        """Return grey levels (H, W, 3) to add to the warped image (H, W, 3) of a view's depth
        (H, W) and normals (H, W, 3)."""
        frame = self._given.frame(depth_m, normal, warped)
        added = self._network.added(frame, self._given.rest, self._given.image(warped))
        completion = resized(cv2.merge(list(255.0 * added)), (warped.shape[1], warped.shape[0]))
        match BASES[self._network.card.kind]:
            case "warped":
                return completion
            case "idle":
                return completion + self._idle.astype(np.float32) - warped.astype(np.float32)
            case _:
                return completion - warped.astype(np.float32)
