# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""sensor_msgs/Image and CompressedImage as arrays of pixels."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.stamps import encode_header
from msg_adapters.types import ROS, Message, MessageTypes

PIXEL_LAYOUTS: dict[str, tuple[np.dtype[Any], int]] = {
    "rgb8": (np.dtype(np.uint8), 3),
    "bgr8": (np.dtype(np.uint8), 3),
    "mono8": (np.dtype(np.uint8), 1),
    "8UC1": (np.dtype(np.uint8), 1),
    "32FC1": (np.dtype(np.float32), 1),
}
"""Type of a channel and number of channels, by encoding, of what this package writes."""
CAMERA_LAYOUTS: dict[str, tuple[np.dtype[Any], int]] = {
    "rgba8": (np.dtype(np.uint8), 4),
    "bgra8": (np.dtype(np.uint8), 4),
    "rgb16": (np.dtype(np.uint16), 3),
    "bgr16": (np.dtype(np.uint16), 3),
    "mono16": (np.dtype(np.uint16), 1),
    **dict.fromkeys(("yuv422", "uyvy", "yuv422_yuy2", "yuyv"), (np.dtype(np.uint8), 2)),
    **dict.fromkeys(("nv12", "nv21"), (np.dtype(np.uint8), 1)),
    **{
        f"bayer_{pattern}{bits}": (np.dtype(f"uint{bits}"), 1)
        for pattern in ("rggb", "bggr", "gbrg", "grbg")
        for bits in (8, 16)
    },
}
"""The same of what drivers of cameras publish besides: sensor_msgs/image_encodings.hpp, and the
planes of NV12 and NV21 below each other."""

COMPRESSED_SUFFIXES = {"png": ".png", "jpeg": ".jpg"}
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
HEADER_BYTES = 2**18
"""What is looked at for an image's size: a JPEG may have a few segments of 64 KiB before it."""
LARGEST_PIXEL_COUNT = 2**26
"""Of a file that is unpacked: a few bytes may announce gigabytes."""


def _layout(
    encoding: str, layouts: Mapping[str, tuple[np.dtype[Any], int]]
) -> tuple[np.dtype[Any], int]:
    if encoding not in layouts:
        known = ", ".join(layouts)
        raise ValueError(
            f"image encoding {encoding[:40]!r} is not supported; expected one of {known}"
            + ("; the publisher must set the encoding" if not encoding else "")
        )
    return layouts[encoding]


def encode_image(
    pixels: NDArray[Any],
    *,
    encoding: str,
    stamp_ns: int,
    frame_id: str,
    types: MessageTypes = ROS,
) -> Message:
    """Return a sensor_msgs/Image of pixels that are in the order of `encoding` already.

    Args:
        pixels: (H, W, 3) uint8 for rgb8 and bgr8, (H, W) uint8 for mono8 and 8UC1 (numbers
            that are no grey levels), (H, W) float32 for 32FC1 (metres, NaN where invalid: REP 117
            and 118).
        encoding: one of `PIXEL_LAYOUTS`.
        stamp_ns: time of acquisition.
        frame_id: optical frame.
        types: of the message: an installed ROS or a bag's type store.

    Raises:
        ValueError: unknown encoding, or pixels of another shape or type.
    """
    dtype, channels = _layout(encoding, PIXEL_LAYOUTS)
    pixels = np.asarray(pixels)
    shape_is_right = pixels.ndim == (3 if channels > 1 else 2) and 0 not in pixels.shape
    if not shape_is_right or (channels > 1 and pixels.shape[2] != channels):
        expected = "(H, W, 3)" if channels > 1 else "(H, W)"
        raise ValueError(f"{encoding} needs pixels of shape {expected}, got {pixels.shape}")
    if pixels.dtype != dtype:
        raise ValueError(f"{encoding} needs pixels of type {dtype}, got {pixels.dtype}")
    contiguous = np.ascontiguousarray(pixels)
    return types.make(
        "sensor_msgs/msg/Image",
        header=encode_header(stamp_ns, frame_id, types=types),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=int(sys.byteorder == "big"),
        step=pixels.shape[1] * channels * dtype.itemsize,
        data=types.octets(contiguous),
    )


def decode_image(message: Message) -> NDArray[Any]:
    """Return the pixels of a sensor_msgs/Image, a view of the message's own data.

    Returns:
        (H, W, 3) uint8 in the order of the message's encoding for rgb8 and bgr8, (H, W) uint8 for
        mono8 and 8UC1, (H, W) float32 for 32FC1 (in the message's byte order).

    Raises:
        ValueError: unknown encoding, no pixels, a row shorter than its pixels, or a length of data
            other than step * height.
    """
    return _samples(message, int(message.height), *_layout(message.encoding, PIXEL_LAYOUTS))


def _samples(message: Message, row_count: int, dtype: np.dtype[Any], channels: int) -> NDArray[Any]:
    """Return the (row_count, W, channels) numbers of an image, (row_count, W) of one channel."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    if height == 0 or width == 0:
        raise ValueError(f"image of {width} x {height} pixels is empty")
    row = width * channels * dtype.itemsize
    if step < row:
        raise ValueError(
            f"image step of {step} bytes is too short: {width} pixels of {message.encoding} take "
            f"{row}"
        )
    data = np.frombuffer(message.data, dtype=np.uint8)
    if data.size != step * row_count:
        rows_named = "height" if row_count == height else "rows"
        raise ValueError(
            f"image holds {data.size} bytes, expected step * {rows_named} = {step} * {row_count} "
            f"= {step * row_count}"
        )
    if dtype.itemsize > 1:
        dtype = dtype.newbyteorder(">" if message.is_bigendian else "<")
    samples = data.reshape(row_count, step)[:, :row].view(dtype)
    return samples.reshape(row_count, width, channels) if channels > 1 else samples


def decode_rgb(message: Message) -> NDArray[np.uint8]:
    """Return the (H, W, 3) uint8 RGB pixels of an Image of a camera.

    Any encoding of `PIXEL_LAYOUTS` and `CAMERA_LAYOUTS` but depths. 16 bits are scaled to 8, YUV is
    taken as BT.601 of limited range, and missing colours of a Bayer pattern are interpolated, all
    as OpenCV does it. A view for rgb8 and rgba8.

    Raises:
        ValueError: as `decode_image`, an encoding that holds no colour, or sides that are odd
            where two pixels share a colour.
    """
    encoding = message.encoding
    if encoding in ("32FC1", "8UC1"):
        raise ValueError(f"image encoding {encoding!r} holds depth, expected colours or grey")
    layout = _layout(encoding, PIXEL_LAYOUTS | CAMERA_LAYOUTS)
    height, width = int(message.height), int(message.width)
    is_planar = encoding in ("nv12", "nv21")
    is_shared = is_planar or layout[1] == 2
    if is_shared and (width % 2 or (is_planar and height % 2)):
        raise ValueError(f"{encoding} needs even sides, the image has {width} x {height} pixels")
    samples = _samples(message, height * 3 // 2 if is_planar else height, *layout)
    if samples.dtype.itemsize == 2:
        # 65535 becomes 255.
        samples = ((samples.astype(np.uint32) + 128) // 257).astype(np.uint8)
    if is_shared or encoding.startswith(("bayer", "bgr")):
        return _converted(samples, encoding)
    if samples.ndim == 2:
        return np.repeat(samples[..., None], 3, axis=2)
    return samples[..., :3]


def _converted(samples: NDArray[np.uint8], encoding: str) -> NDArray[np.uint8]:
    import cv2

    codes = {
        "yuv422": cv2.COLOR_YUV2RGB_UYVY,
        "uyvy": cv2.COLOR_YUV2RGB_UYVY,
        "yuv422_yuy2": cv2.COLOR_YUV2RGB_YUY2,
        "yuyv": cv2.COLOR_YUV2RGB_YUY2,
        "nv12": cv2.COLOR_YUV2RGB_NV12,
        "nv21": cv2.COLOR_YUV2RGB_NV21,
        "bgr": cv2.COLOR_BGR2RGB,
        "bgra": cv2.COLOR_BGRA2RGB,
        # OpenCV names a pattern by its second row from the second pixel on.
        "bayer_rggb": cv2.COLOR_BayerBG2RGB,
        "bayer_bggr": cv2.COLOR_BayerRG2RGB,
        "bayer_gbrg": cv2.COLOR_BayerGR2RGB,
        "bayer_grbg": cv2.COLOR_BayerGB2RGB,
    }
    code = codes[encoding.removesuffix("16").removesuffix("8")]
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(samples), code), dtype=np.uint8)


def encode_compressed_image(
    pixels: NDArray[np.uint8],
    *,
    compression: str,
    stamp_ns: int,
    frame_id: str,
    quality: int = 95,
    types: MessageTypes = ROS,
) -> Message:
    """Return a sensor_msgs/CompressedImage whose file shows the right colours in any viewer.

    Its `format` is that of compressed_image_transport: "rgb8; png compressed bgr8", where bgr8 is
    the order of the channels that OpenCV reads.

    Args:
        pixels: (H, W, 3) uint8 RGB, or (H, W) uint8 grey.
        compression: "png" (exact) or "jpeg".
        stamp_ns: time of acquisition.
        frame_id: optical frame.
        quality: of JPEG, 1 to 100.
        types: of the message: an installed ROS or a bag's type store.

    Raises:
        ValueError: unknown compression, or pixels of another shape or type.
    """
    import cv2

    if compression not in COMPRESSED_SUFFIXES:
        raise ValueError(f"compression {compression!r} is not supported; expected png or jpeg")
    pixels = np.asarray(pixels)
    is_colour = pixels.ndim == 3 and pixels.shape[2] == 3
    if not (is_colour or pixels.ndim == 2) or pixels.dtype != np.uint8 or pixels.size == 0:
        raise ValueError(
            f"compression needs uint8 pixels of shape (H, W, 3) or (H, W), got {pixels.dtype} "
            f"{pixels.shape}"
        )
    # Of PNG OpenCV's own, for speed: a level, even its own one, doubles the time.
    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if compression == "jpeg" else []
    stored = np.ascontiguousarray(pixels)
    if is_colour:
        # Fifty times as fast as a copy of the reversed array.
        stored = np.asarray(cv2.cvtColor(stored, cv2.COLOR_RGB2BGR), dtype=np.uint8)
    done, encoded = cv2.imencode(COMPRESSED_SUFFIXES[compression], stored, options)
    if not done:
        raise ValueError(f"OpenCV cannot write {pixels.shape} pixels as {compression}")
    kind = (
        f"rgb8; {compression} compressed bgr8" if is_colour else f"mono8; {compression} compressed"
    )
    return types.make(
        "sensor_msgs/msg/CompressedImage",
        header=encode_header(stamp_ns, frame_id, types=types),
        format=kind,
        data=types.octets(encoded.reshape(-1)),
    )


def compressed_image_size(message: Message) -> tuple[int, int]:
    """Return width and height that the file in a CompressedImage announces, without unpacking it.

    Raises:
        ValueError: it is no PNG or JPEG file, or has more than `LARGEST_PIXEL_COUNT` pixels.
    """
    data = bytes(memoryview(message.data)[:HEADER_BYTES])
    size = _png_size(data) if data.startswith(PNG_SIGNATURE) else _jpeg_size(data)
    if size is None or 0 in size:
        raise ValueError(
            f"compressed image of {len(message.data)} bytes (format {message.format[:40]!r}) "
            "cannot be read; expected a whole PNG or JPEG file"
        )
    if size[0] * size[1] > LARGEST_PIXEL_COUNT:
        raise ValueError(
            f"compressed image of {size[0]} x {size[1]} pixels, expected at most "
            f"{LARGEST_PIXEL_COUNT} pixels"
        )
    return size


def _has_end(data: bytes) -> bool:
    """Return whether a PNG or JPEG file is there up to its end.

    Of a JPEG file that is cut off OpenCV makes an image that is grey where nothing came. Its end
    may be followed by other bytes; before it that sequence stands in no packed pixels.
    """
    return data.rfind(b"IEND" if data.startswith(PNG_SIGNATURE) else b"\xff\xd9") > 0


def _png_size(data: bytes) -> tuple[int, int] | None:
    if len(data) < 24 or data[12:16] != b"IHDR":
        return None
    return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Return the size in the first header of a frame; before it lie segments of given lengths."""
    place = 2
    if data[:2] != b"\xff\xd8":
        return None
    while place + 9 <= len(data) and data[place] == 0xFF:
        marker = data[place + 1]
        if marker == 0xFF:
            place += 1
        elif 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height = int.from_bytes(data[place + 5 : place + 7], "big")
            return int.from_bytes(data[place + 7 : place + 9], "big"), height
        else:
            place += 2 + int.from_bytes(data[place + 2 : place + 4], "big")
    return None


def decode_compressed_image(message: Message) -> NDArray[np.uint8]:
    """Return the (H, W, 3) uint8 RGB or (H, W) uint8 grey pixels of a CompressedImage.

    Raises:
        ValueError: as `compressed_image_size`, or the file is broken.
    """
    import cv2

    compressed_image_size(message)
    data = np.frombuffer(message.data, dtype=np.uint8)
    try:
        pixels = cv2.imdecode(data, cv2.IMREAD_ANYCOLOR) if _has_end(bytes(message.data)) else None
    except cv2.error:
        pixels = None
    if pixels is None:
        raise ValueError(
            f"compressed image of {data.size} bytes (format {message.format[:40]!r}) is broken; "
            "expected a whole PNG or JPEG file"
        )
    is_colour = pixels.ndim == 3
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB) if is_colour else pixels, np.uint8)
