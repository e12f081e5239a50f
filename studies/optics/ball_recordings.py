# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Photographs of a ball pressed on a flat gel, with a circle of contact marked by hand in each.

Of a GelSight, as Rancho-zhao/FOTS publishes them (`mlp_calib/`, MIT): Zhao, Qian, Duan, Luo:
"FOTS: A Fast Optical Tactile Simulator for Sim2Real Learning of Tactile-motor Robot Manipulation
Skills", RA-L 2024 (arXiv 2404.19217). Images 240 wide and 320 high; ball and scale are those of its
repository.

Of a lab's GelSight and of a GelSight Mini, as the package `taxim` publishes them (MIT): Si, Yuan:
"Taxim: An Example-Based Simulation Model for GelSight Tactile Sensors", RA-L 7(2), 2022 (arXiv
2109.04027), as continued in TimSchneider42/taxim. Images of 640x480.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from dotsim_ros.data.contact_circle import (
    BallPress,
    ContactCircle,
    find_contact_circles,
    one_contact,
    place_of,
)
from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.documents import read_table
from dotsim_ros.io.files import read_image


@dataclass(frozen=True)
class Published:
    """A recording as it is published.

    Attributes:
        name: of the recording.
        ball_radius_m: of the ball.
        pixels_per_metre: of the flat gel.
        table: file of the circles.
        columns: of it: file, centre x and y, radius in pixels.
        folder: of the photographs and idle.png.
        withheld: a column, and its value in rows whose photograph is not published.
        scale_known: whether radius and scale were recorded, or are assumed.
    """

    name: str
    ball_radius_m: float
    pixels_per_metre: float
    table: str
    columns: tuple[str, str, str, str] = (
        "file",
        "contact_x_px",
        "contact_y_px",
        "contact_radius_px",
    )
    folder: str = ""
    withheld: tuple[str, str] = ("split", "held_out")
    scale_known: bool = True


FOTS = "fots"
TAXIM_SUBSETS = ("gelsight", "gelsight_mini")
RECORDINGS: Mapping[str, Published] = MappingProxyType(
    {
        FOTS: Published(
            "gelsight",
            2.35e-3,
            19.58e3,
            "contact_circles.csv",
            columns=("img_names", "center_x", "center_y", "radius"),
        ),
        "taxim_gelsight": Published(
            "taxim_gelsight", 2.0e-3, 1.0 / 0.0295e-3, "gelsight.csv", folder="gelsight"
        ),
        # Neither was recorded. The scale is the 0.0634 mm a pixel of the maker's demonstrations at
        # 320x240; images of a ball alone do not show its radius, see docs/real_data.md. It is a
        # round number above the widest contact found.
        "taxim_gelsight_mini": Published(
            "taxim_gelsight_mini",
            1.0e-3,
            2.0 / 0.0634e-3,
            "gelsight_mini.csv",
            folder="gelsight_mini",
            scale_known=False,
        ),
    }
)


@dataclass(frozen=True)
class BallRecording:
    """Photographs of presses of one ball on one sensor.

    Attributes:
        name: of the recording.
        idle: (H, W, 3) uint8, without contact.
        presses: sorted by name.
        ball_radius_m: of the ball.
        pixels_per_metre: of the flat gel.
        scale_known: whether radius and scale were recorded, or are assumed.
    """

    name: str
    idle: ImageArray
    presses: tuple[BallPress, ...]
    ball_radius_m: float
    pixels_per_metre: float
    scale_known: bool = True


def read_ball_recording(directory: Path, name: str) -> BallRecording:
    """Return a published recording.

    Rows whose photograph is missing are refused, unless they say that it is withheld; each circle
    lies within the frame, and its photograph shows one contact, there.

    Args:
        directory: with the table of circles, and the folder of the images that it names.
        name: of `RECORDINGS`.

    Raises:
        FileNotFoundError: a file is not there.
        ValueError: a file that is no image or of another size, a row that is no circle or one that
            leaves the frame, a photograph without a contact there, or with two.
    """
    known = RECORDINGS[name]
    folder, table = directory / known.folder, directory / known.table
    idle, read = read_image(folder / "idle.png"), read_table(table)
    file, *numbers = known.columns
    column, value = known.withheld
    withheld = read.texts(column) if column in read.columns else [""] * len(read.rows)
    presses = []
    for image_name, x, y, radius, line, split in zip(
        read.texts(file), *map(read.numbers, numbers), read.lines, withheld, strict=True
    ):
        where, path = f"{table}, line {line}", folder / image_name
        if not radius > 0.0:
            raise ValueError(f"{where}, column {numbers[2]}: {radius:g}, expected a radius above 0")
        if split == value and not path.exists():
            continue
        image, circle = read_image(path), ContactCircle(np.array([x, y]), radius)
        if image.shape != idle.shape:
            raise ValueError(
                f"{path} has shape {image.shape}, expected that of idle.png, {idle.shape}"
            )
        check_contact(path, image, idle, circle, where)
        presses.append(BallPress(image_name, circle.centre_px, circle.radius_px, image))
    return BallRecording(
        known.name,
        idle,
        tuple(sorted(presses, key=lambda press: press.name)),
        known.ball_radius_m,
        known.pixels_per_metre,
        known.scale_known,
    )


def with_circles_found(recording: BallRecording) -> BallRecording:
    """Return a recording with the circles found in its photographs instead of those marked.

    Raises:
        ValueError: a photograph does not show one ball.
    """
    presses = []
    for press in recording.presses:
        circle = one_contact(Path(press.name), find_contact_circles(press.image, recording.idle))
        presses.append(replace(press, centre_px=circle.centre_px, radius_px=circle.radius_px))
    return replace(recording, presses=tuple(presses))


def check_contact(
    path: Path, image: ImageArray, idle: ImageArray, circle: ContactCircle, where: str
) -> None:
    """Refuse a photograph that does not show one contact, in a circle.

    Args:
        path: of the photograph, for messages.
        image: (H, W, 3) the photograph.
        idle: (H, W, 3) without contact.
        circle: where contact is marked.
        where: who says so, for messages.

    Raises:
        ValueError: the circle leaves the frame, or nothing touches there, or something elsewhere.
    """
    height, width = image.shape[:2]
    if circle.leaves(width, height):
        raise ValueError(
            f"{where}: the circle of {path.name} leaves the frame of {width}x{height} pixels; a "
            "ball at the edge shows a part of its shading only: leave the row out, or press nearer "
            "the middle"
        )
    found = one_contact(path, find_contact_circles(image, idle))
    if np.linalg.norm(found.centre_px - circle.centre_px) > circle.radius_px:
        raise ValueError(
            f"{where}: the circle of {path.name} is at {place_of(circle)}, but what differs from "
            f"the idle photograph is at {place_of(found)}; mark the circle again"
        )
