# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""List the sensors that come with the package, and show what they look like.

Prints name, shape, camera, elastic law and source of each; with --pictures an image of each without
contact and one with a ball of 4 mm radius pressed into it, arrows at printed markers (three times
as long as their motion). With --frames the frames a second of each on this machine, while such a
ball presses and slides; a first run also computes the gel's tables, which takes minutes.

example:
  dotsim_ros sensors --json sensors.json
  dotsim_ros sensors digit gelslim --pictures pictures
  dotsim_ros sensors digit --frames 200
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dotsim_ros.cli._options import NoSeed, Whole, say

NOT_MEASURED = (
    "frames_per_second is null: not measured, as it is of one machine; --frames N measures it"
)
MEASURED = (
    "frames_per_second: on this machine, the sensor alone with its own solver, gel and image one "
    "after the other, while a ball of 4 mm radius presses and slides"
)


def run(
    *names: str,
    pictures: Path | None = None,
    frames: Whole | None = None,
    seed: NoSeed = 0,
    json: Path | None = None,
) -> int:
    """Print the list, and write it and the pictures.

    Args:
        names: sensors to list; without it all.
        pictures: write idle and pressed images here.
        frames: measure the rate of so many frames of each.
        json: write the list to this file as well.
    """
    from dotsim_ros.io.files import shipped_names, write_json
    from dotsim_ros.io.provenance import provenance

    shipped = shipped_names("sensors")
    listed_names = list(names) or shipped
    unknown = [name for name in listed_names if name not in shipped]
    if unknown:
        raise ValueError(f"no shipped sensor {unknown[0]!r}; there are {', '.join(shipped)}")
    listed = [_described(name, frames) for name in listed_names]
    _print_table(listed, is_measured=frames is not None)
    if json is not None:
        note = NOT_MEASURED if frames is None else MEASURED
        listing = {"sensors": listed, "note": note, "provenance": provenance()}
        write_json(json, listing)
    if pictures is not None:
        from dotsim_ros.view.sensors import write_pictures

        for path in write_pictures(listed_names, pictures):
            print(f"wrote {path}", flush=True)
    return 0


def _described(name: str, frame_count: int | None) -> dict[str, Any]:
    """Return what is listed of a sensor, with its rate over so many frames; None: not measured."""
    from dotsim_ros.specification import load_sensor, read_source, sensor_path

    sensor = load_sensor(name)
    camera = sensor.camera
    rate = None
    if frame_count is not None:
        from dotsim_ros.view.sensors import frames_per_second

        say(f"measuring {name}")
        rate = round(frames_per_second(sensor, frame_count), 1)
    return {
        "name": name,
        "shape": sensor.gel.shape,
        "camera": f"{camera.projection} {camera.width}x{camera.height} {camera.colour}",
        "frames_per_second": rate,
        "law": sensor.material.law,
        "source": read_source(sensor_path(name)),
    }


def _print_table(listed: list[dict[str, Any]], *, is_measured: bool) -> None:
    columns = ["name", "shape", "camera", "law", "source"]
    if is_measured:
        columns.insert(3, "frames_per_second")
    rows = [columns, *([str(sensor[column]) for column in columns] for sensor in listed)]
    widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
    for row in rows:
        cells = [f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)]
        print("  ".join(cells).rstrip())
