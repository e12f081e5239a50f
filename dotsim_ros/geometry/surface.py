# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Triangles of an indenter's surface, with edges of a given length."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from dotsim_ros.geometry.closed_mesh import IndenterMesh
from dotsim_ros.geometry.indenter import Indenter, IndenterKind
from dotsim_ros.io.arrays import FloatArray, IntArray

ARC_STEP_RAD = np.deg2rad(20.0)
"""No piece of a rounding turns by more than this."""


def _arc(
    centre: tuple[float, float], radius: float, start: float, end: float, step: float
) -> FloatArray:
    """Return (n, 2) points of an arc, angles in radians from the first axis."""
    turn = abs(end - start)
    count = max(1, int(np.ceil(max(radius * turn / step, turn / ARC_STEP_RAD))))
    angle = np.linspace(start, end, count + 1 if radius > 0.0 else 1)
    return np.asarray(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _path(pieces: list[FloatArray], step: float) -> FloatArray:
    """Return the points of pieces in a row, with points at most `step` apart in between."""
    points = [pieces[0][:1]]
    for start, end in pairwise(np.concatenate(pieces)):
        length = float(np.linalg.norm(end - start))
        if length > 1e-9:
            count = int(np.ceil(length / step - 1e-6))
            points.append(start + (end - start) * np.arange(1, count + 1)[:, None] / count)
    return np.concatenate(points)


def meridian(indenter: Indenter, step: float) -> FloatArray:
    """Return (n, 2) distance from the axis and height along the meridian, from the tip up."""
    down, up = -0.5 * np.pi, 0.5 * np.pi
    p = indenter.parameters
    match indenter.kind:
        case IndenterKind.SPHERE:
            return _arc((0.0, p[0]), p[0], down, up, step)
        case IndenterKind.CYLINDER:
            radius, length, edge = p
            return _path(
                [
                    np.zeros((1, 2)),
                    _arc((radius - edge, edge), edge, down, 0.0, step),
                    _arc((radius - edge, length - edge), edge, 0.0, up, step),
                    np.array([[0.0, length]]),
                ],
                step,
            )
        case IndenterKind.CONE:
            angle, height, tip = p
            rim = ((height - 2.0 * tip) * float(np.tan(angle)), height - tip)
            return _path(
                [
                    _arc((0.0, tip), tip, down, -angle, step),
                    _arc(rim, tip, -angle, up, step),
                    np.array([[0.0, height]]),
                ],
                step,
            )
        case IndenterKind.CAPSULE:
            radius, length = p
            return _path(
                [
                    _arc((0.0, radius), radius, down, 0.0, step),
                    _arc((0.0, radius + length), radius, 0.0, up, step),
                ],
                step,
            )
        case IndenterKind.TORUS:
            return _arc((p[0], p[1]), p[1], down, down + 2.0 * np.pi, step)
    raise ValueError(f"{indenter.kind!r} is no body of revolution")


def _stitched(lower: IntArray, upper: IntArray) -> list[tuple[int, int, int]]:
    """Return the triangles between two rings of points, evenly spread over the turn."""
    m, n = len(lower), len(upper)
    i = j = 0
    triangles = []
    while i < m or j < n:
        if m > 1 and (n == 1 or j >= n or (i < m and (i + 1) * n <= (j + 1) * m)):
            triangles.append((lower[i % m], lower[(i + 1) % m], upper[j % n]))
            i += 1
            j = j if n > 1 or i < m else n
        else:
            triangles.append((lower[i % m], upper[(j + 1) % n], upper[j % n]))
            j += 1
            i = i if m > 1 or j < n else m
    return triangles


def _revolved(line: FloatArray, step: float, *, is_closed: bool) -> IndenterMesh:
    points, rings, count = [], [], 0
    for radius, height in line[:-1] if is_closed else line:
        # A multiple of four, so that a cylinder on its side has points on its tip.
        number = 4 * max(2, int(np.ceil(0.5 * np.pi * radius / step))) if radius > 1e-9 else 1
        turn = 2.0 * np.pi * np.arange(number) / number
        points.append(
            np.stack(
                [radius * np.cos(turn), radius * np.sin(turn), np.full(number, height)], axis=1
            )
        )
        rings.append(np.arange(count, count + number))
        count += number
    pairs = list(pairwise([*rings, rings[0]] if is_closed else rings))
    triangles = [triangle for lower, upper in pairs for triangle in _stitched(lower, upper)]
    return IndenterMesh(np.concatenate(points), np.array(triangles, dtype=np.int32))


def _box(size: FloatArray, edge: float, step: float) -> IndenterMesh:
    half = 0.5 * size
    marks = []
    for reach in half:
        inside = np.linspace(
            edge - reach, reach - edge, int(np.ceil(2 * (reach - edge) / step)) + 1
        )
        turn = np.arange(1, 4) / 4.0 * 0.25 * np.pi
        band = edge * np.tan(turn) if edge > 0.0 else np.zeros(0)
        end = [edge] if edge > 0.0 else []
        outwards = reach - edge + np.concatenate([band, end])
        marks.append(np.concatenate([-outwards[::-1], inside, outwards]))
    points, triangles, count = [], [], 0
    for axis in range(3):
        u, v = np.meshgrid(marks[(axis + 1) % 3], marks[(axis + 2) % 3], indexing="ij")
        number = np.arange(u.size).reshape(u.shape)
        a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
        faces = np.concatenate(
            [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
        )
        for sign in (1.0, -1.0):
            face = np.zeros((u.size, 3))
            face[:, axis] = sign * half[axis]
            face[:, (axis + 1) % 3], face[:, (axis + 2) % 3] = u.ravel(), v.ravel()
            points.append(face)
            triangles.append((faces if sign > 0.0 else faces[:, ::-1]) + count)
            count += len(face)
    cube = np.concatenate(points)
    _, first, merged = np.unique(
        np.round(cube * 1e9).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    cube = cube[first]
    inner = np.clip(cube, edge - half, half - edge)
    outwards = cube - inner
    length = np.linalg.norm(outwards, axis=1, keepdims=True)
    rounded = inner + edge * np.divide(outwards, length, out=np.zeros_like(cube), where=length > 0)
    surface = np.where(length > 0, rounded, cube)
    surface[:, 2] += half[2]
    return IndenterMesh(surface, merged.reshape(-1)[np.concatenate(triangles)].astype(np.int32))


def indenter_surface(indenter: Indenter, step_m: float) -> IndenterMesh:
    """Return a closed surface of triangles in the indenter's frame; that of a mesh is its own.

    Args:
        indenter: the rigid shape.
        step_m: length of the triangles' edges; roundings are divided more finely.

    Raises:
        ValueError: the step is not positive.
    """
    if not step_m > 0.0:
        raise ValueError(f"step_m is {step_m}, expected a positive length")
    if indenter.mesh is not None:
        return indenter.mesh
    if indenter.kind is IndenterKind.BOX:
        *size, edge = indenter.parameters
        mesh = _box(np.array(size), edge, step_m)
    else:
        is_closed = indenter.kind is IndenterKind.TORUS
        mesh = _revolved(meridian(indenter, step_m), step_m, is_closed=is_closed)
    return IndenterMesh(indenter.mount.apply(mesh.vertices_m), mesh.triangles)
