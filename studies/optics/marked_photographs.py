# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Photographs of a ball pressed on a flat gel, with a circle of contact marked in each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dotsim_ros.data.contact_circle import (
    BallPress,
    ContactCircle,
    find_contact_circles,
    one_contact,
    place_of,
)
from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.documents import Table, read_table
from dotsim_ros.io.files import read_image


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


@dataclass(frozen=True)
class CircleColumns:
    """Names of the columns of a table of circles: file, centre x and y, radius in pixels.

    Attributes:
        withheld: a column, and its value in rows whose photograph is not published.
    """

    file: str
    x: str
    y: str
    radius: str
    withheld: tuple[str, str] = ("", "")

    def __str__(self) -> str:
        return ", ".join((self.file, self.x, self.y, self.radius))


def read_marked_photographs(
    idle: Path, table: Path, columns: CircleColumns, folder: Path
) -> tuple[ImageArray, tuple[BallPress, ...]]:
    """Return the photograph without contact, and the presses sorted by name.

    Rows whose photograph is missing are refused, unless they say that it is withheld; each circle
    lies within the frame, and its photograph shows one contact, there.

    Args:
        idle: file of the photograph without contact.
        table: CSV of the circles.
        columns: its columns.
        folder: of the photographs.

    Raises:
        FileNotFoundError: a file is not there.
        ValueError: a file that is no image or of another size, a row that is no circle or one that
            leaves the frame, a photograph without a contact there, or with two.
    """
    untouched = read_image(idle)
    presses = []
    for name, circle, where in _circles(table, columns, folder):
        path = folder / name
        image = read_image(path)
        if image.shape != untouched.shape:
            raise ValueError(
                f"{path} has shape {image.shape}, expected that of {idle.name}, {untouched.shape}"
            )
        check_contact(path, image, untouched, circle, where)
        presses.append(BallPress(name, circle.centre_px, circle.radius_px, image))
    return untouched, tuple(sorted(presses, key=lambda press: press.name))


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


def _circles(
    table: Path, columns: CircleColumns, folder: Path
) -> Iterator[tuple[str, ContactCircle, str]]:
    read = read_table(table)
    for name, x, y, radius, line, withheld in zip(
        read.texts(columns.file),
        *(read.numbers(column) for column in (columns.x, columns.y, columns.radius)),
        read.lines,
        _is_withheld(read, columns),
        strict=True,
    ):
        where = f"{table}, line {line}"
        if not radius > 0.0:
            raise ValueError(
                f"{where}, column {columns.radius}: {radius:g}, expected a radius above 0"
            )
        if withheld and not (folder / name).exists():
            continue
        yield name, ContactCircle(np.array([x, y]), radius), where


def _is_withheld(read: Table, columns: CircleColumns) -> list[bool]:
    column, value = columns.withheld
    if column not in read.columns:
        return [False] * len(read.rows)
    return [cell == value for cell in read.texts(column)]


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
