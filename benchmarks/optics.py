# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Times the camera on one core: depth and image apart, and Embree beside it in the same run.

What other processes take of the core is in the wall-clock times but not in `camera_cpu`.

python benchmarks/optics.py --json optics.json
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dotsim_ros.files import parameter_path, write_json
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin
from dotsim_ros.optics.idle import read_idle_frame
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.optics.visibility import Visibility
from dotsim_ros.provenance import provenance
from dotsim_ros.specification import load_sensor

PRESS_AXIS = np.array([0.35, 0.2, 0.9]) / np.linalg.norm([0.35, 0.2, 0.9])


def pressed_skins(skin: SkinMesh, count: int) -> list[np.ndarray]:
    """Return shapes (V, 3) of a dent that deepens to 3 mm."""
    apex = np.linalg.norm(skin.rest_position_m, axis=1).max() * PRESS_AXIS
    distance = np.linalg.norm(skin.rest_position_m - apex, axis=1)
    share = np.exp(-((distance / 0.004) ** 2))[:, None]
    return [
        skin.rest_position_m - depth_m * share * PRESS_AXIS
        for depth_m in np.linspace(0.0, 0.003, count)
    ]


def milliseconds(run: Callable[[], Any]) -> tuple[float, Any]:
    """Return the wall-clock time of a call, and its result."""
    start = time.perf_counter()
    result = run()
    return 1e3 * (time.perf_counter() - start), result


def spread(samples: list[float]) -> dict[str, float]:
    """Return the quantiles that the table shows."""
    quantiles = np.percentile(samples, [5, 50, 95, 99])
    return {
        name: round(float(value), 3)
        for name, value in zip(("p5_ms", "p50_ms", "p95_ms", "p99_ms"), quantiles, strict=True)
    }


def measure(sensor_name: str, frame_count: int) -> dict[str, Any]:
    """Return the times of every part, over frames of a deepening dent.

    Embree renders every tenth frame between the others, so that both see the same machine.
    """
    sensor = load_sensor(sensor_name)
    camera = Camera.from_specification(sensor.camera)
    skin = dome_skin(sensor.gel.outer_radius_m, sensor.gel.skin_spacing_m)
    idle = read_idle_frame(parameter_path(sensor.camera.idle_image), camera)
    renderer = SkinRenderer(camera, skin)
    reference = SkinRenderer(camera, skin, visibility=Visibility.EMBREE)
    images = ImageRenderer(
        camera, skin, idle.image, lighting=idle.lighting, vignetting=idle.vignetting
    )
    images.render(renderer.render(skin.rest_position_m))
    reference.render(skin.rest_position_m)

    names = ("depth", "image", "camera", "camera_cpu", "embree_depth")
    times: dict[str, list[float]] = {name: [] for name in names}
    depth_error_m = 0.0
    for number, position in enumerate(pressed_skins(skin, frame_count)):
        begun_s = time.thread_time()
        depth, view = milliseconds(lambda position=position: renderer.render(position))
        image, _ = milliseconds(lambda view=view: images.render(view))
        times["camera_cpu"].append(1e3 * (time.thread_time() - begun_s))
        times["depth"].append(depth)
        times["image"].append(image)
        times["camera"].append(depth + image)
        if number % 10 == 0:
            traced, expected = milliseconds(lambda position=position: reference.render(position))
            times["embree_depth"].append(traced)
            both = view.mask & expected.mask
            error = np.abs(view.depth_m - expected.depth_m)[both].max()
            depth_error_m = max(depth_error_m, float(error))
    parts = {name: spread(samples) for name, samples in times.items()}
    return {
        "width": camera.width,
        "height": camera.height,
        "vertex_count": skin.vertex_count,
        "frame_count": frame_count,
        "parts": parts,
        "embree_ratio": round(parts["embree_depth"]["p50_ms"] / parts["depth"]["p50_ms"], 2),
        "largest_depth_difference_to_embree_m": depth_error_m,
        "provenance": provenance(),
    }


def main() -> None:
    """Print the table, and write it as JSON where asked."""
    parser = argparse.ArgumentParser(
        description="Time the camera on one core.",
        epilog="example: python benchmarks/optics.py --frames 500 --json optics.json",
    )
    parser.add_argument("--sensor", default="densetact2", help="name or YAML file of the sensor")
    parser.add_argument("--frames", type=int, default=300, help="frames to render")
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    result = measure(arguments.sensor, arguments.frames)
    print(f"{result['width']}x{result['height']}, {result['vertex_count']} vertices")
    print(f"{'part':<14}{'p5':>9}{'p50':>9}{'p95':>9}{'p99':>9}  ms")
    for name, part in result["parts"].items():
        print(f"{name:<14}" + "".join(f"{value:9.2f}" for value in part.values()))
    print(f"Embree takes {result['embree_ratio']} times as long for the depth")
    print(f"largest difference of depth: {result['largest_depth_difference_to_embree_m']:.2g} m")
    if arguments.json:
        write_json(arguments.json, result)


if __name__ == "__main__":
    main()
