# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""From a bag to its video and contact sheet."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.data.bag import BagReader, bag_name
from dotsim_ros.data.mcap.reader import Tolerance
from dotsim_ros.io.documents import ArrayForm, read_arrays
from dotsim_ros.view.panels import PanelImages
from dotsim_ros.view.sheet import strongest_stamps, write_sheet
from dotsim_ros.view.timeline import (
    ViewTopics,
    find_topics,
    iterate_moments,
    read_forces,
    read_stamps,
)
from dotsim_ros.view.video import GIF_WIDTH_PX, Board, usual_rate_hz, write_gif, write_video

LARGEST_GIF_FPS = 12.5
LARGEST_FRAME_COUNT = 100_000
"""An hour at 25 frames a second, which takes about as long to draw."""


@dataclass(frozen=True)
class ViewRequest:
    """What to make of a bag.

    Attributes:
        bag: its folder.
        out: folder of the files.
        topics: those the user named.
        formats: of the video: any of "mp4" and "gif".
        fps: frames a second; None: those of the bag.
        speed: seconds of the bag in a second of the video.
        column_count: of the contact sheet.
        rest: .npz with `rest_position_m`, or None.
    """

    bag: Path
    out: Path
    topics: ViewTopics
    formats: tuple[str, ...]
    fps: float | None
    speed: float
    column_count: int
    rest: Path | None


def _rest_m(path: Path | None) -> NDArray[np.float64] | None:
    if path is None:
        return None
    return read_arrays(path, {"rest_position_m": ArrayForm((None, 3))})["rest_position_m"]


def _check_length(stamps_ns: NDArray[np.int64], fps: float, speed: float) -> None:
    """Refuse a video that nobody waits for.

    Raises:
        ValueError: it would have too many frames.
    """
    duration_s = 1e-9 * float(stamps_ns[-1] - stamps_ns[0])
    count = duration_s / speed * fps
    if count > LARGEST_FRAME_COUNT:
        raise ValueError(
            f"the video would have {count:.3g} frames ({duration_s:.6g} s of the bag at speed "
            f"{speed:g} and {fps:g} frames a second), expected at most {LARGEST_FRAME_COUNT}; give "
            "a higher --speed or a lower --fps, or --format none for the contact sheet alone"
        )


@contextmanager
def _of_bag(path: Path) -> Iterator[None]:
    """Put the name of the bag before what is wrong with it."""
    try:
        yield
    except ValueError as error:
        if str(path) in str(error):
            raise
        raise ValueError(f"{path}: {error}") from error


def view_bag(request: ViewRequest, warn: Callable[[str], None]) -> list[Path]:
    """Write the files that are asked for and return their paths.

    A bag that was not finished, or is cut short, is shown up to where it ends.

    Args:
        request: what to make.
        warn: takes what is not shown and why, a sentence each.

    Raises:
        FileNotFoundError: no such bag.
        ValueError: it cannot be read, is damaged, or shows nothing.
        OSError: a file could not be written; the one before it is left as it was.
    """
    with BagReader(request.bag, Tolerance.UNFINISHED) as reader:
        damage = "; ".join(reader.damage)
        there = reader.topics()
    if not there:
        reason = f": {damage}" if damage else ""
        raise ValueError(f"{request.bag} holds no message that can be read{reason}")
    if damage:
        warn(
            f"{damage}; what comes before is shown (`dotsim_ros record --repair {request.bag}` "
            "makes a whole bag of it)"
        )
    with _of_bag(request.bag):
        topics = find_topics(there, given=request.topics)
    stamps = read_stamps(request.bag, topics)
    stamps_ns = stamps.stamp_ns
    if stamps.refused_count:
        warn(f"{stamps.refused_count} messages are not shown: their stamp is no time")
    if stamps_ns.size == 0:
        raise ValueError(f"{request.bag} shows nothing: no image, no depth and no skin")
    fps = request.fps or usual_rate_hz(stamps_ns)
    if request.formats:
        _check_length(stamps_ns, fps, request.speed)
    with _of_bag(request.bag):
        return _drawn(request, topics, stamps_ns, fps)


def _drawn(
    request: ViewRequest, topics: ViewTopics, stamps_ns: NDArray[np.int64], fps: float
) -> list[Path]:
    """Write the files and return their paths."""
    forces = read_forces(request.bag, topics.wrench)
    images = PanelImages(iterate_moments(request.bag, topics), rest_m=_rest_m(request.rest))
    start_ns, end_ns = int(stamps_ns[0]), int(stamps_ns[-1])
    title = bag_name(request.bag)
    chosen = set(strongest_stamps(stamps_ns, forces, count=request.column_count))
    sheet = request.out / f"{title}.png"
    write_sheet(
        sheet,
        (moment for moment in iterate_moments(request.bag, topics) if moment.stamp_ns in chosen),
        images,
        forces,
        start_ns=start_ns,
        end_ns=end_ns,
        title=title,
    )
    written = [sheet]
    if request.formats:
        board = Board(images, forces, start_ns=start_ns, end_ns=end_ns, title=title)
        with tempfile.TemporaryDirectory() as folder:
            keeps_video = "mp4" in request.formats
            video = (request.out if keeps_video else Path(folder)) / f"{title}.mp4"
            write_video(
                video,
                iterate_moments(request.bag, topics),
                board,
                fps=fps,
                speed=request.speed,
            )
            if keeps_video:
                written.append(video)
            if "gif" in request.formats:
                gif = request.out / f"{title}.gif"
                write_gif(gif, video, fps=min(fps, LARGEST_GIF_FPS), width_px=GIF_WIDTH_PX)
                written.append(gif)
    return written
