# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The most that a network of small images could reach: the ideal completion at its size.

    python benchmarks/residual_size.py --data DIR --indenters 1_sphere 3_lying_cylinder

A network whose images have fewer pixels than the sensor's adds a completion that is enlarged to the
sensor's size. Here the completion is the measured image less the mean idle image, reduced to each
size and enlarged again as the networks' is, so that no training enters: no network of that size
that adds to the idle image does better, but for chance. Mean of the frames' PSNR over the whole
frame.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.files import write_json
from dotsim_ros.measured.data_set import read_data_set
from dotsim_ros.measured.trajectory import iterate_images
from dotsim_ros.metrics.images import image_psnr_db
from dotsim_ros.optics.idle_check import read_idle_images
from dotsim_ros.optics.network.input import resized
from dotsim_ros.provenance import provenance


def main() -> None:
    """Read the images and print a line for each size."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True, help="folder of a data set")
    parser.add_argument("--indenters", nargs="*", default=[], help="judged alone (all)")
    parser.add_argument("--widths", type=int, nargs="+", default=[64, 160], help="pixels")
    parser.add_argument("--topic", default="/tactile/image_raw/compressed", help="of the images")
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    arguments = parser.parse_args()
    data = read_data_set(arguments.data)
    idle = read_idle_images(data.idle_images()).astype(np.float64).mean(axis=0)
    height, width = idle.shape[:2]
    scores: dict[str, list[float]] = {"idle": [], **{str(w): [] for w in arguments.widths}}
    judged = [
        entry
        for entry in data.entries
        if entry.has_images and (not arguments.indenters or entry.indenter in arguments.indenters)
    ]
    if not judged:
        known = ", ".join(sorted({entry.indenter for entry in data.entries}))
        parser.error(f"no images of {' '.join(arguments.indenters)}; the data set holds {known}")
    for entry in judged:
        for _, measured in iterate_images(entry.bag, arguments.topic):
            completion = measured - idle
            scores["idle"].append(image_psnr_db(measured, np.rint(idle).astype(np.uint8)))
            for small in arguments.widths:
                size = (small, round(small * height / width))
                image = idle + resized(resized(completion, size), (width, height))
                shown = np.clip(np.rint(image), 0, 255).astype(np.uint8)
                scores[str(small)].append(image_psnr_db(measured, shown))
    means: dict[str, Any] = {name: float(np.mean(values)) for name, values in scores.items()}
    for name, psnr_db in means.items():
        title = name if name == "idle" else f"completion {name} px wide"
        print(f"{title:<24} {psnr_db:6.2f} dB  ({len(scores[name])} frames)")
    if arguments.json is not None:
        write_json(arguments.json, {"psnr_db": means, "provenance": provenance()})


if __name__ == "__main__":
    main()
