# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rigid indenters: exact primitives and closed meshes, each with a signed distance.

The indenter's frame has its origin at the tip and +z pointing away from the gel: a sphere of
radius r has its centre at (0, 0, r).
"""

from __future__ import annotations

import functools
import inspect
import logging
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from dotsim_ros.geometry.closed_mesh import MESH_SUFFIXES, IndenterMesh, read_closed_surface
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.signed_distance import SignedDistanceGrid, sample_on_grid
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import is_number, parse_yaml, read_yaml, value_text
from dotsim_ros.io.files import expanded, shipped_path
from dotsim_ros.io.printable import did_you_mean

MAXIMUM_EXTENT_M = 0.2
MINIMUM_EXTENT_M = 2.0e-4
UNITS_M = {"metres": 1.0, "millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254}
LIKELY_EXTENT_M = 1.0e-3
"""A shorter mesh is rather in another unit than an indenter."""
AXIS_TOLERANCE_M = 1.0e-6
GRID_MARGIN_M = 0.004
OTHER_FORMS = (
    "the path of a YAML, STL, OBJ or PLY file, or a definition such as sphere(radius_m=0.003)"
)
LARGEST_LEVER_M = 0.02
"""Points farther from an indenter's tip do not count where it turns."""

_log = logging.getLogger(__name__)

_CALL = re.compile(r"(\w+)\((.*)\)", re.DOTALL)
_ARGUMENT = re.compile(r"(^|,)\s*(\w+)\s*=")

AwayAxis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
_TURN_TO_Z = {
    "+x": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "-x": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "+y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "-y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "+z": np.eye(3),
    "-z": np.diag([1.0, -1.0, -1.0]),
}


class IndenterKind(IntEnum):
    """The closed set of shapes; the numbers are those that the kernels switch on."""

    SPHERE = 0
    BOX = 1
    CYLINDER = 2
    CONE = 3
    CAPSULE = 4
    TORUS = 5
    MESH = 6


@dataclass(frozen=True, eq=False)
class Indenter:
    """A rigid indenter; build one with `sphere`, `box`, `flat_punch`, `cone`, `lying_cylinder`,
    `capsule`, `torus`, `load_mesh` or `load_indenter`.

    Attributes:
        kind: which shape.
        parameters: the shape's numbers, metres and radians; sphere (radius), box (size x, y, z,
            edge radius), cylinder (radius, length, edge radius), cone (half angle, height, tip
            radius), capsule (radius, straight length), torus (major, minor radius), mesh ().
        mount: pose of the shape's own frame (tip at the origin, axis of revolution +z) in the
            indenter's frame.
        mesh: the surface of a mesh, else None.
        name: for logs and tables.
        file_unit_m: metres that a unit of the file was taken for, of a mesh that comes from one.
    """

    kind: IndenterKind
    parameters: tuple[float, ...]
    mount: Pose = field(default_factory=Pose)
    mesh: IndenterMesh | None = None
    name: str = ""
    file_unit_m: float | None = None

    def signed_distance(self, points_m: ArrayLike) -> FloatArray:
        """Return the signed distance (N,) in metres at points (N, 3) of the indenter's frame.

        Negative inside; exact for primitives, float32 for meshes.
        """
        points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
        if self.mesh is not None:
            return self.mesh.signed_distance(points)
        local = (points - self.mount.position_m) @ self.mount.rotation()
        return _PRIMITIVE_DISTANCE[self.kind](local, *self.parameters)

    def distance_from(self, points_m: FloatArray, pose: Pose) -> FloatArray:
        """Return the signed distance (N,) in metres at points (N, 3) of the frame that the
        indenter's pose is given in."""
        return self.signed_distance((points_m - pose.position_m) @ pose.rotation())

    def bounds_m(self) -> FloatArray:
        """Return the lower and upper corner (2, 3) of a box around the shape, indenter's frame; not
        to be written to."""
        return self._bounds_m

    @functools.cached_property
    def _bounds_m(self) -> FloatArray:
        if self.mesh is not None:
            bounds = self.mesh.bounds_m()
        else:
            lower, upper = _primitive_bounds(self.kind, self.parameters)
            corners = np.array(
                [
                    [x, y, z]
                    for x in (lower[0], upper[0])
                    for y in (lower[1], upper[1])
                    for z in (lower[2], upper[2])
                ]
            )
            corners = self.mount.apply(corners)
            bounds = np.array([corners.min(axis=0), corners.max(axis=0)])
        # Every commanded pose asks for it some times.
        bounds.flags.writeable = False
        return bounds

    @functools.cached_property
    def _radius_m(self) -> float:
        """Half the diagonal of the box around the shape."""
        return 0.5 * float(np.linalg.norm(np.ptp(self._bounds_m, axis=0)))

    def distance_grid(self, spacing_m: float | None = None) -> SignedDistanceGrid:
        """Return the signed distance as a quadratic B-spline that reaches 4 mm beyond the shape.

        Args:
            spacing_m: distance between nodes; by default 1/128 of the shape's longest side,
                between 0.1 and 0.4 mm. Edges are rounded over about one spacing.

        Raises:
            ValueError: the spacing is not positive or the grid too large.
        """
        bounds = self.bounds_m()
        if spacing_m is None:
            spacing_m = float(np.clip(np.max(bounds[1] - bounds[0]) / 128.0, 1.0e-4, 4.0e-4))
        return _cached_grid(self.mesh or self, float(spacing_m))


@functools.lru_cache(maxsize=8)
def _cached_grid(shape: Indenter | IndenterMesh, spacing_m: float) -> SignedDistanceGrid:
    return sample_on_grid(
        shape.signed_distance,
        shape.bounds_m(),
        spacing_m=spacing_m,
        margin_m=GRID_MARGIN_M,
    )


def sphere(radius_m: float) -> Indenter:
    """A ball of the given radius."""
    _check_lengths(radius_m=radius_m)
    return Indenter(IndenterKind.SPHERE, (radius_m,), name="sphere")


def box(size_m: ArrayLike, edge_radius_m: float = 0.0) -> Indenter:
    """A box standing on its lower face, size_m (3,) along x, y, z, with rounded edges."""
    size = np.asarray(size_m, dtype=np.float64).reshape(-1)
    if size.shape != (3,):
        raise ValueError(f"size_m of a box needs 3 lengths, got {size.size}")
    _check_lengths(size_x_m=size[0], size_y_m=size[1], size_z_m=size[2])
    _check_rounding(edge_radius_m, float(size.min()) / 2.0)
    return Indenter(IndenterKind.BOX, (*size.tolist(), edge_radius_m), name="box")


def box_edge(size_m: ArrayLike, edge_radius_m: float = 0.0) -> Indenter:
    """A box turned by 45 degrees about x, so that its edge along x is the tip."""
    shape = box(size_m, edge_radius_m)
    size = np.asarray(size_m, dtype=np.float64)
    quaternion = np.array([np.sin(np.pi / 8), 0.0, 0.0, np.cos(np.pi / 8)])
    # The axis of the rounding along the edge (y, z) = (-, -), which turns into the lowest one.
    edge_axis = np.array([0.0, edge_radius_m - size[1] / 2.0, edge_radius_m])
    tip = Pose(np.zeros(3), quaternion).apply(edge_axis) - [0.0, 0.0, edge_radius_m]
    position = -tip
    return Indenter(shape.kind, shape.parameters, Pose(position, quaternion), name="box_edge")


def flat_punch(radius_m: float, length_m: float, edge_radius_m: float = 0.0) -> Indenter:
    """An upright cylinder that presses with its flat face."""
    _check_lengths(radius_m=radius_m, length_m=length_m)
    _check_rounding(edge_radius_m, min(radius_m, length_m / 2.0))
    parameters = (radius_m, length_m, edge_radius_m)
    return Indenter(IndenterKind.CYLINDER, parameters, name="flat_punch")


def lying_cylinder(radius_m: float, length_m: float, edge_radius_m: float = 0.0) -> Indenter:
    """A cylinder whose axis lies along y."""
    upright = flat_punch(radius_m, length_m, edge_radius_m)
    mount = _lying(length_m, radius_m)
    return Indenter(upright.kind, upright.parameters, mount, name="lying_cylinder")


def capsule(radius_m: float, length_m: float) -> Indenter:
    """A cylinder of `length_m` along y with half balls on its ends (so length + 2 radii long)."""
    _check_lengths(radius_m=radius_m, length_m=length_m)
    mount = _lying(length_m + 2.0 * radius_m, radius_m)
    return Indenter(IndenterKind.CAPSULE, (radius_m, length_m), mount, name="capsule")


def cone(half_angle_rad: float, height_m: float, tip_radius_m: float = 0.0) -> Indenter:
    """A cone on its tip, whose tip and rim are rounded by the same radius.

    Raises:
        ValueError: the half angle is not between 1 and 89 degrees, or the tip's radius leaves
            nothing of the cone.
    """
    _check_lengths(height_m=height_m)
    if not np.radians(1.0) <= half_angle_rad <= np.radians(89.0):
        raise ValueError(f"half_angle_rad must lie within 1 to 89 degrees, got {half_angle_rad}")
    _check_rounding(tip_radius_m, height_m / 2.0)
    return Indenter(IndenterKind.CONE, (half_angle_rad, height_m, tip_radius_m), name="cone")


def torus(major_radius_m: float, minor_radius_m: float) -> Indenter:
    """A ring lying on its side, touching with a circle of the major radius."""
    _check_lengths(major_radius_m=major_radius_m, minor_radius_m=minor_radius_m)
    if minor_radius_m >= major_radius_m:
        raise ValueError(
            f"minor_radius_m must be below major_radius_m = {major_radius_m}, got {minor_radius_m}"
        )
    return Indenter(IndenterKind.TORUS, (major_radius_m, minor_radius_m), name="torus")


def load_mesh(
    path: str | Path,
    scale: float | None = None,
    *,
    away_axis: AwayAxis = "+z",
    origin: Literal["file", "tip"] = "file",
) -> Indenter:
    """Load a closed mesh as an indenter.

    Args:
        path: an STL, OBJ or PLY file.
        scale: metres per unit of the file (0.001 for millimetres); None: the file is in metres.
        away_axis: the file's axis that points away from the gel, turned onto +z.
        origin: "file" keeps the file's origin; "tip" moves the lowest point there, of a level face
            or edge its middle.

    Repairs that change no surface are made (merging vertices, dropping empty and doubled triangles,
    turning bodies outwards); holes are not filled.

    Raises:
        FileNotFoundError: no such file.
        ValueError: not a mesh, empty, not finite, not closed, too many triangles, or of a size
            that cannot press a fingertip sensor (a file in millimetres read as metres, say).
    """
    path = expanded(path)
    if scale is not None and not (np.isfinite(scale) and scale > 0.0):
        raise ValueError(f"scale must be a positive number, got {scale}")
    if away_axis not in _TURN_TO_Z:
        raise ValueError(f"away_axis must be one of {sorted(_TURN_TO_Z)}, got {away_axis!r}")
    if origin not in ("file", "tip"):
        raise ValueError(f"origin must be 'file' or 'tip', got {origin!r}")
    vertices, triangles = read_closed_surface(path)
    unit_m = 1.0 if scale is None else scale
    vertices = (vertices * unit_m) @ _TURN_TO_Z[away_axis].T
    _check_extent(path, float(np.ptp(vertices, axis=0).max()), unit_m)
    if origin == "tip":
        vertices = vertices - _lowest_point(vertices)
    mesh = IndenterMesh(np.ascontiguousarray(vertices), triangles)
    return Indenter(IndenterKind.MESH, (), mesh=mesh, name=path.stem, file_unit_m=unit_m)


def _lowest_point(vertices: FloatArray) -> FloatArray:
    """Return the lowest vertex (3,); of a face, an edge or a ring of them its middle."""
    # Files of 32-bit numbers hold a level face with their rounding errors.
    rounding = 1e-6 * np.abs(vertices).max()
    lowest = vertices[vertices[:, 2] <= vertices[:, 2].min() + rounding]
    return np.asarray((lowest.min(axis=0) + lowest.max(axis=0)) / 2.0)


def load_indenter(source: str | Path | Mapping[str, Any], *, folder: str | Path = "") -> Indenter:
    """Return an indenter from a name, a file or a definition.

    Args:
        source: the name of a file in `params/indenters` without `.yaml`; the path of a mesh in
            metres, or of a YAML file with a definition; or a definition: a mapping (`kind` and the
            factory's arguments; for `kind: mesh` a `path`), or one as text, such as
            `sphere(radius_m=0.003)` or, as YAML has it, `{kind: sphere, radius_m: 0.003}`.
            Programs that read what they are given as YAML, such as `ros2 param set`, take braces
            for a mapping, which no parameter of ROS can be.
        folder: that the path of a definition's mesh is relative to.

    Raises:
        FileNotFoundError: no such file or name.
        ValueError: the definition is not valid; the message says what was expected.
    """
    if isinstance(source, Mapping):
        return _from_mapping(source, "indenter definition", Path(folder))
    if isinstance(source, str) and is_definition(source):
        definition = parse_yaml(_as_yaml(source.strip()), "indenter")
        found = _from_mapping(definition, "indenter definition", Path(folder))
        # So that two of one kind have not one name.
        is_named = found.mesh is not None or "name" in definition
        return found if is_named else replace(found, name=source.strip())
    path = expanded(source)
    if path.suffix.lower() in MESH_SUFFIXES:
        return load_mesh(path)
    if path.suffix.lower() not in (".yaml", ".yml"):
        path = shipped_path("indenters", str(source), "indenter", OTHER_FORMS)
    elif not path.is_file():
        raise FileNotFoundError(f"no indenter file {path}")
    definition = read_yaml(path)
    if not isinstance(definition, Mapping):
        raise ValueError(f"{path}: expected a mapping with 'kind', got {type(definition).__name__}")
    return _from_mapping(definition, str(path), path.parent)


def is_definition(text: str) -> bool:
    """Return whether a text defines an indenter, rather than that it names one."""
    return text.lstrip().startswith("{") or _CALL.fullmatch(text.strip()) is not None


def _as_yaml(text: str) -> str:
    """Return the mapping that a definition as text stands for."""
    called = _CALL.fullmatch(text)
    if called is None:
        return text
    kind, values = called.groups()
    named = _ARGUMENT.sub(r"\1 \2: ", values)
    return f"{{kind: {kind}, {named}}}"


def _from_mapping(definition: Mapping[str, Any], where: str, folder: Path) -> Indenter:
    arguments = dict(definition)
    kind = arguments.pop("kind", None)
    name = arguments.pop("name", None)
    if not isinstance(kind, str) or kind not in (*_FACTORIES, "mesh"):
        expected = ", ".join([*sorted(_FACTORIES), "mesh"])
        question = did_you_mean(str(kind), [*_FACTORIES, "mesh"])
        raise ValueError(
            f"{where}: kind must be one of {expected}, got {value_text(kind)}{question}"
        )
    if not isinstance(name, str | None):
        raise ValueError(f"{where}: name must be text, got {value_text(name)}")
    factory: Callable[..., Indenter] = load_mesh if kind == "mesh" else _FACTORIES[kind]
    _check_arguments(kind, factory, arguments, where)
    if kind == "mesh":
        arguments["path"] = folder / expanded(arguments["path"])
    try:
        indenter = factory(**arguments)
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{where}: {error}") from error
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    return indenter if name is None else replace(indenter, name=name)


def _check_arguments(
    kind: str, factory: Callable[..., Indenter], arguments: Mapping[str, Any], where: str
) -> None:
    """Check that a definition gives what a shape needs, in the right types.

    Raises:
        ValueError: an entry is missing, unknown, or of another type.
    """
    known = inspect.signature(factory).parameters
    unknown = [name for name in arguments if name not in known]
    if unknown:
        raise ValueError(
            f"{where}: a {kind} has no {value_text(unknown)}; it takes {', '.join(known)}"
        )
    for name, parameter in known.items():
        if name not in arguments:
            if parameter.default is inspect.Parameter.empty:
                raise ValueError(f"{where}: a {kind} needs {name}, which is missing")
            continue
        value = arguments[name]
        if name in ("path", "away_axis", "origin"):
            fits, expected = isinstance(value, str), "text"
        elif name == "size_m":
            fits = isinstance(value, list | tuple) and all(map(is_number, value))
            expected = "3 numbers"
        else:
            fits, expected = is_number(value), "a number"
        if not fits:
            raise ValueError(f"{where}: {name} is {value_text(value)}, expected {expected}")


def _lying(full_length_m: float, radius_m: float) -> Pose:
    # +z of the shape turned onto -y: a quarter turn about x.
    sine = np.sqrt(0.5)
    return Pose(np.array([0.0, full_length_m / 2.0, radius_m]), np.array([sine, 0.0, 0.0, sine]))


def _check_lengths(**lengths: float) -> None:
    for name, value in lengths.items():
        if not 0.0 < value <= MAXIMUM_EXTENT_M:
            raise ValueError(
                f"{name} must be a length above 0 and at most {MAXIMUM_EXTENT_M} m, got {value}"
            )


def _check_rounding(radius_m: float, largest_m: float) -> None:
    if not 0.0 <= radius_m <= largest_m:
        raise ValueError(f"the rounding must lie within 0 to {largest_m:.6g} m, got {radius_m}")


def _check_extent(path: Path, extent_m: float, unit_m: float) -> None:
    if MINIMUM_EXTENT_M <= extent_m <= MAXIMUM_EXTENT_M:
        return
    bound = (
        f"at most {MAXIMUM_EXTENT_M} m"
        if extent_m > MAXIMUM_EXTENT_M
        else f"at least {MINIMUM_EXTENT_M} m"
    )
    raise ValueError(
        f"{path}: the mesh is {extent_m:.4g} m long, {bound} expected; is it in another unit "
        f"({_other_units(extent_m / unit_m, MAXIMUM_EXTENT_M)}), or scaled once too often? Load it "
        "with that scale; a mesh of a data set is in metres: export it again"
    )


def _other_units(extent: float, largest_m: float) -> str:
    """Return in which units a mesh of a length in its file's unit has the size of an indenter."""
    units = [
        f"in {unit}: it is then {1e3 * scale * extent:.3g} mm long: scale={scale:g}"
        for unit, scale in UNITS_M.items()
        if LIKELY_EXTENT_M <= scale * extent <= largest_m
    ]
    return "; or ".join(units) or "none that is known"


def warn_of_misfit(indenter: Indenter, skin_m: FloatArray) -> None:
    """Log what makes it doubtful that a mesh was read in its unit and with its origin.

    Args:
        indenter: other than a mesh of a file, there is no doubt.
        skin_m: (V, 3) vertices of the gel's skin.
    """
    if indenter.file_unit_m is None:
        return
    lower, upper = indenter.bounds_m()
    extent_m, width_m = float((upper - lower).max()), float((upper - lower)[:2].max())
    gel_width_m = float(np.ptp(skin_m, axis=0)[:2].max())
    if width_m > gel_width_m or extent_m < LIKELY_EXTENT_M:
        units = _other_units(extent_m / indenter.file_unit_m, gel_width_m)
        _warn_once(
            f"the mesh {indenter.name!r} is {1e3 * width_m:.3g} mm wide and "
            f"{1e3 * extent_m:.3g} mm long, the gel {1e3 * gel_width_m:.3g} mm wide; is the mesh "
            f"in another unit ({units})?"
        )
    if np.any(lower[:2] > AXIS_TOLERANCE_M) or np.any(upper[:2] < -AXIS_TOLERANCE_M):
        (left, front, _), (right, back, _) = 1e3 * lower, 1e3 * upper
        _warn_once(
            f"the mesh {indenter.name!r} reaches from {left:.3g} to {right:.3g} mm along x and "
            f"from {front:.3g} to {back:.3g} mm along y, past its own axis x = y = 0, where poses "
            "place it; 'origin: tip' in its definition moves its lowest point there"
        )


@functools.lru_cache(maxsize=256)
def _warn_once(text: str) -> None:
    # A gel is given the same indenter in every trial of a fit.
    _log.warning(text)


def _rounded(inner: FloatArray, radius: float) -> FloatArray:
    outside = np.linalg.norm(np.maximum(inner, 0.0), axis=1)
    return np.asarray(outside + np.minimum(inner.max(axis=1), 0.0) - radius)


def _meridian(points: FloatArray) -> FloatArray:
    return np.stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]], axis=1)


def _sphere_distance(points: FloatArray, radius: float) -> FloatArray:
    return np.asarray(np.linalg.norm(points - [0.0, 0.0, radius], axis=1) - radius)


def _box_distance(
    points: FloatArray, size_x: float, size_y: float, size_z: float, edge: float
) -> FloatArray:
    half = np.array([size_x, size_y, size_z]) / 2.0
    return _rounded(np.abs(points - [0.0, 0.0, half[2]]) - (half - edge), edge)


def _cylinder_distance(points: FloatArray, radius: float, length: float, edge: float) -> FloatArray:
    inner = _meridian(points) - [0.0, length / 2.0]
    inner[:, 1] = np.abs(inner[:, 1])
    return _rounded(inner - [radius - edge, length / 2.0 - edge], edge)


def _cone_distance(points: FloatArray, half_angle: float, height: float, tip: float) -> FloatArray:
    # A sharp cone from z = tip to height - tip, grown by the tip's radius.
    rho, z = _meridian(points).T
    inner_height = height - 2.0 * tip
    sine, cosine = np.sin(half_angle), np.cos(half_angle)
    up = z - tip
    along = np.clip(rho * sine + up * cosine, 0.0, inner_height / cosine)
    flank = np.hypot(rho - along * sine, up - along * cosine)
    face = np.hypot(rho - np.clip(rho, 0.0, inner_height * sine / cosine), up - inner_height)
    inside = (rho * cosine < up * sine) & (up < inner_height)
    return np.asarray(np.where(inside, -1.0, 1.0) * np.minimum(flank, face) - tip)


def _capsule_distance(points: FloatArray, radius: float, length: float) -> FloatArray:
    rho, z = _meridian(points).T
    return np.asarray(np.hypot(rho, z - np.clip(z, radius, radius + length)) - radius)


def _torus_distance(points: FloatArray, major: float, minor: float) -> FloatArray:
    rho, z = _meridian(points).T
    return np.asarray(np.hypot(rho - major, z - minor) - minor)


def _primitive_bounds(
    kind: IndenterKind, parameters: tuple[float, ...]
) -> tuple[FloatArray, FloatArray]:
    match kind:
        case IndenterKind.SPHERE:
            half, height = (parameters[0],) * 2, 2.0 * parameters[0]
        case IndenterKind.BOX:
            half, height = (parameters[0] / 2.0, parameters[1] / 2.0), parameters[2]
        case IndenterKind.CYLINDER:
            half, height = (parameters[0],) * 2, parameters[1]
        case IndenterKind.CONE:
            angle, height, tip = parameters
            half = ((height - 2.0 * tip) * np.tan(angle) + tip,) * 2
        case IndenterKind.CAPSULE:
            half, height = (parameters[0],) * 2, parameters[1] + 2.0 * parameters[0]
        case IndenterKind.TORUS:
            half, height = (parameters[0] + parameters[1],) * 2, 2.0 * parameters[1]
        case _:
            raise ValueError(f"{kind!r} is no primitive")
    return np.array([-half[0], -half[1], 0.0]), np.array([half[0], half[1], height])


def way_m(start: Pose, end: Pose, indenter: Indenter) -> float:
    """Return how far an indenter's points move at most between two poses, roughly."""
    cosine = abs(float(start.quaternion_xyzw @ end.quaternion_xyzw))
    turn = 2.0 * np.arccos(min(1.0, cosine))
    shift = float(np.linalg.norm(end.position_m - start.position_m))
    return shift + float(turn) * min(indenter._radius_m, LARGEST_LEVER_M)


_PRIMITIVE_DISTANCE: dict[IndenterKind, Callable[..., FloatArray]] = {
    IndenterKind.SPHERE: _sphere_distance,
    IndenterKind.BOX: _box_distance,
    IndenterKind.CYLINDER: _cylinder_distance,
    IndenterKind.CONE: _cone_distance,
    IndenterKind.CAPSULE: _capsule_distance,
    IndenterKind.TORUS: _torus_distance,
}

_FACTORIES: dict[str, Callable[..., Indenter]] = {
    make.__name__: make
    for make in (sphere, box, box_edge, flat_punch, lying_cylinder, capsule, cone, torus)
}
