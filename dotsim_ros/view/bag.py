"""From a bag to its video and contact sheet."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.measured.bag import BagReader
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
    with np.load(path, allow_pickle=False) as arrays:
        if "rest_position_m" not in arrays:
            raise ValueError(f"{path} has no array rest_position_m")
        return np.asarray(arrays["rest_position_m"], dtype=np.float64)


def view_bag(request: ViewRequest) -> list[Path]:
    """Write the files that are asked for and return their paths.

    Raises:
        FileNotFoundError: no such bag.
        ValueError: it cannot be read, or shows nothing.
    """
    with BagReader(request.bag) as reader:
        topics = find_topics(reader.topics(), given=request.topics)
    stamps_ns = read_stamps(request.bag, topics)
    if stamps_ns.size == 0:
        raise ValueError(f"{request.bag} shows nothing: no image, no depth and no skin")
    forces = read_forces(request.bag, topics.wrench)
    images = PanelImages(iterate_moments(request.bag, topics), rest_m=_rest_m(request.rest))
    start_ns, end_ns = int(stamps_ns[0]), int(stamps_ns[-1])
    title = request.bag.resolve().stem
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
        fps = request.fps or usual_rate_hz(stamps_ns)
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
