# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Times the learned image: each part on a sensor with a network, and the network by two runtimes.

The whole of the optics is what a frame costs without the gel: depth, normals, the warped image,
the network's input, the network, and what it adds. The network alone is then timed by ONNX Runtime
and, where it is installed, by OpenVINO, with one and with two threads, and DeepLabV3-ResNet50 (with
random weights, which cost the same) in the same run, where torch is installed.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime

from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.files import given_path
from dotsim_ros.optics.idle import read_idle_frame
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.network.card import FINENESS
from dotsim_ros.optics.network.carded_weights import GRAPH
from dotsim_ros.optics.network.completion import CompletionNetwork
from dotsim_ros.optics.network.input import CompletionInput
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import SensorSpecification, load_sensor
from studies.run import expect_positive
from studies.timing import percentiles_ms

PRESS_AXIS = np.array([0.35, 0.2, 0.9]) / np.linalg.norm([0.35, 0.2, 0.9])
THREADS = (1, 2)
PERCENTS = (5, 50, 95)
WARM_CALLS = 5
"""Before the clock starts."""
Feed = dict[str, np.ndarray]


def pressed_skins(skin: SkinMesh, count: int) -> list[np.ndarray]:
    """Return shapes (V, 3) of a dent that deepens to 3 mm."""
    apex = np.linalg.norm(skin.rest_position_m, axis=1).max() * PRESS_AXIS
    distance = np.linalg.norm(skin.rest_position_m - apex, axis=1)
    share = np.exp(-((distance / 0.004) ** 2))[:, None]
    return [
        skin.rest_position_m - depth_m * share * PRESS_AXIS
        for depth_m in np.linspace(0.0, 0.003, count)
    ]


def timed(run: Callable[[], Any], count: int) -> dict[str, float]:
    """Return percentiles of a call's wall-clock time, after a few that do not count."""
    samples = []
    for number in range(-WARM_CALLS, count):
        start = time.perf_counter()
        run()
        if number >= 0:
            samples.append(time.perf_counter() - start)
    return percentiles_ms(samples, PERCENTS)


def whole_optics(
    sensor: SensorSpecification, directory: Path, count: int, threads: int
) -> tuple[dict[str, dict[str, float]], Feed]:
    """Return the times of every part over frames of a deepening dent, and a network's input."""
    camera = Camera.from_specification(sensor.camera)
    skin = skin_of(sensor.gel)
    idle = read_idle_frame(given_path(sensor.camera.idle_image), camera)
    renderer = SkinRenderer(camera, skin, band_count=threads)
    untouched = renderer.render(skin.rest_position_m)
    network = CompletionNetwork(directory, sensor=sensor.name, camera=camera, thread_count=threads)
    completion = network.at_rest(untouched, idle.image)
    images = ImageRenderer(
        camera,
        skin,
        idle.image,
        lighting=idle.lighting,
        vignetting=idle.vignetting,
        band_count=threads,
    )
    card = network.card
    fineness = FINENESS[card.kind]
    given = CompletionInput(
        camera,
        (card.width // fineness, card.height // fineness),
        fineness=fineness,
        depth_m=untouched.depth_m,
        normal=untouched.normal,
        idle=idle.image,
    )
    parts: dict[str, list[float]] = {}
    clock = time.perf_counter
    for number, position in enumerate(pressed_skins(skin, count + WARM_CALLS)):
        marks = [clock()]
        view = renderer.render(position)
        marks.append(clock())
        warped = images.warp(view)
        marks.append(clock())
        added = completion(view.depth_m, view.normal, warped)
        marks.append(clock())
        cv2.add(warped, added, dtype=cv2.CV_8U)
        marks.append(clock())
        if number < WARM_CALLS:
            continue
        spent = [*np.diff(marks), marks[-1] - marks[0]]
        for name, value in zip(("depth", "carry", "residual", "add", "whole"), spent, strict=True):
            parts.setdefault(name, []).append(float(value))
    frame = given.frame(view.depth_m, view.normal, warped)
    image = given.image(warped)
    feed = {"frame": frame[None], "rest": given.rest[None], "image": image[None]}
    return {name: percentiles_ms(samples, PERCENTS) for name, samples in parts.items()}, feed


def onnx_runtime(graph: Path, feed: Feed, threads: int, count: int) -> dict[str, float]:
    """Return the times of a graph by ONNX Runtime."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    session = onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    return timed(lambda: session.run(None, feed), count)


def open_vino(graph: Path, feed: Feed, threads: int, count: int) -> dict[str, float]:
    """Return the times of a graph by OpenVINO, in single precision."""
    import openvino

    settings = {
        "INFERENCE_NUM_THREADS": threads,
        "PERFORMANCE_HINT": "LATENCY",
        "INFERENCE_PRECISION_HINT": "f32",
    }
    compiled = openvino.Core().compile_model(graph, "CPU", settings)
    request = compiled.create_infer_request()
    return timed(lambda: request.infer(feed, share_inputs=True), count)


def published_network(threads: int, count: int) -> dict[str, float]:
    """Return the times of DeepLabV3-ResNet50 on 640x480 by torch."""
    import torch

    from dotsim_ros.learning.networks import make_network

    torch.set_num_threads(threads)
    network = make_network("paper").eval()
    frame = torch.rand(1, 7, 480, 640)
    with torch.inference_mode():
        samples = []
        for _ in range(count):
            start = time.perf_counter()
            network(frame, frame, frame)
            samples.append(time.perf_counter() - start)
    return percentiles_ms(samples, PERCENTS)


def optics_network(
    *,
    sensor: str = "sensor_a",
    network: str | None = None,
    frames: int = 200,
    published: int = 3,
) -> dict[str, Any]:
    """Run time of the learned image: each part of a frame, and the network by two runtimes.

    Args:
        sensor: name or file.
        network: its folder; the sensor's own where none is given.
        frames: to render.
        published: runs of DeepLabV3-ResNet50; 0 for none.
    """
    expect_positive(frames=frames)
    specification = load_sensor(sensor)
    if network is not None:
        camera = replace(specification.camera, residual=network)
        specification = replace(specification, camera=camera)
    if not specification.camera.residual:
        raise ValueError(f"sensor {specification.name!r} has no network; name one by --network")
    cv2.setNumThreads(1)
    directory = given_path(specification.camera.residual)
    runtimes = {"ONNX Runtime": onnx_runtime}
    if importlib.util.find_spec("openvino") is not None:
        runtimes["OpenVINO"] = open_vino
    optics, alone = {}, {}
    for threads in THREADS:
        optics[f"{threads} threads"], feed = whole_optics(specification, directory, frames, threads)
        for name, runtime in runtimes.items():
            alone[f"{name}, {threads} threads"] = runtime(directory / GRAPH, feed, threads, frames)
    found: dict[str, Any] = {"optics": optics, "network": alone}
    if published:
        found["published"] = published_network(max(THREADS), published)
    return found
