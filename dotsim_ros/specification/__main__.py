# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The documentation of a sensor's file, printed from the code that reads it.

    python -m dotsim_ros.specification

prints the tables of all fields; with `--markdown docs/api/sensor_fields.md` it writes them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from dotsim_ros.io.files import write_text
from dotsim_ros.io.quantity import field_table
from dotsim_ros.specification.sensor import (
    LARGEST_DISTANCE_M,
    LARGEST_MEMORY_BYTES,
    SECTIONS,
    SensorSpecification,
)

_HEAD = """\
# The fields of a sensor's file

A sensor is one YAML file. `python -m dotsim_ros.specification` prints this page from the code that
reads it.

```yaml
name: my_pad
gel:
  shape: flat_pad
  pad_size_m: [0.03, 0.03, 0.005]
solver:
  grid_spacing_m: 0.002
camera:
  position_m: [0.0, 0.0, -0.02]
  half_height_angle_deg: 35.0
  idle_image: ""
lighting:
  radius_m: 0.02
  height_m: -0.004
```

- Load it by its path, or put it into `params/sensors/` and load it by its name: parameter `sensor`
  of `tactile_sim`, option `--sensor` of the commands, `load_sensor` in Python. A section or a field
  that is left out has its default.
- Lengths are in metres and all else in SI units, angles in degrees where the name ends so. The base
  plane of the gel is z = 0, +z points out of the gel, and the z axis is its middle.
- A value that is unknown, of another type or out of its range is refused: the error names the
  field, the value and the range. Nothing is rounded, and quoted text is not a number. Numbers are
  finite.
- Fields that contradict each other are refused: a core as large as its dome, a grid wider than
  half the gel's smallest extent, a camera in front of the skin or more than {distance} m from the
  gel, an explicit solver with another law than its own, and a sensor that would take more than
  {gigabytes} GB of memory. `dotsim_ros.specification.size_of` returns that memory beforehand,
  within a third.

**Idle image.** The simulated image is the [idle image](../camera.md#the-idle-image), warped and
shaded. Where `camera.idle_image` is empty it is drawn from the sections `lighting`, `vignetting`
and `pattern`, in a few seconds when the sensor is created. To keep it as a file:

```bash
python -m dotsim_ros.optics.pattern my_pad_idle.png --sensor my_pad.yaml
```

This writes the image and, next to it, a file with its lights. Such a file comes before the sensor's
own sections `lighting` and `vignetting`.

**Pads.** `flat_pad` is a block of gel on a clear plate at z = 0. The camera stands below and looks
up at the inner side of the upper face, the only one that is seen. `params/sensors/flat_pad.yaml` is
one, made with the command above. A `curved_pad` differs by its upper face, which is highest in the
middle and a part of a ball or a cylinder.

**Camera.** Of a calibrated camera's CameraInfo, with K = [fx 0 cx; 0 fy cy; 0 0 1],
`half_height_angle_deg` is `degrees(atan(height / (2 fy)))` for `plumb_bob` (projection `pinhole`)
and `degrees(height / (2 fy))` for `equidistant`, `pixel_aspect` is fx / fy, `principal_point_px` is
[cx, cy], and `distortion` the first four of D; a k3 of `plumb_bob` must be 0.

**Noise.** `noise` adds normal noise to every image of `TactileSensor`. It is drawn by `noise.seed`
and the frame's time since the last `reset`: the same motion after a reset gives the same images to
the last bit, and `reset(noise_seed=7)` other ones. `tactile_sim` draws it by the frame's stamp
instead, and its parameter `image_noise_levels` comes before the sensor's own where it is not
negative.
"""


def field_page() -> str:
    """Return the documentation of a sensor's file, in Markdown."""
    parts = [
        _HEAD.format(distance=LARGEST_DISTANCE_M, gigabytes=f"{LARGEST_MEMORY_BYTES / 1e9:.0f}"),
        "\n## Top level\n\nThe name, and the sections below.\n\n",
        field_table(SensorSpecification),
    ]
    for section, kind in SECTIONS.items():
        meaning = " ".join((kind.__doc__ or "").split())
        parts.append(f"\n## `{section}`\n\n{meaning}\n\n{field_table(kind)}")
    return "".join(parts)


def main() -> None:
    """Print the documentation of a sensor's file, or write it."""
    parser = argparse.ArgumentParser(
        prog="python -m dotsim_ros.specification",
        description="Print every field of a sensor's file with its unit, range and default.",
        epilog="example: python -m dotsim_ros.specification --markdown docs/api/sensor_fields.md",
    )
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the page to this file")
    arguments = parser.parse_args()
    if arguments.markdown is None:
        print(field_page(), end="")
    else:
        write_text(arguments.markdown, field_page())


if __name__ == "__main__":
    main()
