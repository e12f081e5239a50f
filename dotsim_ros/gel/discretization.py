# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Particles, grid and the weights between them, computed once in the rest configuration.

Total-Lagrangian Material Point Method: the grid never moves relative to the rest shape, so weights
and sparsity are fixed (de Vaucorbeil, Nguyen and Hutchinson, "A Total-Lagrangian Material Point
Method for solid mechanics problems involving large deformations", 2020). Quadratic B-splines as in
Steffen, Kirby and Berzins, "Analysis and reduction of quadrature errors in the material point
method", 2008.

Nodes lie at the centres of the cells, (i + 1/2) h, so that the base plane z = 0 is a knot plane:
a mirrored node with the opposite displacement makes the displacement vanish there exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dotsim_ros.gel.body import Body
from dotsim_ros.gel.reshape import ReshapedDome, ReshapedPad
from dotsim_ros.io.arrays import FloatArray, IndexArray

STENCIL = np.array([(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)])
"""(27, 3) offsets from a cell to the nodes whose splines are not zero in it."""

_GAUSS = 0.5 / np.sqrt(3.0)
_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


@dataclass(frozen=True)
class Interpolation:
    """Values of a nodal field at fixed points of the rest configuration.

    Attributes:
        node_index: (P, 27) int32 nodes of each point.
        weight: (P, 27) weights; negative on nodes mirrored at the base.
    """

    node_index: IndexArray
    weight: FloatArray

    def matrix(self, node_count: int) -> sparse.csr_matrix:
        """Return the (P, node_count) sparse matrix of the weights."""
        rows = np.repeat(np.arange(len(self.node_index)), 27)
        shape = (len(self.node_index), node_count)
        return sparse.coo_matrix(
            (self.weight.ravel(), (rows, self.node_index.ravel())), shape=shape
        ).tocsr()


@dataclass(frozen=True)
class Discretization:
    """Everything about the gel that depends on its rest shape and the grid alone.

    Attributes:
        spacing_m: grid spacing h.
        node_position_m: (N, 3) rest positions of the active nodes.
        node_cell: (N, 3) integer grid coordinates of the nodes.
        particle_position_m: (P, 3) rest positions (Gauss points; centroids in cut cells).
        particle_volume_m3: (P,) volumes V_p.
        particle_interpolation: weights w_ip of the particles.
        particle_weight_gradient: (P, 27, 3) gradients of the weights, 1/m.
        skin_interpolation: weights at the skin markers.
        bond: (N, N) sparse matrix of sum(area w w^T) over the bonded core's surface, m^2.
        ghost: (N, N) sparse matrix of the third differences next to poorly supported nodes.
        mass_over_density: (N, N) sparse matrix of sum(V w w^T), m^3.
    """

    spacing_m: float
    node_position_m: FloatArray
    node_cell: NDArray[np.int64]
    particle_position_m: FloatArray
    particle_volume_m3: FloatArray
    particle_interpolation: Interpolation
    particle_weight_gradient: FloatArray
    skin_interpolation: Interpolation
    bond: sparse.csr_matrix
    ghost: sparse.csr_matrix
    mass_over_density: sparse.csr_matrix

    @property
    def node_count(self) -> int:
        return len(self.node_position_m)

    @property
    def particle_count(self) -> int:
        return len(self.particle_volume_m3)


def spline_weights(points_m: FloatArray, spacing_m: float) -> tuple[FloatArray, FloatArray]:
    """Return weights (P, 27) and their gradients (P, 27, 3) of points (P, 3), in 1/m."""
    fraction = points_m / spacing_m - np.floor(points_m / spacing_m) - 0.5
    value = np.stack(
        [0.5 * (0.5 - fraction) ** 2, 0.75 - fraction**2, 0.5 * (0.5 + fraction) ** 2], axis=1
    )
    slope = np.stack([fraction - 0.5, -2.0 * fraction, fraction + 0.5], axis=1) / spacing_m
    i, j, k = (STENCIL + 1).T
    x, y, z = value[:, i, 0], value[:, j, 1], value[:, k, 2]
    gradient = np.stack(
        [slope[:, i, 0] * y * z, x * slope[:, j, 1] * z, x * y * slope[:, k, 2]], axis=-1
    )
    return x * y * z, gradient


def spline_curvatures(points_m: FloatArray, spacing_m: float) -> FloatArray:
    """Return the second derivatives (P, 27, 3, 3) of the weights of points (P, 3), in 1/m^2."""
    fraction = points_m / spacing_m - np.floor(points_m / spacing_m) - 0.5
    value = np.stack(
        [0.5 * (0.5 - fraction) ** 2, 0.75 - fraction**2, 0.5 * (0.5 + fraction) ** 2], axis=1
    )
    slope = np.stack([fraction - 0.5, -2.0 * fraction, fraction + 0.5], axis=1) / spacing_m
    bend = np.array([1.0, -2.0, 1.0]) / spacing_m**2
    number = (STENCIL + 1).T
    result = np.empty((len(points_m), 27, 3, 3))
    for i in range(3):
        for j in range(3):
            product = np.ones((len(points_m), 27))
            for axis in range(3):
                order = (axis == i) + (axis == j)
                if order == 2:
                    product *= bend[number[axis]]
                else:
                    product *= (slope if order else value)[:, number[axis], axis]
            result[:, :, i, j] = product
    return result


def _quadrature(body: Body, spacing_m: float) -> tuple[FloatArray, FloatArray]:
    """Return particle positions (P, 3) and volumes (P,): Gauss points in full cells of the grid,
    centroids of the material in the eighths of cut cells."""
    lower, upper = body.bounds_m()
    first = np.floor(lower / spacing_m - 1e-9).astype(int)
    last = np.ceil(upper / spacing_m + 1e-9).astype(int)
    axes = [np.arange(a, b) for a, b in zip(first, last, strict=True)]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    samples_per_axis = 6
    offset = (np.arange(samples_per_axis) + 0.5) / samples_per_axis - 0.5
    sub = np.stack(np.meshgrid(offset, offset, offset, indexing="ij"), axis=-1).reshape(-1, 3)
    full_centre, cut_mean, cut_share = [], [], []
    # A few cells at a time, whose samples stay in the processor's cache.
    for first in range(0, len(cells), 32):
        centre = (cells[first : first + 32] + 0.5) * spacing_m
        eighth = centre[:, None, :] + 0.25 * spacing_m * _CORNERS[None]
        points = eighth[:, :, None, :] + 0.5 * spacing_m * sub[None, None]
        inside = body.contains(points)
        share = inside.mean(axis=2)
        full = np.all(share == 1.0, axis=1)
        cut = (~full[:, None]) & (share > 0.0)
        part = inside[cut]
        full_centre.append(centre[full])
        cut_mean.append(
            np.einsum("esx,es->ex", points[cut], part) / part.sum(axis=1, keepdims=True)
        )
        cut_share.append(share[cut])
    gauss = np.concatenate(full_centre)[:, None, :] + _GAUSS * spacing_m * _CORNERS[None]
    position = np.concatenate([gauss.reshape(-1, 3), *cut_mean])
    share = np.concatenate([np.ones(8 * len(gauss)), *cut_share])
    return position, share * (spacing_m**3 / 8.0)


def _nodes_of_cells(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the grid coordinates (n, 3), with repetitions, of all nodes of cells (C, 3)."""
    stencil = (cells[:, None, :] + STENCIL[None]).reshape(-1, 3)
    mirrored = np.where(stencil[:, 2] < 0)[0]
    stencil[mirrored, 2] = -1 - stencil[mirrored, 2]
    return stencil


class _NodeNumbers:
    """Numbers of the active nodes; nodes below the base are mirrored with the opposite sign."""

    def __init__(self, node_cell: NDArray[np.int64]) -> None:
        self.lower = node_cell.min(axis=0)
        self.shape = tuple(node_cell.max(axis=0) - self.lower + 1)
        flat = np.ravel_multi_index(tuple((node_cell - self.lower).T), self.shape)
        self.cells_flat = np.unique(flat)
        self.number = np.full(int(np.prod(self.shape)), -1, dtype=np.int32)
        self.number[self.cells_flat] = np.arange(len(self.cells_flat), dtype=np.int32)

    def node_cells(self) -> NDArray[np.int64]:
        return np.stack(np.unravel_index(self.cells_flat, self.shape), axis=-1) + self.lower

    def look_up(self, cells: NDArray[np.int64]) -> tuple[IndexArray, FloatArray]:
        """Return numbers (..., ) and signs of grid coordinates (..., 3); -1 where inactive."""
        cells = cells.copy()
        sign = np.where(cells[..., 2] < 0, -1.0, 1.0)
        cells[..., 2] = np.where(cells[..., 2] < 0, -1 - cells[..., 2], cells[..., 2])
        local = cells - self.lower
        valid = np.all((local >= 0) & (local < np.array(self.shape)), axis=-1)
        local = np.where(valid[..., None], local, 0)
        flat = np.ravel_multi_index(tuple(np.moveaxis(local, -1, 0)), self.shape)
        return np.where(valid, self.number[flat], -1).astype(np.int32), sign


def _interpolation(
    points_m: FloatArray, spacing_m: float, numbers: _NodeNumbers
) -> tuple[Interpolation, FloatArray]:
    cell = np.floor(points_m / spacing_m).astype(np.int64)
    index, sign = numbers.look_up(cell[:, None, :] + STENCIL[None])
    weight, gradient = spline_weights(points_m, spacing_m)
    return Interpolation(index, weight * sign), gradient * sign[..., None]


def _outer_sum(interpolation: Interpolation, measure: FloatArray, count: int) -> sparse.csr_matrix:
    matrix = interpolation.matrix(count)
    return (matrix.T @ sparse.diags(measure) @ matrix).tocsr()


def _third_differences(
    node_cell: NDArray[np.int64], numbers: _NodeNumbers, supported: FloatArray
) -> sparse.csr_matrix:
    """Return D^T D of the third differences along grid lines that touch a poorly supported node
    (the ghost penalty of Burman, "Ghost penalty", 2010, on a spline grid)."""
    count = len(node_cell)
    blocks = []
    for axis in range(3):
        step = np.zeros(3, dtype=np.int64)
        step[axis] = 1
        line = node_cell[:, None, :] + np.arange(4)[None, :, None] * step
        index, _ = numbers.look_up(line)
        keep = np.all(index >= 0, axis=1)
        keep[keep] = np.any(supported[index[keep]] < 0.5, axis=1)
        index = index[keep]
        rows = np.repeat(np.arange(len(index)), 4)
        values = np.tile([1.0, -3.0, 3.0, -1.0], len(index))
        blocks.append(
            sparse.coo_matrix((values, (rows, index.ravel())), shape=(len(index), count)).tocsr()
        )
    stacked = sparse.vstack(blocks)
    return (stacked.T @ stacked).tocsr()


def images_of_cells(cells: NDArray[np.int64], body: Body) -> NDArray[np.int64]:
    """Return (S, C, 3) the cells (C, 3) under the body's symmetries."""
    unique = np.unique(cells, axis=0)
    return np.floor((unique + 0.5) @ body.symmetries.transpose(0, 2, 1)).astype(np.int64)


def bonded_points(body: Body, spacing_m: float) -> tuple[FloatArray, FloatArray]:
    """Return points (B, 3) on the bonded surface above the base, and their areas (B,)."""
    if isinstance(body, ReshapedDome | ReshapedPad):
        points, area = bonded_points(body.reference, spacing_m)
        moved, _, ratio = body.from_reference(points)
        return moved, area * ratio
    return body.bonded_surface(0.25 * spacing_m)


def interpolation_at(
    discretization: Discretization, points_m: FloatArray
) -> tuple[Interpolation, FloatArray, FloatArray]:
    """Return the weights of points (P, 3) of the gel, their gradients (P, 27, 3), 1/m, and their
    second derivatives (P, 27, 3, 3), 1/m^2."""
    h = discretization.spacing_m
    numbers = _NodeNumbers(discretization.node_cell)
    interpolation, gradient = _interpolation(points_m, h, numbers)
    _, sign = numbers.look_up(np.floor(points_m / h).astype(np.int64)[:, None, :] + STENCIL[None])
    return interpolation, gradient, spline_curvatures(points_m, h) * sign[..., None, None]


def discretize(body: Body, skin_position_m: FloatArray, spacing_m: float) -> Discretization:
    """Build particles, nodes and weights of a body.

    Args:
        body: the shape.
        skin_position_m: (V, 3) rest positions of the skin markers.
        spacing_m: grid spacing h.

    Raises:
        ValueError: the spacing is not positive or leaves fewer than two cells across the body, or
            across what it is stretched from: its grid stays, so that only the gel changes.
    """
    own = body.reference if isinstance(body, ReshapedDome | ReshapedPad) else body
    extent = np.ptp(own.bounds_m(), axis=0).min()
    if not 0.0 < spacing_m <= extent / 2.0:
        raise ValueError(
            f"grid spacing is {spacing_m} m, expected between 0 and half the smallest extent of "
            f"the body ({extent / 2.0:.4g} m)"
        )
    # Markers on a knot plane belong to the cell inside; the base ring lies on z = 0 exactly.
    inward = 1.0 - 1e-9
    skin = skin_position_m * inward
    bonded, bonded_area = bonded_points(body, spacing_m)
    if isinstance(body, ReshapedDome | ReshapedPad):
        position, volume = _quadrature(body.reference, spacing_m)
        position, ratio, _ = body.from_reference(position)
        volume = volume * ratio
    else:
        position, volume = _quadrature(body, spacing_m)
    cells = np.floor(np.concatenate([position, skin, bonded]) / spacing_m).astype(np.int64)
    numbers = _NodeNumbers(
        _nodes_of_cells(np.unique(images_of_cells(cells, body).reshape(-1, 3), axis=0))
    )
    node_cell = numbers.node_cells()
    particles, gradient = _interpolation(position, spacing_m, numbers)
    skin_interpolation, _ = _interpolation(skin, spacing_m, numbers)
    bonded_interpolation, _ = _interpolation(bonded, spacing_m, numbers)
    count = len(node_cell)
    support = np.zeros(count)
    np.add.at(support, particles.node_index, np.abs(particles.weight) * volume[:, None])
    return Discretization(
        spacing_m=spacing_m,
        node_position_m=np.asarray((node_cell + 0.5) * spacing_m, dtype=np.float64),
        node_cell=node_cell,
        particle_position_m=position,
        particle_volume_m3=volume,
        particle_interpolation=particles,
        particle_weight_gradient=gradient,
        skin_interpolation=skin_interpolation,
        bond=_outer_sum(bonded_interpolation, bonded_area, count),
        ghost=_third_differences(node_cell, numbers, support / spacing_m**3),
        mass_over_density=_outer_sum(particles, volume, count),
    )
