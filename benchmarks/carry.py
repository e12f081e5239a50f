# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Scores the warped idle frame on measured images, with the measured skin at full depth.

    python benchmarks/carry.py ../shared/measured/sensor_a --json carry.json

The camera is the one that the sensor's file states, at the measured resolution; nothing is fitted.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

import numpy as np

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.measured.data_set import read_data_set
from dotsim_ros.metrics.images import image_psnr_db
from dotsim_ros.optics.idle import read_idle_frame
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.lighting import Lighting
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import load_sensor

UNCHANGING = Lighting(ambient_fraction=1e9)


def measure(directory: Path, sensor_name: str) -> dict[str, float]:
    """Return mean PSNR (dB) over the last frames of all single presses, for three images."""
    data = read_data_set(directory)
    skin = data.skin_mesh()
    sensor_camera = Camera.from_specification(load_sensor(sensor_name).camera)
    scores = []
    for entry in data.entries:
        if not entry.has_images or "slide" in entry.name or "cycle" in entry.name:
            continue
        trajectory = entry.read()
        if trajectory.image is None or trajectory.skin is None:
            raise ValueError(f"{entry.bag} has no image or no skin, expected both")
        measured = trajectory.image.pixels[-1]
        camera = sensor_camera.scaled(measured.shape[1], measured.shape[0])
        idle = read_idle_frame(data.idle_images()[0], camera)
        view = SkinRenderer(camera, skin).render(trajectory.skin.position_m[-1])
        warped = ImageRenderer(camera, skin, idle.image, lighting=UNCHANGING).render(view)
        shaded = ImageRenderer(camera, skin, idle.image, lighting=idle.lighting).render(view)
        scores.append([image_psnr_db(image, measured) for image in (idle.image, warped, shaded)])
    means = np.mean(scores, axis=0)
    names = ("idle_db", "carried_db", "carried_and_shaded_db")
    return {name: round(float(mean), 2) for name, mean in zip(names, means, strict=True)}


def main() -> None:
    """Print the scores, and write them as JSON where asked."""
    parser = argparse.ArgumentParser(
        description="Score the warped idle frame on measured images.",
        epilog="example: python benchmarks/carry.py ../shared/measured/sensor_a",
    )
    parser.add_argument("data_set", type=Path, help="folder that holds dataset.yaml")
    parser.add_argument("--sensor", default="densetact2", help="name or YAML file of the sensor")
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    arguments = parser.parse_args()
    result = measure(arguments.data_set, arguments.sensor)
    for name, value in result.items():
        print(f"{name:<24}{value:6.2f}")
    if arguments.json:
        temporary = arguments.json.with_suffix(".part")
        temporary.write_text(json.dumps(result, indent=2) + "\n")
        os.replace(temporary, arguments.json)


if __name__ == "__main__":
    main()
