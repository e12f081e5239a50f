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

from dotsim_ros.geometry.surface import indenter_surface
from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.live.moments import Picture, Scene, SkinMoment
from dotsim_ros.view.panels import coloured

ALIGNED = 4
SURFACE_STEP_M = 0.5e-3
"""Length of the edges of a drawn indenter."""
SKIN_MAP_COLOURS = "magma_r"
"""Pale at rest, as silicone is, and darker the farther the skin has moved."""
JPEG_QUALITY = 88
DEPTH_STRIDE = 2
"""Indentation is drawn from every second pixel of every second row."""
INDENTATION_COLOURS = "viridis"
INDENTATION_ENDS_M = tuple(1e-3 * mm for mm in (0.5, 1, 1.5, 2, 3, 4, 5, 6, 8, 10, 15, 20))
"""Where the colours of the indentation may end."""
RELEASED_M = 0.05e-3
"""A smaller indentation is the end of a press."""

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
    return packed("scene", {}, parts)


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


class IndentationScale:
    """The end of the colours of an indentation: it only grows during a press, so that the colours
    do not flicker, and begins again at its smallest when the press is over."""

    def __init__(self) -> None:
        self._end_m = INDENTATION_ENDS_M[0]

    def end_m(self, largest_m: float) -> float:
        """Return the end for the next picture, whose largest indentation is given."""
        enough_m = (end_m for end_m in INDENTATION_ENDS_M if end_m >= largest_m)
        needed_m = next(enough_m, INDENTATION_ENDS_M[-1])
        self._end_m = needed_m if largest_m < RELEASED_M else max(self._end_m, needed_m)
        return self._end_m


def picture_payload(picture: Picture, scale: IndentationScale) -> bytes:
    """Return what the camera sees, image and indentation as JPEG files.

    The indentation of a pixel is the depth of the skin at rest minus the present one.

    Args:
        picture: to show; without a depth at rest it has no indentation.
        scale: of the pictures before.
    """
    parts: dict[str, Any] = {}
    header: dict[str, Any] = {"stamp_s": 1e-9 * picture.stamp_ns}
    if picture.image is not None:
        parts["image"] = _jpeg(picture.image)
    if picture.depth_m is not None and picture.rest_depth_m is not None:
        drawn = (slice(None, None, DEPTH_STRIDE), slice(None, None, DEPTH_STRIDE))
        indentation_m = np.asarray(
            picture.rest_depth_m[drawn] - picture.depth_m[drawn], dtype=np.float64
        )
        end_m = scale.end_m(float(np.max(indentation_m, initial=0.0, where=indentation_m > 0.0)))
        parts["indentation"] = _jpeg(coloured(indentation_m, 0.0, end_m, INDENTATION_COLOURS))
        parts["colours"] = coloured(np.linspace(0.0, 1.0, 256), 0.0, 1.0, INDENTATION_COLOURS)
        header["indentation_end_m"] = end_m
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


def _jpeg(image: ImageArray) -> bytes:
    bgr = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2BGR)
    _, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return encoded.tobytes()
