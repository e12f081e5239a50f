# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Closed surfaces of triangles, as a body or several: read from files, checked and repaired."""

from __future__ import annotations

import functools
import hashlib
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import value_text

MESH_SUFFIXES = (".stl", ".obj", ".ply")
MAXIMUM_TRIANGLE_COUNT = 2_000_000
MAXIMUM_REPAIRED_BODY_COUNT = 1000
"""Of a mesh some of whose bodies are inside out: each is compared with each."""

_log = logging.getLogger(__name__)

Triangles = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class IndenterMesh:
    """A closed surface: vertices_m (V, 3) in the indenter's frame, triangles (T, 3) int32,
    counter-clockwise seen from outside.

    Surfaces of the same vertices and triangles are equal, so that recordings which each read their
    indenter's file share what takes seconds to compute.
    """

    vertices_m: FloatArray
    triangles: Triangles

    @functools.cached_property
    def _digest(self) -> bytes:
        return hashlib.sha256(self.vertices_m.tobytes() + self.triangles.tobytes()).digest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, IndenterMesh) and self._digest == other._digest

    def __hash__(self) -> int:
        return hash(self._digest)

    @functools.cached_property
    def _bounds_m(self) -> FloatArray:
        return np.array([self.vertices_m.min(axis=0), self.vertices_m.max(axis=0)])

    def bounds_m(self) -> FloatArray:
        """Return the lower and upper corner (2, 3) of a box around the surface."""
        return self._bounds_m

    def signed_distance(self, points_m: FloatArray) -> FloatArray:
        """Return the signed distance (N,) in metres at points (N, 3); float32."""
        # Loaded on use: primitives need no Warp.
        from dotsim_ros.geometry.mesh_distance import mesh_signed_distance

        return mesh_signed_distance(self, points_m)


def read_closed_surface(path: Path) -> tuple[FloatArray, Triangles]:
    """Return the vertices (V, 3), in the file's unit, and the triangles (T, 3) of a mesh file.

    Args:
        path: an STL, OBJ or PLY file.

    Raises:
        FileNotFoundError: no such file.
        ValueError: another format, not a mesh, or as `closed_surface`.
    """
    import trimesh  # half a second, and primitives do without

    if not path.is_file():
        raise FileNotFoundError(f"no mesh file {path}")
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise ValueError(f"{path}: expected a mesh file of {', '.join(MESH_SUFFIXES)}")
    try:
        mesh: Any = trimesh.load(path, force="mesh", process=False)
    except Exception as error:  # the readers raise whatever their parsers meet
        raise ValueError(f"{path}: not a readable mesh: {value_text(str(error))}") from error
    triangles = getattr(mesh, "faces", None)
    if triangles is None or len(triangles) == 0:
        raise ValueError(f"{path}: the mesh has no triangles")
    return closed_surface(mesh.vertices, triangles, str(path))


def closed_surface(
    vertices: ArrayLike, triangles: ArrayLike, place: str
) -> tuple[FloatArray, Triangles]:
    """Return a surface of triangles as one that is closed and counter-clockwise from outside.

    Vertices at one position are merged, since formats that keep a texture repeat them along its
    seams. Triangles that have no corners of their own or are there twice are dropped. Each body is
    turned outwards, except for what bounds a cavity of another. Holes are not filled.

    Args:
        vertices: (V, 3), in any unit.
        triangles: (T, 3) vertex numbers.
        place: where the surface comes from, for messages.

    Raises:
        ValueError: too many triangles, vertices that are not there or not finite, or a surface that
            is not closed or encloses no volume.
    """
    import trimesh

    positions, corners = np.asarray(vertices, dtype=np.float64), np.asarray(triangles)
    if len(corners) > MAXIMUM_TRIANGLE_COUNT:
        raise ValueError(
            f"{place}: {len(corners)} triangles, at most {MAXIMUM_TRIANGLE_COUNT} expected; "
            "simplify it"
        )
    if np.shape(positions)[1:] != (3,):
        raise ValueError(f"{place}: its vertices do not have 3 coordinates; write the mesh again")
    if np.shape(corners)[1:] != (3,) or not 0 <= corners.min() <= corners.max() < len(positions):
        raise ValueError(
            f"{place}: triangles name vertices that are not there; write the mesh again"
        )
    if not np.all(np.isfinite(positions)):
        raise ValueError(f"{place}: a vertex is not finite")
    mesh: Any = trimesh.Trimesh(positions, corners, process=False)
    mesh.merge_vertices()
    mesh.update_faces(np.all(mesh.faces != np.roll(mesh.faces, 1, axis=1), axis=1))
    mesh.update_faces(mesh.unique_faces())
    if len(mesh.faces) == 0:
        raise ValueError(f"{place}: every triangle of the mesh is empty")
    if not mesh.is_watertight:
        raise ValueError(f"{place}: the mesh is not closed ({_open_edges(mesh)}")
    trimesh.repair.fix_winding(mesh)
    surface = np.asarray(mesh.vertices, dtype=np.float64), _turned_outwards(mesh, place)
    # A surface of one side, such as Klein's bottle, cannot be wound one way.
    if not (mesh.is_winding_consistent and _volume(*surface) > 0.0):
        raise ValueError(f"{place}: its triangles do not enclose a volume; check its normals")
    return surface


def _open_edges(mesh: Any) -> str:
    _, count = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    holes, branches = int(np.sum(count == 1)), int(np.sum(count > 2))
    words = f"{holes + branches} edges do not join exactly two triangles"
    if holes == 0:
        return f"{words} but more); unite bodies that touch each other in a mesh editor"
    return f"{words}); close its holes in a mesh editor, they are not filled here"


def _volume(vertices: FloatArray, triangles: Triangles) -> float:
    """Return the enclosed volume; negative where the triangles are clockwise from outside."""
    corner = vertices[triangles] - vertices[triangles[:, 0]].mean(axis=0)
    return float(np.linalg.det(corner).sum()) / 6.0


def _turned_outwards(mesh: Any, place: str) -> Triangles:
    """Return the triangles of a mesh of closed bodies, each wound one way, without bodies that are
    inside out.

    A body outside of all others has its triangles outwards. Within another they may be inwards, the
    wall of a cavity, or outwards, a body in a body, and stay so; unless the other was inside out:
    then a cavity is meant.
    """
    import trimesh

    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    triangles = np.array(mesh.faces, dtype=np.int32)
    numbers = np.arange(len(triangles))
    bodies = trimesh.graph.connected_components(mesh.face_adjacency, nodes=numbers)
    sign = np.sign([_volume(vertices, triangles[body]) for body in bodies])
    if np.all(sign >= 0.0):
        return triangles
    if len(bodies) > MAXIMUM_REPAIRED_BODY_COUNT:
        raise ValueError(
            f"{place}: {int(np.sum(sign < 0.0))} of the mesh's {len(bodies)} bodies are inside "
            f"out, at most {MAXIMUM_REPAIRED_BODY_COUNT} bodies expected to repair them; recompute "
            "its normals outwards in a mesh editor"
        )
    around = _bodies_around(vertices, [triangles[body] for body in bodies], sign)
    turned = np.zeros(len(bodies), dtype=bool)
    for number in np.argsort([len(others) for others in around], kind="stable"):
        others = around[number]
        wanted = sign[number]
        if sum(sign[others]) <= 0.0:
            wanted = 1.0
        elif any(turned[others]):
            wanted = -1.0
        turned[number] = sign[number] != wanted
        sign[number] = wanted
    for number in np.flatnonzero(turned):
        triangles[bodies[number]] = triangles[bodies[number]][:, ::-1]
    if turned.any():
        _log.warning(
            "%s: %d of %d bodies of the mesh were inside out and have been turned",
            place,
            turned.sum(),
            len(bodies),
        )
    return triangles


def _bodies_around(
    vertices: FloatArray, bodies: list[Triangles], sign: FloatArray
) -> list[list[int]]:
    """Return for each body the numbers of those that it lies in as a whole."""
    # The distances are made for the size of an indenter in metres.
    vertices = (vertices - vertices.mean(axis=0)) * (0.1 / np.ptp(vertices, axis=0).max())
    corners = [vertices[np.unique(body)] for body in bodies]
    lower = np.array([points.min(axis=0) for points in corners])
    upper = np.array([points.max(axis=0) for points in corners])
    around: list[list[int]] = []
    for inner, points in enumerate(corners):
        boxed = np.all((lower < lower[inner]) & (upper > upper[inner]), axis=1)
        around.append([])
        for outer in np.flatnonzero(boxed):
            body = bodies[outer] if sign[outer] > 0.0 else bodies[outer][:, ::-1]
            shell = IndenterMesh(vertices, np.ascontiguousarray(body))
            if np.all(shell.signed_distance(points) < 0.0):
                around[inner].append(int(outer))
    return around
