# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""MP4 files of images, written one image after the other."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

from dotsim_ros.io.arrays import ImageArray

CODEC = "libx264"
OPTIONS = {"g": "2", "crf": "16", "preset": "ultrafast", "threads": "1"}
"""Every second image stands alone, so that any is found fast. Of noisy images with printed markers
the mean error is 2 grey levels of 255."""
PIXELS = "yuv444p"
"""Colours as fine as the light: markers keep their edges, and the files are no larger."""


class VideoFile:
    """An MP4 file that grows by one image at a time.

    Args:
        path: of the file.
        size_px: width and height.
        fps: images a second.
    """

    def __init__(self, path: Path, size_px: tuple[int, int], fps: float) -> None:
        # An optional dependency; whoever opens a data set has checked for it.
        import av

        path.parent.mkdir(parents=True, exist_ok=True)
        self._frame_of = av.VideoFrame.from_ndarray
        self._container: Any = av.open(str(path), "w")
        rate = Fraction(fps).limit_denominator(1000)
        stream = self._container.add_stream(CODEC, rate=rate, options=OPTIONS)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height = size_px
        stream.pix_fmt = PIXELS
        self._stream = stream

    def add(self, image: ImageArray) -> None:
        """Append an image (H, W, 3), red, green, blue."""
        self._container.mux(self._stream.encode(self._frame_of(image, format="rgb24")))

    def close(self) -> None:
        """Write what is left."""
        try:
            self._container.mux(self._stream.encode())
        finally:
            self._container.close()

    def information(self, fps: float) -> dict[str, Any]:
        """Return what a data set says of its videos."""
        return {
            "video.height": self._stream.height,
            "video.width": self._stream.width,
            "video.codec": "h264",
            "video.pix_fmt": PIXELS,
            "video.is_depth_map": False,
            "video.fps": fps,
            "video.channels": 3,
            "has_audio": False,
        }
