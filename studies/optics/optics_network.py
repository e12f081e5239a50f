# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Times the learned image: each part on a sensor with a network, and the network by two runtimes.

    python benchmarks/optics_network.py --sensor sensor_a --json optics_network.json

The whole of the optics is what a frame costs beside the gel: depth, normals, the warped image,
the network's input, the network, and what it adds. The network alone is then timed by ONNX Runtime
and, where it is installed, by OpenVINO, with one and with two threads, and DeepLabV3-ResNet50 (with
random weights, which cost the same) beside it in the same run where torch is.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime

from dotsim_ros.files import given_path, write_json
from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.optics.idle import read_idle_frame
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.network.card import FINENESS
from dotsim_ros.optics.network.carded_weights import GRAPH
from dotsim_ros.optics.network.completion import CompletionNetwork
from dotsim_ros.optics.network.input import CompletionInput
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.provenance import provenance
from dotsim_ros.specification import SensorSpecification, load_sensor

PRESS_AXIS = np.array([0.35, 0.2, 0.9]) / np.linalg.norm([0.35, 0.2, 0.9])
THREADS = (1, 2)
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


def spread(samples_s: list[float]) -> dict[str, float]:
    """Return the quantiles that the table shows."""
    quantiles = 1e3 * np.percentile(samples_s, [5, 50, 95])
    return {
        name: round(float(value), 2)
        for name, value in zip(("p5_ms", "p50_ms", "p95_ms"), quantiles, strict=True)
    }


def timed(run: Callable[[], Any], count: int) -> dict[str, float]:
    """Return the spread of a call's wall-clock time, after a few that do not count."""
    samples = []
    for number in range(count + 5):
        start = time.perf_counter()
        run()
        if number >= 5:
            samples.append(time.perf_counter() - start)
    return spread(samples)


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
    for number, position in enumerate(pressed_skins(skin, count + 5)):
        marks = [clock()]
        view = renderer.render(position)
        marks.append(clock())
        warped = images.warp(view)
        marks.append(clock())
        added = completion(view, warped)
        marks.append(clock())
        cv2.add(warped, added, dtype=cv2.CV_8U)
        marks.append(clock())
        if number < 5:
            continue
        spent = [*np.diff(marks), marks[-1] - marks[0]]
        for name, value in zip(("depth", "carry", "residual", "add", "whole"), spent, strict=True):
            parts.setdefault(name, []).append(float(value))
    frame = given.frame(view.depth_m, view.normal, warped)
    image = given.image(warped)
    feed = {"frame": frame[None], "rest": given.rest[None], "image": image[None]}
    return {name: spread(samples) for name, samples in parts.items()}, feed


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
    return spread(samples)


def measure(sensor: SensorSpecification, count: int, published: int) -> dict[str, Any]:
    """Return all times."""
    directory = given_path(sensor.camera.residual)
    result: dict[str, Any] = {"optics": {}, "network": {}}
    for threads in THREADS:
        result["optics"][f"{threads} threads"], feed = whole_optics(
            sensor, directory, count, threads
        )
        result["network"][f"ONNX Runtime, {threads} threads"] = onnx_runtime(
            directory / GRAPH, feed, threads, count
        )
        try:
            result["network"][f"OpenVINO, {threads} threads"] = open_vino(
                directory / GRAPH, feed, threads, count
            )
        except ModuleNotFoundError:
            print("OpenVINO is not installed")
    if published:
        result["published"] = published_network(max(THREADS), published)
    result["provenance"] = provenance()
    return result


def main() -> None:
    """Print the table, and write it as JSON where asked."""
    parser = argparse.ArgumentParser(
        description="Time the learned image.",
        epilog="example: python benchmarks/optics_network.py --frames 300 --json times.json",
    )
    parser.add_argument("--sensor", default="sensor_a", help="name or YAML file of the sensor")
    parser.add_argument("--network", help="folder of the network (the sensor's)")
    parser.add_argument("--frames", type=int, default=200, help="frames to render")
    parser.add_argument("--published", type=int, default=0, help="runs of the published network")
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    arguments = parser.parse_args()
    sensor = load_sensor(arguments.sensor)
    if arguments.network:
        sensor = replace(sensor, camera=replace(sensor.camera, residual=arguments.network))
    if not sensor.camera.residual:
        parser.error(f"sensor {sensor.name!r} has no network; name one by --network")
    cv2.setNumThreads(1)
    result = measure(sensor, arguments.frames, arguments.published)
    print(f"{'part':<28}{'p5':>9}{'p50':>9}{'p95':>9}  ms")
    for title, parts in (*result["optics"].items(), ("network alone", result["network"])):
        print(title)
        for name, part in parts.items():
            print(f"  {name:<26}" + "".join(f"{value:9.2f}" for value in part.values()))
    if "published" in result:
        values = "".join(f"{value:9.2f}" for value in result["published"].values())
        print(f"{'DeepLabV3-ResNet50, torch':<28}{values}")
    if arguments.json:
        write_json(arguments.json, result)


if __name__ == "__main__":
    main()
