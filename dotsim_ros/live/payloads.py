# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What goes over the wire to a page: a header of JSON, then arrays and files as bytes.

A payload is the length of the header (uint32, little-endian), the header, and the parts that its
`parts` lists as [name, offset, length, type], offsets counted from the end of the header. Header
and parts begin at multiples of four bytes, so that the page reads arrays where they lie.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.arrays import ImageArray
from dotsim_ros.geometry.surface import indenter_surface
from dotsim_ros.live.moments import Picture, Scene, SkinMoment
from dotsim_ros.view.panels import DEPTH_COLOURS, coloured

ALIGNED = 4
SURFACE_STEP_M = 0.5e-3
"""Length of the edges of a drawn indenter."""
SKIN_MAP_COLOURS = "magma_r"
"""Pale at rest, as silicone is, and darker the farther the skin has moved."""
JPEG_QUALITY = 88
DEPTH_STRIDE = 2
"""Depth is drawn from every second pixel of every second row."""

LEAST_ROOM_M = 2e-3

Kind = str
"""What a payload holds: one of scene, state, history, skin, picture."""


def packed(kind: Kind, header: Mapping[str, Any], parts: Mapping[str, Any] | None = None) -> bytes:
    """Return a payload.

    Args:
        kind: what it holds.
        header: values that JSON has.
        parts: float32, uint32 or uint8 arrays, or bytes of a JPEG file, by name.
    """
    listed: list[tuple[str, int, int, str]] = []
    blobs: list[bytes] = []
    offset = 0
    for name, part in (parts or {}).items():
        content = part if isinstance(part, bytes) else np.ascontiguousarray(part).tobytes()
        form = "jpeg" if isinstance(part, bytes) else str(part.dtype)
        listed.append((name, offset, len(content), form))
        blobs.append(content + bytes(-len(content) % ALIGNED))
        offset += len(blobs[-1])
    text = json.dumps({"kind": kind, **header, "parts": listed}, allow_nan=False).encode()
    text += b" " * (-len(text) % ALIGNED)
    return b"".join([len(text).to_bytes(4, "little"), text, *blobs])


def scene_payload(scene: Scene) -> bytes:
    """Return what a page needs to draw the moments of a scene."""
    parts: dict[str, Any] = {
        "rest": scene.rest_m.astype(np.float32),
        "triangles": np.asarray(scene.triangles).astype(np.uint32),
        "colours": coloured(np.linspace(0.0, 1.0, 256), 0.0, 1.0, SKIN_MAP_COLOURS),
    }
    if scene.indenter is not None:
        surface = indenter_surface(scene.indenter, SURFACE_STEP_M)
        parts["indenter"] = surface.vertices_m.astype(np.float32)
        parts["indenter_triangles"] = surface.triangles.astype(np.uint32)
    return packed("scene", {"depth_m": scene.depth_m}, parts)


def skin_payload(moment: SkinMoment) -> bytes:
    """Return a moment of the skin."""
    pose = moment.pose
    header = {
        "stamp_s": 1e-9 * moment.stamp_ns,
        "force_n": None if moment.force_n is None else moment.force_n.tolist(),
        "position_m": None if pose is None else pose.position_m.tolist(),
        "quaternion_xyzw": None if pose is None else pose.quaternion_xyzw.tolist(),
        "number": moment.number,
        "spent_ms": None if moment.spent_s is None else 1e3 * moment.spent_s,
        "rate_hz": moment.rate_hz,
        "is_converged": moment.is_converged,
        "is_behind": moment.is_behind,
    }
    return packed("skin", header, {"skin": np.asarray(moment.skin_m, dtype=np.float32)})


def picture_payload(picture: Picture, depth_range_m: tuple[float, float] | None) -> bytes:
    """Return what the camera sees, image and depth as JPEG files.

    Args:
        picture: to show.
        depth_range_m: the ends of the colours; None: those of this picture.
    """
    parts: dict[str, Any] = {}
    header: dict[str, Any] = {"stamp_s": 1e-9 * picture.stamp_ns}
    if picture.image is not None:
        parts["image"] = _jpeg(picture.image)
    if picture.depth_m is not None:
        depth_m = np.asarray(picture.depth_m[::DEPTH_STRIDE, ::DEPTH_STRIDE], dtype=np.float64)
        low, high = depth_range_m or depth_range_of(depth_m)
        parts["depth"] = _jpeg(coloured(depth_m, low, high, DEPTH_COLOURS))
        header["depth_m"] = [low, high]
    return packed("picture", header, parts)


def history_payload(time_s: NDArray[np.floating], force_n: NDArray[np.floating]) -> bytes:
    """Return forces (N, 3) at times (N,), for the plot."""
    # Seconds since 1970 have no milliseconds left in float32.
    start_s = float(time_s[0]) if len(time_s) else 0.0
    parts = {
        "time": (time_s - start_s).astype(np.float32),
        "force": np.asarray(force_n, dtype=np.float32).reshape(-1, 3),
    }
    return packed("history", {"start_s": start_s}, parts)


def depth_range_of(depth_m: NDArray[np.floating]) -> tuple[float, float]:
    """Return the nearest and farthest depth, (0, 1) where none is finite."""
    seen = depth_m[np.isfinite(depth_m)]
    return (float(seen.min()), float(seen.max())) if seen.size else (0.0, 1.0)


def pressed_depth_range_of(rest_depth_m: NDArray[np.floating]) -> tuple[float, float]:
    """Return the ends of the colours for a skin that is going to be pressed towards the camera: as
    much room on the near side as the skin at rest takes."""
    low, high = depth_range_of(rest_depth_m)
    return max(0.0, low - max(high - low, LEAST_ROOM_M)), high


def _jpeg(image: ImageArray) -> bytes:
    bgr = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2BGR)
    _, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return encoded.tobytes()
