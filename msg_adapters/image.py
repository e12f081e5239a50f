"""sensor_msgs/Image and CompressedImage as arrays of pixels."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.stamps import encode_header
from msg_adapters.types import ROS, Message, MessageTypes

PIXEL_LAYOUTS: dict[str, tuple[np.dtype[Any], int]] = {
    "rgb8": (np.dtype(np.uint8), 3),
    "bgr8": (np.dtype(np.uint8), 3),
    "mono8": (np.dtype(np.uint8), 1),
    "32FC1": (np.dtype(np.float32), 1),
}
"""Type of a channel and number of channels, by encoding."""

COMPRESSED_SUFFIXES = {"png": ".png", "jpeg": ".jpg"}


def _layout(encoding: str) -> tuple[np.dtype[Any], int]:
    if encoding not in PIXEL_LAYOUTS:
        known = ", ".join(PIXEL_LAYOUTS)
        raise ValueError(
            f"image encoding {encoding!r} is not supported; expected one of {known}"
            + ("; the publisher must set the encoding" if not encoding else "")
        )
    return PIXEL_LAYOUTS[encoding]


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
        pixels: (H, W, 3) uint8 for rgb8 and bgr8, (H, W) uint8 for mono8, (H, W) float32 for
            32FC1 (metres, NaN where invalid: REP 117 and 118).
        encoding: one of `PIXEL_LAYOUTS`.
        stamp_ns: time of acquisition.
        frame_id: optical frame.
        types: of the message: an installed ROS or a bag's type store.

    Raises:
        ValueError: unknown encoding, or pixels of another shape or type.
    """
    dtype, channels = _layout(encoding)
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
        mono8, (H, W) float32 for 32FC1 (in the message's byte order).

    Raises:
        ValueError: unknown encoding, no pixels, a row shorter than its pixels, or a length of data
            other than step * height.
    """
    dtype, channels = _layout(message.encoding)
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
    if data.size != step * height:
        raise ValueError(
            f"image holds {data.size} bytes, expected step * height = {step} * {height} = "
            f"{step * height}"
        )
    if dtype.itemsize > 1:
        dtype = dtype.newbyteorder(">" if message.is_bigendian else "<")
    rows = data.reshape(height, step)[:, :row]
    if channels > 1:
        return rows.reshape(height, width, channels)
    return rows.view(dtype)


def decode_rgb(message: Message) -> NDArray[np.uint8]:
    """Return the (H, W, 3) uint8 RGB pixels of an Image in rgb8, bgr8 or mono8.

    A view for rgb8 and bgr8.

    Raises:
        ValueError: as `decode_image`, or an encoding that holds no colour.
    """
    if message.encoding == "32FC1":
        raise ValueError("image encoding '32FC1' holds depth, expected rgb8, bgr8 or mono8")
    pixels = decode_image(message)
    if message.encoding == "bgr8":
        return pixels[..., ::-1]
    if message.encoding == "mono8":
        return np.repeat(pixels[..., None], 3, axis=2)
    return pixels


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
    # PNG at level 1: a third of the time of the default for a tenth more bytes.
    options = (
        [cv2.IMWRITE_PNG_COMPRESSION, 1]
        if compression == "png"
        else [cv2.IMWRITE_JPEG_QUALITY, quality]
    )
    stored = np.ascontiguousarray(pixels[..., ::-1] if is_colour else pixels)
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


def decode_compressed_image(message: Message) -> NDArray[np.uint8]:
    """Return the (H, W, 3) uint8 RGB or (H, W) uint8 grey pixels of a CompressedImage.

    Raises:
        ValueError: the data is empty or no image that OpenCV reads.
    """
    import cv2

    data = np.frombuffer(message.data, dtype=np.uint8)
    pixels = cv2.imdecode(data, cv2.IMREAD_ANYCOLOR) if data.size else None
    if pixels is None:
        raise ValueError(
            f"compressed image of {data.size} bytes (format {message.format!r}) cannot be read; "
            "expected a whole PNG or JPEG file"
        )
    decoded = np.asarray(pixels, dtype=np.uint8)
    return decoded[..., ::-1] if decoded.ndim == 3 else decoded
