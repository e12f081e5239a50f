# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Messages as they come over the wire: decoded to finite arrays, or refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

import msg_adapters
from dotsim_ros.data.bag import BAG_TYPES, TYPESTORE, BagMessage
from fuzz.mutate import spoilt_bytes
from fuzz.target import Finding, Target, answer

Decode = Callable[[Any], Any]


def _messages(_folder: Path) -> list[tuple[str, bytes, Decode]]:
    """Return one serialised message of each kind that is read, with its decoder."""
    image = np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3)
    points = np.linspace(0.0, 1e-2, 30).reshape(10, 3)
    quaternion = np.array([0.0, 0.0, 0.0, 1.0])
    vector = np.array([1.0, 2.0, 3.0])
    head: Any = {"stamp_ns": 1_000_000_000, "frame_id": "base", "types": BAG_TYPES}
    made: list[tuple[Any, Decode]] = [
        (msg_adapters.encode_image(image, encoding="rgb8", **head), msg_adapters.decode_rgb),
        (
            msg_adapters.encode_image(np.ones((3, 5), np.float32), encoding="32FC1", **head),
            msg_adapters.decode_image,
        ),
        (
            msg_adapters.encode_compressed_image(image, compression="png", **head),
            msg_adapters.decode_compressed_image,
        ),
        (msg_adapters.encode_cloud(points, **head), msg_adapters.decode_cloud),
        (
            msg_adapters.encode_pose_stamped(vector, quaternion, **head),
            msg_adapters.decode_pose_stamped,
        ),
        (
            msg_adapters.encode_wrench_stamped(vector, vector, **head),
            msg_adapters.decode_wrench_stamped,
        ),
        (
            msg_adapters.encode_twist_stamped(vector, vector, **head),
            msg_adapters.decode_twist_stamped,
        ),
    ]
    return [
        (m.__msgtype__, bytes(TYPESTORE.serialize_cdr(m, m.__msgtype__)), decode)
        for m, decode in made
    ]


def _attempt(kinds: list[tuple[str, bytes, Decode]], random: Random, _folder: Path) -> None:
    kind, content, decode = random.choice(kinds)
    message = BagMessage("/topic", kind, 0, spoilt_bytes(content, random))
    read = answer(message.message, ["/topic"])
    if read is None:
        return
    # What these say is put behind the name of the topic by their callers.
    decoded = answer(lambda: decode(read), [""])
    # A message is stamped by its sender: any time is one, and callers look at it.
    answer(lambda: msg_adapters.message_stamp_ns(read), [""])
    if decoded is None:
        return
    arrays = decoded if isinstance(decoded, tuple) else (getattr(decoded, "position", decoded),)
    for array in arrays:
        is_float = array.dtype.kind == "f" and not kind.endswith(("Image", "PointCloud2"))
        if is_float and not np.isfinite(array).all():
            raise Finding(f"{kind} gave {array}")


TARGETS = (Target("message", _messages, _attempt),)
