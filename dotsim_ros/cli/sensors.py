# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""List the sensors that come with the package, and show what they look like.

Prints name, shape, camera, elastic law and source of each; with --pictures an image of each without
contact and one with a ball of 4 mm radius pressed into it, arrows at printed markers (three times
as long as their motion).

examples:
  dotsim_ros sensors
  dotsim_ros sensors digit gelslim --pictures pictures
"""

from __future__ import annotations

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    add = parser.add_argument
    add("names", nargs="*", metavar="NAME", help="sensors to list (all)")
    add("--pictures", type=Path, metavar="DIR", help="write idle and pressed images here")


def run(arguments: argparse.Namespace) -> int:
    """Print the list, and write the pictures."""
    from dotsim_ros.specification import load_sensor, read_source, sensor_path, shipped_sensors

    shipped = shipped_sensors()
    names = arguments.names or shipped
    unknown = [name for name in names if name not in shipped]
    if unknown:
        raise ValueError(f"no shipped sensor {unknown[0]!r}; there are {', '.join(shipped)}")
    rows = [("name", "shape", "camera", "law", "source")]
    for name in names:
        sensor = load_sensor(name)
        camera = sensor.camera
        seen = f"{camera.projection} {camera.width}x{camera.height} {camera.colour}"
        source = read_source(sensor_path(name))
        rows.append((name, sensor.gel.shape, seen, sensor.material.law, source))
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    for row in rows:
        cells = [f"{cell:<{width}}" for cell, width in zip(row[:4], widths, strict=True)]
        print("  ".join([*cells, row[4]]))
    if arguments.pictures is not None:
        from dotsim_ros.view.sensors import write_pictures

        for path in write_pictures(names, arguments.pictures):
            print(f"wrote {path}", flush=True)
    return 0
