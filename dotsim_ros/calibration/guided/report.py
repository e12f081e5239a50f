# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a guided calibration found, in words, figures and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np

from dotsim_ros.calibration.guided.fit import GuidedCalibration
from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.files import write_image, write_json, write_text

PAGE, FIGURES = "guided.md", "guided.json"
CIRCLES, IMAGES = "circles.jpg", "images.jpg"
TILE_WIDTH_PX = 150
COLUMNS = 8
SHOWN = 4
WHITE = (255, 255, 255)
IDENTIFIED = """| what | from these photographs |
| --- | --- |
| idle image | yes |
| colour by slope and place (shading, light from around) | yes, within slopes and places pressed |
| circle of contact, in pixels | yes |
| pixels a millimetre | {scale} |
| depth of a press | only as the pad's shape gives it for the circle |
| thickness of the pad | no: measure it |
| Young's modulus, law, relaxation | no: a shape under a rigid ball does not depend on stiffness |
| Poisson's ratio | hardly: by the bulge next to the ball, mixed with the shading |
| friction | no |
| place and tilt of the camera | no: taken as straight, without distortion |

Presses with force that would give the rest, each recorded with pose and force
(docs/calibration.md):

- the same ball at three depths, slowly, at one place: Young's modulus, and whether the law is
  right;
- the deepest one held for a minute: relaxation;
- a slide of a millimetre under a press: friction;
- a flat punch of 3 mm or more: Poisson's ratio and thickness, which a small ball mixes.

Give them with `dotsim_ros calibrate --guided FOLDER ... --data DATA_SET`.
"""


def summary_lines(found: GuidedCalibration) -> list[str]:
    """Return what was found in a few lines."""
    own, idle = found.psnr_db, found.idle_psnr_db
    return [
        f"fitted on {len(found.fitted_on)} photographs, judged on {len(found.judged_on)} others: "
        f"{own['frame']:.2f} dB over the frame (the idle photograph: {idle['frame']:.2f}), "
        f"{own['contact']:.2f} dB around the contact ({idle['contact']:.2f})",
        "not told by photographs: stiffness, relaxation, friction, thickness"
        + ("" if found.scale.measured else "; and the scale, which is assumed"),
    ]


def write_guided_report(folder: Path, found: GuidedCalibration) -> None:
    """Write page, figures and pictures into a folder, each file whole or not at all."""
    write_image(folder / CIRCLES, circle_sheet(found))
    write_image(folder / IMAGES, image_sheet(found))
    photographs, scale = found.photographs, found.scale
    figures = {
        "idle": photographs.idle_name,
        "circles_px": {
            press.name: [*map(float, press.centre_px), press.radius_px]
            for press in photographs.presses
        },
        "left_out": dict(photographs.left_out),
        "too_wide": list(found.too_wide),
        "scale": asdict(scale),
        "fitted_on": list(found.fitted_on),
        "judged_on": list(found.judged_on),
        "psnr_db": dict(found.psnr_db),
        "idle_psnr_db": dict(found.idle_psnr_db),
        "provenance": dict(found.origin),
    }
    write_json(folder / FIGURES, figures)
    least, most = (1e-3 * bound for bound in scale.bounds)
    bounds = f"the ball allows {least:.2f} to {most:.2f} a millimetre"
    words = f"given; {bounds}" if scale.measured else f"no: assumed; {bounds}; measure it"
    left = [f"- left out: {reason}" for reason in photographs.left_out.values()]
    left += [
        f"- {name}: its circle is wider than the pad can be pressed to, and it is taken for the "
        "deepest press"
        for name in found.too_wide
    ]
    lines = [
        f"# {found.sensor.name}, from photographs of a ball\n",
        *(f"- {line}" for line in summary_lines(found)),
        f"- {1e-3 * scale.pixels_per_metre:.2f} pixels a millimetre",
        *left,
        f"\n![the circles that were found]({CIRCLES})\n",
        f"![photographs judged on, above; the sensor's images, below]({IMAGES})\n",
        IDENTIFIED.format(scale=words),
    ]
    write_text(folder / PAGE, "\n".join(lines))


def circle_sheet(found: GuidedCalibration) -> ImageArray:
    """Return all photographs with the circles that were found, in rows."""
    tiles: list[ImageArray] = []
    for press in found.photographs.presses:
        factor = TILE_WIDTH_PX / press.image.shape[1]
        centre = np.rint(factor * press.centre_px).astype(int)
        tile = _tile(press.image)
        radius = round(factor * press.radius_px)
        cv2.circle(tile, (int(centre[0]), int(centre[1])), radius, WHITE, 1)
        tiles.append(tile)
    return _rows([tiles[k : k + COLUMNS] for k in range(0, len(tiles), COLUMNS)])


def image_sheet(found: GuidedCalibration) -> ImageArray:
    """Return photographs that were judged on above the sensor's images of them."""
    shown = found.judged_on[:SHOWN]
    measured = {press.name: press.image for press in found.photographs.presses}
    return _rows(
        [
            [_tile(measured[name]) for name in shown],
            [_tile(found.predicted[name]) for name in shown],
        ]
    )


def _tile(image: ImageArray) -> ImageArray:
    height = round(image.shape[0] * TILE_WIDTH_PX / image.shape[1])
    small = cv2.resize(image, (TILE_WIDTH_PX, height), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8)


def _rows(rows: Sequence[Sequence[ImageArray]]) -> ImageArray:
    widest = max(len(row) for row in rows)
    blank = np.zeros_like(rows[0][0])
    return np.concatenate(
        [np.concatenate([*row, *[blank] * (widest - len(row))], axis=1) for row in rows]
    )
