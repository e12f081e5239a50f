# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""From a bag to its video and contact sheet."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.data.bag import bag_name
from dotsim_ros.io.printable import placed
from dotsim_ros.view.panels import Drawing, PanelImages
from dotsim_ros.view.sheet import strongest_stamps, write_sheet
from dotsim_ros.view.skin_map import read_rest_m
from dotsim_ros.view.timeline import ViewTopics, open_timeline
from dotsim_ros.view.video import GIF_WIDTH_PX, Board, usual_rate_hz, write_gif, write_video

LARGEST_GIF_FPS = 12.5
LARGEST_FRAME_COUNT = 100_000
"""An hour at 25 frames a second, which takes about as long to draw."""


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


def view_bag(
    path: Path,
    out: Path,
    warn: Callable[[str], None],
    *,
    topics: ViewTopics | None = None,
    formats: Collection[str] = ("mp4",),
    fps: float | None = None,
    speed: float = 1.0,
    column_count: int = 6,
    rest: Path | None = None,
) -> list[Path]:
    """Write the contact sheet and the videos of a bag, and return their paths.

    A bag that was not finished, or is cut short, is shown up to where it ends.

    Args:
        path: of the bag.
        out: folder of the files.
        warn: takes what is not shown and why, a sentence each.
        topics: those the user named.
        formats: of the video: any of "mp4" and "gif".
        fps: frames a second; None: those of the bag.
        speed: seconds of the bag in a second of the video.
        column_count: of the contact sheet.
        rest: .npz with `rest_position_m`, or None.

    Raises:
        FileNotFoundError: no such bag.
        ValueError: it cannot be read, is damaged, or shows nothing.
        OSError: a file could not be written; the one before it is left as it was.
    """
    with open_timeline(path, topics) as timeline, placed(path):
        for words in timeline.shortcomings():
            warn(words)
        stamp_ns, forces, title = timeline.stamp_ns, timeline.forces, bag_name(path)
        fps = fps or usual_rate_hz(stamp_ns)
        if formats:
            _check_length(stamp_ns, fps, speed)
        rest_m = None if rest is None else read_rest_m(rest)
        images = PanelImages(timeline.moments(), rest_m=rest_m)
        drawing = Drawing(images, forces, int(stamp_ns[0]), int(stamp_ns[-1]), title)
        chosen = set(strongest_stamps(stamp_ns, forces, count=column_count))
        sheet = out / f"{title}.png"
        write_sheet(sheet, (m for m in timeline.moments() if m.stamp_ns in chosen), drawing)
        written = [sheet]
        if not formats:
            return written
        with tempfile.TemporaryDirectory() as folder:
            video = (out if "mp4" in formats else Path(folder)) / f"{title}.mp4"
            write_video(video, timeline.moments(), Board(drawing), fps=fps, speed=speed)
            if "mp4" in formats:
                written.append(video)
            if "gif" in formats:
                gif = out / f"{title}.gif"
                write_gif(gif, video, fps=min(fps, LARGEST_GIF_FPS), width_px=GIF_WIDTH_PX)
                written.append(gif)
        return written
