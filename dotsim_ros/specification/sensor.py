# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A whole sensor: its sections together, what they must not contradict, and how large it is."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, get_type_hints

from dotsim_ros.io.documents import value_text
from dotsim_ros.io.quantity import check_fields, number_text, quantity
from dotsim_ros.specification.sections import (
    CameraSpecification,
    ContactSpecification,
    GelSpecification,
    LightingSpecification,
    MarkerSpecification,
    MaterialSpecification,
    NoiseSpecification,
    PatternSpecification,
    SolverSpecification,
    VignettingSpecification,
)

LARGEST_DISTANCE_M = 0.1
"""Of the camera from the gel's box: tactile sensors look at it from a few centimetres at most."""
LARGEST_MEMORY_BYTES = 16e9
"""What one sensor may take: the default dome on a grid of 1.2 mm, unrefined, still does."""
GRAIN_SHARE = 0.6
"""Size of the coat's fine texture, over that of a blotch."""


@dataclass(frozen=True)
class SensorSpecification:
    """A whole sensor.

    Raises:
        ValueError: two sections contradict each other, or the sensor would take more memory than
            `LARGEST_MEMORY_BYTES`.
    """

    name: str = quantity("densetact2")
    """Name of the sensor; that of the file where it gives none."""
    gel: GelSpecification = field(default_factory=GelSpecification)
    material: MaterialSpecification = field(default_factory=MaterialSpecification)
    contact: ContactSpecification = field(default_factory=ContactSpecification)
    solver: SolverSpecification = field(default_factory=SolverSpecification)
    camera: CameraSpecification = field(default_factory=CameraSpecification)
    noise: NoiseSpecification = field(default_factory=NoiseSpecification)
    lighting: LightingSpecification = field(default_factory=LightingSpecification)
    vignetting: VignettingSpecification = field(default_factory=VignettingSpecification)
    pattern: PatternSpecification = field(default_factory=PatternSpecification)
    markers: MarkerSpecification = field(default_factory=MarkerSpecification)

    def __post_init__(self) -> None:
        check_fields("", self)
        if self.solver.method == "explicit" and self.gel.bond_slip_share > 0.0:
            raise ValueError(
                f"gel.bond_slip_share is {self.gel.bond_slip_share}, expected 0 with solver.method "
                "'explicit': set it to 'implicit' for a gel that has come off its core"
            )
        if self.solver.method == "explicit" and self.material.law != "neo_hookean":
            raise ValueError(
                f"solver.method 'explicit' takes the law neo_hookean, not {self.material.law!r}; "
                "choose that law or the method 'implicit'"
            )
        self._check_grid()
        self._check_camera()
        self._check_markers()
        if not self.camera.idle_image:
            check_drawable(self.gel, self.pattern)
        self._check_memory()

    @property
    def remembers(self) -> bool:
        """Whether the gel goes on moving under an indenter that is held: it relaxes or swings."""
        solver = self.solver
        return solver.method == "explicit" or solver.dynamic or bool(self.material.prony_shares)

    def _check_grid(self) -> None:
        lower, upper = self.gel.bounds_m
        extent = min(b - a for a, b in zip(lower, upper, strict=True))
        if self.solver.grid_spacing_m > 0.5 * extent:
            raise ValueError(
                f"solver.grid_spacing_m is {self.solver.grid_spacing_m}, expected at most half the "
                f"gel's smallest extent ({number_text(0.5 * extent)} m)"
            )

    def _check_camera(self) -> None:
        place, (lower, upper) = self.camera.position_m, self.gel.bounds_m
        gaps = (max(a - p, p - b, 0.0) for a, p, b in zip(lower, place, upper, strict=True))
        distance = math.hypot(*gaps)
        if distance > LARGEST_DISTANCE_M:
            raise ValueError(
                f"camera.position_m is {value_text(place)}, {number_text(round(distance, 6))} m "
                f"from the gel, expected at most {LARGEST_DISTANCE_M} m"
            )
        if not self.gel.has_behind(place):
            raise ValueError(
                f"camera.position_m is {value_text(place)}, in front of the skin; expected a place "
                "behind it, where the camera sees its inner side"
            )

    def _check_markers(self) -> None:
        if not self.markers.columns:
            return
        x, y = self.markers.corner_m
        if self.gel.shape == "dome":
            fits = math.hypot(x, y) < 0.99 * self.gel.outer_radius_m
        else:
            fits = x <= 0.5 * self.gel.pad_size_m[0] and y <= 0.5 * self.gel.pad_size_m[1]
        if not fits:
            raise ValueError(
                f"markers reach {number_text(x)} m along x and {number_text(y)} m along y, beyond "
                "the skin; expected fewer markers.columns and markers.rows, or a smaller "
                "markers.spacing_m"
            )

    def _check_memory(self) -> None:
        size = size_of(self)
        if size.memory_bytes > LARGEST_MEMORY_BYTES:
            raise ValueError(
                f"the sensor would take {size.memory_bytes / 1e9:.0f} GB of memory, expected at "
                f"most {LARGEST_MEMORY_BYTES / 1e9:.0f} GB: {size.grid_node_count} grid nodes at a "
                f"solver.grid_spacing_m of {number_text(self.solver.grid_spacing_m)}, "
                f"{size.skin_marker_count} skin markers at a gel.skin_spacing_m of "
                f"{number_text(self.gel.skin_spacing_m)}, an image of "
                f"{self.camera.width}x{self.camera.height}; most of it is for {size.largest_part}"
            )


SECTIONS: dict[str, type[Any]] = {
    name: kind for name, kind in get_type_hints(SensorSpecification).items() if name != "name"
}
"""The class of each section, by its name."""


@dataclass(frozen=True)
class SensorSize:
    """How large a sensor is, estimated from its fields alone.

    Attributes:
        skin_marker_count: of the skin, within 12 %.
        grid_node_count: of the grid, within 12 %.
        memory_bytes: the most that it takes at any time on a CPU, within a third.
        largest_part: what most of the memory is for: the grid, the skin or the image.
    """

    skin_marker_count: int
    grid_node_count: int
    memory_bytes: float
    largest_part: str


def size_of(sensor: SensorSpecification) -> SensorSize:
    """Return how large a sensor will be, without making it.

    The memory's factors are fitted to what 13 sensors took, of 0.25 to 11 GB.
    """
    gel, solver, camera = sensor.gel, sensor.solver, sensor.camera
    spacing_m = solver.grid_spacing_m
    markers, nodes = _skin_marker_count(gel), _grid_node_count(gel, spacing_m)
    if solver.method == "explicit":
        # Eight particles a cell.
        grid_bytes = 450.0 * 8.0 * gel.volume_m3 / spacing_m**3
    else:
        # The inverse of the stiffness, dense, while it is computed; then that of contact.
        square = (3.0 * nodes) ** 2
        refined = _refinement_bytes(gel, 0.5 * spacing_m) if solver.refined else 0.0
        grid_bytes = max(22.0 * square, 8.0 * square + refined)
    parts = {
        "the grid": grid_bytes,
        "the skin": 1000.0 * markers,
        "the image": 170.0 * camera.width * camera.height,
    }
    total = 0.25e9 + sum(parts.values())
    return SensorSize(round(markers), round(nodes), total, max(parts, key=parts.__getitem__))


def _skin_marker_count(gel: GelSpecification) -> float:
    """Return the number of markers, in rows of equilateral triangles."""
    spacing_m, row_m = gel.skin_spacing_m, math.sqrt(0.75) * gel.skin_spacing_m
    if gel.shape == "dome":
        # The edges of a geodesic sphere are up to a third shorter than its longest ones.
        return 1.24 * gel.skin_area_m2 / (spacing_m * row_m)
    x, y, _ = gel.pad_size_m
    return (x / spacing_m + 1.0) * (y / row_m + 1.0)


def _nodes_along(gel: GelSpecification, spacing_m: float) -> tuple[float, float, float]:
    """Return the number of nodes along the box around the gel: a cell's node and one next to it."""
    _, upper = gel.bounds_m
    x, y, z = (math.ceil(number / spacing_m - 1e-9) for number in upper)
    return 2.0 * x + 2.0, 2.0 * y + 2.0, z + 1.0


def _grid_node_count(gel: GelSpecification, spacing_m: float) -> float:
    if gel.shape != "dome":
        return math.prod(_nodes_along(gel, spacing_m))
    # Nodes reach one and a half cells beyond the gel: half a ball, thickened by a cube of 3 h.
    r, h = gel.outer_radius_m, 3.0 * spacing_m
    volume = 0.5 * (h**3 + 6.0 * h**2 * r + 3.0 * math.pi * h * r**2 + 4.0 / 3.0 * math.pi * r**3)
    hole = 2.0 / 3.0 * math.pi * max(0.0, gel.core_radius_m - math.sqrt(0.75) * h) ** 3
    return (volume - hole) / spacing_m**3


def _refinement_bytes(gel: GelSpecification, spacing_m: float) -> float:
    """Return what the refinement's grid and its table take."""
    along = _nodes_along(gel, spacing_m)
    # Slabs of three planes, factored densely with the coupling of each to the next.
    factor = 216.0 * _grid_node_count(gel, spacing_m) ** 2 / max(along)
    # Pairs of nodes next to the skin, up to 7 mm apart.
    layers = 4.4 if gel.shape == "dome" else 3.0
    if gel.shape == "dome":
        beside = layers * gel.skin_area_m2 / spacing_m**2
    else:
        beside = layers * along[0] * along[1]
    near = 0.85 * min(beside, layers * math.pi * (7e-3 / spacing_m) ** 2)
    return factor + 300.0 * beside * near


def check_drawable(gel: GelSpecification, pattern: PatternSpecification) -> None:
    """Refuse a pattern too fine to be drawn on a gel of this size.

    Raises:
        ValueError: it would take more than some gigabytes.
    """
    # A dome's pattern is cut from a block, a pad's is drawn flat.
    cells, name = (400, "outer_radius_m") if gel.shape == "dome" else (8000, "pad_size_m")
    smallest_m = 2.0 * gel.extent_m / (GRAIN_SHARE * cells)
    if pattern.blotch_m < smallest_m:
        raise ValueError(
            f"pattern.blotch_m is {number_text(pattern.blotch_m)}, expected at least "
            # Rounded up.
            f"{number_text(float(f'{1.005 * smallest_m:.3g}'))} m to be drawn on a gel of this "
            f"gel.{name}; or name an image in camera.idle_image"
        )
