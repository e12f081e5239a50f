# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A video of a bag: its panels side by side above a running force plot."""

from __future__ import annotations

import signal
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import IO

import cv2
import imageio_ffmpeg
import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.files import whole_file
from dotsim_ros.io.printable import boxes_for_missing_glyphs, figure_label
from dotsim_ros.view.panels import INK, STYLE, TITLES, Drawing
from dotsim_ros.view.timeline import BagMoment

PANELS = ("image", "depth", "skin")
WIDTH_PX, HEIGHT_PX = 1280, 720
DOTS_PER_INCH = 100
MARGIN_PX = 20
TITLE_PX = 34
LONGEST_PANEL_PX = 400
GIF_WIDTH_PX = 640
QUALITY = 10
"""Of H.264, where 0 is exact and 51 is worst."""


@dataclass(frozen=True)
class PanelPlace:
    """Where a panel lies on a frame, in pixels from the top left."""

    left: int
    top: int
    width: int
    height: int


def _places(shapes: dict[str, tuple[int, int]]) -> dict[str, PanelPlace]:
    names = [name for name in PANELS if name in shapes]
    aspects = [shapes[name][1] / shapes[name][0] for name in names]
    bar_px = 60
    free = WIDTH_PX - MARGIN_PX * (len(names) + 1) - bar_px * sum(n != "image" for n in names)
    height = min(LONGEST_PANEL_PX, int(free / sum(aspects)))
    used = sum(round(height * aspect) for aspect in aspects) + WIDTH_PX - free
    left = (WIDTH_PX - used) // 2 + MARGIN_PX
    places = {}
    for name, aspect in zip(names, aspects, strict=True):
        width = round(height * aspect)
        places[name] = PanelPlace(left, TITLE_PX + MARGIN_PX, width, height)
        left += width + MARGIN_PX + (0 if name == "image" else bar_px)
    return places


def _box(place: PanelPlace) -> tuple[float, float, float, float]:
    """Return a place as matplotlib has it: left, bottom, width, height as shares of the frame."""
    bottom = 1.0 - (place.top + place.height) / HEIGHT_PX
    return place.left / WIDTH_PX, bottom, place.width / WIDTH_PX, place.height / HEIGHT_PX


class Board:
    """The part of every frame that stays: titles, colour scales, the force plot."""

    def __init__(self, drawing: Drawing) -> None:
        self._drawing = drawing
        self._places = _places(drawing.images.shape_px)
        font = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
        self._font = ImageFont.truetype(str(font), 17)
        with matplotlib.rc_context(STYLE):
            self._draw()

    def _draw(self) -> None:
        figure = Figure(
            figsize=(WIDTH_PX / DOTS_PER_INCH, HEIGHT_PX / DOTS_PER_INCH), dpi=DOTS_PER_INCH
        )
        canvas = FigureCanvasAgg(figure)
        for name, place in self._places.items():
            figure.text(
                place.left / WIDTH_PX,
                1.0 - (place.top - 8) / HEIGHT_PX,
                TITLES[name],
                fontsize=12,
                va="bottom",
            )
            scale = self._drawing.images.colour_scale(name)
            if scale is not None:
                bar = replace(place, left=place.left + place.width + 8, width=12)
                figure.colorbar(scale, cax=figure.add_axes(_box(bar)))
        bottom = max(place.top + place.height for place in self._places.values())
        self._text_top = bottom + 10
        plot_top = bottom + 40
        plot_size = (WIDTH_PX - 80 - 2 * MARGIN_PX, HEIGHT_PX - plot_top - 56)
        plot = figure.add_axes(_box(PanelPlace(80, plot_top, *plot_size)))
        self._drawing.draw_forces(plot)
        figure.text(
            1.0 - 2 * MARGIN_PX / WIDTH_PX,
            1.0 - 8 / HEIGHT_PX,
            figure_label(self._drawing.title, 80),
            fontsize=11,
            ha="right",
            va="top",
        )
        with boxes_for_missing_glyphs():
            canvas.draw()
        self._background = np.asarray(canvas.buffer_rgba())[..., :3].copy()
        box = plot.get_window_extent()
        self._plot_rows = (round(HEIGHT_PX - box.y1), round(HEIGHT_PX - box.y0))
        self._plot_columns = (box.x0, box.x1)
        self._duration_s = plot.get_xlim()[1]

    def frame(self, moment: BagMoment) -> ImageArray:
        """Return the (720, 1280, 3) uint8 RGB frame of a moment."""
        frame = self._background.copy()
        for name, place in self._places.items():
            image = self._drawing.images.panel(name, moment)
            if image is None:
                continue
            shrinks = image.shape[1] > place.width
            frame[place.top : place.top + place.height, place.left : place.left + place.width] = (
                cv2.resize(
                    np.ascontiguousarray(image),
                    (place.width, place.height),
                    interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR,
                )
            )
        time_s = self._drawing.time_s(moment)
        left, right = self._plot_columns
        column = round(left + (right - left) * min(1.0, time_s / self._duration_s))
        top, bottom = self._plot_rows
        frame[top:bottom, column : column + 2] = (255, 212, 59)
        return self._captioned(frame, moment, time_s)

    def _captioned(self, frame: ImageArray, moment: BagMoment, time_s: float) -> ImageArray:
        caption = f"{time_s:6.2f} s"
        if self._drawing.forces is not None:
            x, y, z = self._drawing.forces.at(moment.stamp_ns)
            caption += f"     F = ({x:+.2f}, {y:+.2f}, {z:+.2f}) N"
        strip = Image.fromarray(frame[self._text_top : self._text_top + 26, :640].copy())
        ImageDraw.Draw(strip).text((80, 0), caption, font=self._font, fill=INK)
        frame[self._text_top : self._text_top + 26, :640] = np.asarray(strip)
        return frame


def paced(moments: Iterable[BagMoment], *, fps: float, speed: float) -> Iterator[BagMoment]:
    """Yield the moment that is current at each frame of a video, `speed` seconds of the bag in one
    of it."""
    step_ns = speed * 1e9 / fps
    next_ns: float | None = None
    last: BagMoment | None = None
    for last, following in pairwise(_with_end(moments)):
        if last is None:
            continue
        next_ns = float(last.stamp_ns) if next_ns is None else next_ns
        if following is None:
            yield last
            return
        while next_ns < following.stamp_ns:
            yield last
            next_ns += step_ns


def _with_end(moments: Iterable[BagMoment]) -> Iterator[BagMoment | None]:
    yield from moments
    yield None


def usual_rate_hz(stamps_ns: NDArray[np.int64]) -> float:
    """Return the usual number of moments a second, at least 10 and at most 60."""
    if len(stamps_ns) < 2:
        return 10.0
    return float(np.clip(np.round(1e9 / np.median(np.diff(stamps_ns))), 10.0, 60.0))


def write_video(
    path: str | Path, moments: Iterable[BagMoment], board: Board, *, fps: float, speed: float = 1.0
) -> int:
    """Write an MP4 (H.264), whole or not at all, and return its number of frames.

    Raises:
        OSError: ffmpeg could not; the message ends with what it said last.
    """
    count = 0
    with whole_file(path) as temporary, _ffmpeg(_encoding(temporary, fps), path) as stream:
        for moment in paced(moments, fps=fps, speed=speed):
            stream.write(np.ascontiguousarray(board.frame(moment)).data)
            count += 1
    return count


def _encoding(path: Path, fps: float) -> list[str]:
    """Return ffmpeg's arguments: frames come from its standard input."""
    return [
        *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{WIDTH_PX}x{HEIGHT_PX}"),
        *("-r", f"{fps:.6f}", "-i", "-", "-an"),
        # Chroma of half the size is what most players take.
        *("-c:v", "libx264", "-crf", str(QUALITY), "-pix_fmt", "yuv420p", str(path)),
    ]


@contextmanager
def _ffmpeg(arguments: list[str], path: str | Path) -> Iterator[IO[bytes]]:
    """Run ffmpeg and yield its standard input.

    Raises:
        OSError: it failed; the text ends with what it said last.
    """
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-y", *arguments]
    with tempfile.TemporaryFile() as said:
        # In a session of its own: a Ctrl-C at the terminal is ours to handle.
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=said,
            start_new_session=True,
        )
        assert process.stdin is not None
        takes_all = False
        try:
            # An ffmpeg that has ended takes no more frames; what it said tells why.
            with suppress(BrokenPipeError):
                yield process.stdin
                process.stdin.close()
                takes_all = True
            status = process.wait()
        except BaseException:
            process.kill()
            process.wait()
            raise
        if status != 0 or not takes_all:
            said.seek(0)
            lines = said.read().decode(errors="replace").split("\n")
            last = [line for line in lines if line.strip()][-1:] or [_ending(status)]
            raise OSError(f"{path} could not be written: ffmpeg: {last[0].strip()}")


def _ending(status: int) -> str:
    return f"ended by {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"


def write_gif(path: str | Path, video: str | Path, *, fps: float, width_px: int) -> None:
    """Write an animated GIF of a video, with a palette of its own, whole or not at all.

    Raises:
        OSError: ffmpeg could not; the message ends with what it said last.
    """
    graph = (
        f"fps={fps:g},scale={width_px}:-1:flags=lanczos,split[a][b];"
        "[a]palettegen=stats_mode=diff[p];[b][p]paletteuse=dither=bayer:bayer_scale=4"
    )
    with whole_file(path) as temporary:
        arguments = ["-i", str(video), "-filter_complex", graph, str(temporary)]
        with _ffmpeg(arguments, path):
            pass
