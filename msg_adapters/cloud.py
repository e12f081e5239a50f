# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""sensor_msgs/PointCloud2 as arrays: points with optional normals and displacements."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msg_adapters.stamps import encode_header
from msg_adapters.types import ROS, Message, MessageTypes

FIELD_TYPES: dict[int, np.dtype[Any]] = {
    1: np.dtype(np.int8),
    2: np.dtype(np.uint8),
    3: np.dtype(np.int16),
    4: np.dtype(np.uint16),
    5: np.dtype(np.int32),
    6: np.dtype(np.uint32),
    7: np.dtype(np.float32),
    8: np.dtype(np.float64),
}
"""Type of a field by its sensor_msgs/PointField constant."""

FLOAT32 = 7
POSITION = ("x", "y", "z")
NORMAL = ("normal_x", "normal_y", "normal_z")
DISPLACEMENT = ("displacement_x", "displacement_y", "displacement_z")
PIXEL = ("u", "v")
PIXEL_DISPLACEMENT = ("displacement_u", "displacement_v")


@dataclass(frozen=True)
class Cloud:
    """Points of a cloud, with their optional normals, displacements and places in an image.

    Attributes:
        position: (N, 3) metres.
        normal: (N, 3) unit vectors, or None.
        displacement: (N, 3) metres from the place at rest, or None.
        pixel: (N, 2) x and y in an image, or None.
        pixel_displacement: (N, 2) pixels from the place at rest, or None.
    """

    position: NDArray[Any]
    normal: NDArray[Any] | None
    displacement: NDArray[Any] | None
    pixel: NDArray[Any] | None = None
    pixel_displacement: NDArray[Any] | None = None


def encode_cloud(
    position_m: ArrayLike,
    *,
    normal: ArrayLike | None = None,
    displacement_m: ArrayLike | None = None,
    pixel: ArrayLike | None = None,
    pixel_displacement: ArrayLike | None = None,
    stamp_ns: int,
    frame_id: str,
    types: MessageTypes = ROS,
) -> Message:
    """Return an unordered sensor_msgs/PointCloud2 of float32 fields without padding.

    Fields x, y, z, then normal_x, normal_y, normal_z, displacement_x, displacement_y,
    displacement_z, u, v, and displacement_u, displacement_v where given. `is_dense` says whether
    every position is finite.

    Args:
        position_m: (N, 3).
        normal: (N, 3) or None.
        displacement_m: (N, 3) or None.
        pixel, pixel_displacement: (N, 2) or None.
        stamp_ns: time of acquisition.
        frame_id: frame of points and vectors.
        types: of the message: an installed ROS or a bag's type store.

    Raises:
        ValueError: an array of another shape.
    """
    named = [
        (POSITION, position_m),
        (NORMAL, normal),
        (DISPLACEMENT, displacement_m),
        (PIXEL, pixel),
        (PIXEL_DISPLACEMENT, pixel_displacement),
    ]
    groups = [(names, np.asarray(values)) for names, values in named if values is not None]
    count = len(groups[0][1])
    for names, values in groups:
        expected = (count, len(names))
        if values.shape != expected:
            raise ValueError(f"cloud field {names[0]} needs shape {expected}, got {values.shape}")
    table = np.concatenate([values for _, values in groups], axis=1, dtype=np.float32)
    fields = [
        types.make(
            "sensor_msgs/msg/PointField", name=name, offset=4 * index, datatype=FLOAT32, count=1
        )
        for index, name in enumerate(name for names, _ in groups for name in names)
    ]
    point_step = 4 * table.shape[1]
    return types.make(
        "sensor_msgs/msg/PointCloud2",
        header=encode_header(stamp_ns, frame_id, types=types),
        height=1,
        width=count,
        fields=fields,
        is_bigendian=sys.byteorder == "big",
        point_step=point_step,
        row_step=point_step * count,
        data=types.octets(table),
        is_dense=bool(np.isfinite(table[:, :3]).all()),
    )


def cloud_dtype(message: Message) -> np.dtype[Any]:
    """Return the structured type of one point of a PointCloud2, padding included.

    Raises:
        ValueError: a field of unknown type, named twice, or that reaches beyond the point.
    """
    order: Literal["<", ">"] = ">" if message.is_bigendian else "<"
    names, formats, offsets = [], [], []
    for field in message.fields:
        if field.datatype not in FIELD_TYPES:
            raise ValueError(f"cloud field {field.name!r} has unknown type {field.datatype}")
        if field.name in names:
            raise ValueError(f"cloud field {field.name!r} is there twice")
        base = FIELD_TYPES[field.datatype].newbyteorder(order)
        # Older publishers leave `count` at 0 where they mean 1.
        count = max(1, int(field.count))
        end = int(field.offset) + count * base.itemsize
        if end > message.point_step:
            raise ValueError(
                f"cloud field {field.name!r} ends at byte {end} of a point of "
                f"{message.point_step} bytes"
            )
        kind = np.dtype((base, (count,))) if count > 1 else base
        names.append(field.name)
        formats.append(kind)
        offsets.append(int(field.offset))
    layout: dict[str, Any] = {
        "names": names,
        "formats": formats,
        "offsets": offsets,
        "itemsize": int(message.point_step),
    }
    return np.dtype(layout)  # type: ignore[call-overload]


def decode_cloud_fields(message: Message) -> NDArray[Any]:
    """Return all fields of a PointCloud2 as a (height * width,) structured array.

    A view of the message's data, unless its rows are padded.

    Raises:
        ValueError: as `cloud_dtype`, or a length of data other than row_step * height.
    """
    dtype = cloud_dtype(message)
    height, width, row_step = int(message.height), int(message.width), int(message.row_step)
    row = width * dtype.itemsize
    if row_step < row:
        raise ValueError(f"cloud row_step of {row_step} bytes is too short for {width} points")
    data = np.frombuffer(message.data, dtype=np.uint8)
    if data.size != row_step * height:
        raise ValueError(
            f"cloud holds {data.size} bytes, expected row_step * height = {row_step} * {height} = "
            f"{row_step * height}"
        )
    if data.size == 0 or row == 0:
        return np.empty(0, dtype=dtype)
    rows = data.reshape(height, row_step)[:, :row]
    return rows.reshape(-1).view(dtype)


def _vectors(points: NDArray[Any], names: tuple[str, ...]) -> NDArray[Any] | None:
    fields: Mapping[str, Any] = points.dtype.fields or {}
    if not set(names) <= set(fields):
        return None
    kind, first = fields[names[0]][:2]
    packed = all(
        fields[name][:2] == (kind, first + index * kind.itemsize)
        for index, name in enumerate(names)
    )
    if not packed or len(points) == 0:
        return np.stack([points[name] for name in names], axis=1)
    return np.ndarray(
        (len(points), len(names)),
        kind,
        points,
        offset=first,
        strides=(points.strides[0], kind.itemsize),
    )


def decode_cloud(message: Message) -> Cloud:
    """Return the points of a PointCloud2 of any layout, as views where x, y, z lie together.

    Raises:
        ValueError: as `decode_cloud_fields`; no field x, y or z; or a cloud that calls itself
            dense and has a position that is not finite.
    """
    points = decode_cloud_fields(message)
    position = _vectors(points, POSITION)
    if position is None:
        raise ValueError(f"cloud has fields {list(points.dtype.names or ())}, expected x, y and z")
    if message.is_dense and not np.isfinite(position).all():
        raise ValueError("cloud is marked is_dense but holds a position that is not finite")
    return Cloud(
        position,
        _vectors(points, NORMAL),
        _vectors(points, DISPLACEMENT),
        _vectors(points, PIXEL),
        _vectors(points, PIXEL_DISPLACEMENT),
    )
