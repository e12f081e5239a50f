# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Taxim's geometry: the object's shape superposed on the gel's, smoothed by a pyramid of Gaussians.

Si, Yuan: "Taxim: An Example-Based Simulation Model for GelSight Tactile Sensors", RA-L 7(2), 2022,
with the constants of the authors' published code. The height map is the object's where it is below
the gel's surface and the gel's elsewhere. It is smoothed by Gaussians of decreasing width; after
each, the map is put back where the object sinks in by more than a share (published: 0.4) of the
deepest indentation. A last narrow Gaussian smooths everything. Published kernels of 201, 101, 51,
21, 11 and 5 pixels, OpenCV's widths of 30.5, 15.5, 8, 3.5, 2 and 1.1 pixels: each about half of the
one before, so here a ratio that is fitted.

The paper's map is flat. Here it is the indentation along the skin's normals on the skin's mesh, and
a Gaussian is repeated averaging over neighbours: the heat equation du/dt = laplace u up to
t = width^2 / 2, in steps of which each is a weighted mean. The indentation's integral over the skin
stays, as under the paper's Gaussians, and no value leaves the range that was there before. The
markers' motion along the surface, which the paper superposes from unit forces on a finite-element
gel, does not change the surface and is left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.optimize import differential_evolution

from dotsim_ros.data.presses import Prediction, Press
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray
from studies.rivals.clipping import clip_depths, clipped_skin
from studies.rivals.penalty_force import fit_stiffness, penetration_vectors
from studies.rivals.training import (
    MeasuredSurface,
    check_training,
    measured_surface,
    surface_rms_m,
)

LEVELS = 6
SEARCH_FRAMES = 32
GENERATIONS = 8
POPULATION_FACTOR = 6
BOUNDS = ((3.0e-4, 6.0e-3), (0.1, 0.9), (0.05, 0.95), (0.0, 1.0e-3))
"""Searched ranges of the first width (m), of each width over the one before, of the contact's share
and of the last width (m)."""


@dataclass(frozen=True)
class Pyramid:
    """How the height map is smoothed.

    Attributes:
        widest_m: standard deviation of the first Gaussian.
        ratio: width of each Gaussian over the one before.
        contact_share: of the deepest indentation; deeper ones keep the object's shape.
        final_m: standard deviation of the last Gaussian, over everything.
    """

    widest_m: float
    ratio: float
    contact_share: float
    final_m: float


@dataclass(frozen=True)
class SkinSmoother:
    """Gaussian smoothing on a skin mesh.

    Attributes:
        laplacian: (V, V) negative of the mesh's Laplacian, 1/m^2, rows summing to zero.
        step_m2: longest time of the heat equation in which a step is a weighted mean.
    """

    laplacian: sparse.csr_matrix
    step_m2: float

    def smooth(self, values: FloatArray, width_m: float) -> FloatArray:
        """Return values (V, F) smoothed by a Gaussian of a standard deviation."""
        time_m2 = 0.5 * width_m**2
        count = int(np.ceil(time_m2 / self.step_m2))
        for _ in range(count):
            values = values - (time_m2 / count) * (self.laplacian @ values)
        return values


def skin_smoother(skin: SkinMesh) -> SkinSmoother:
    """Return the smoother of a skin, by the cotangent Laplacian (Pinkall and Polthier 1993).

    An edge whose two opposite angles sum to more than a half turn would weigh below zero; it
    weighs nothing instead, so that every step is a mean.
    """
    count = skin.vertex_count
    corner = skin.rest_position_m[skin.triangles]
    weight = sparse.csr_matrix((count, count))
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        to_a, to_b = corner[:, a] - corner[:, k], corner[:, b] - corner[:, k]
        twice_area = np.linalg.norm(np.cross(to_a, to_b), axis=1)
        cotangent = np.sum(to_a * to_b, axis=1) / twice_area
        pair = (skin.triangles[:, a], skin.triangles[:, b])
        half = sparse.coo_matrix((0.5 * cotangent, pair), shape=(count, count)).tocsr()
        weight = weight + half + half.T
    weight = weight.maximum(0.0)
    total = np.asarray(weight.sum(axis=1)).ravel()
    stiffness = sparse.diags(total) - weight
    laplacian = sparse.csr_matrix(sparse.diags(1.0 / skin.rest_area_m2) @ stiffness)
    return SkinSmoother(laplacian, float(1.0 / np.max(total / skin.rest_area_m2)))


def smoothed_depths(smoother: SkinSmoother, depth_m: FloatArray, pyramid: Pyramid) -> FloatArray:
    """Return indentations (F, V) as the pyramid leaves them.

    Args:
        smoother: of the skin.
        depth_m: (F, V) of the clipped skin.
        pyramid: the widths.
    """
    clipped = depth_m.T
    kept = (clipped > pyramid.contact_share * clipped.max(axis=0)) & (clipped > 0.0)
    values = clipped
    for level in range(LEVELS):
        values = smoother.smooth(values, pyramid.widest_m * pyramid.ratio**level)
        values = np.where(kept, clipped, values)
    return smoother.smooth(values, pyramid.final_m).T


@dataclass(frozen=True)
class Taxim:
    """The smoothed superposition, with the force of a rigid penalty.

    Attributes:
        pyramid: how the indentation is smoothed.
        stiffness_n_m: force for each metre of the deepest penetration.
        name: how tables call it.
    """

    pyramid: Pyramid
    stiffness_n_m: float
    name: str = "taxim"

    def predict(self, press: Press, indenter: Indenter, skin: SkinMesh) -> Prediction:
        """Return skin and force at the poses of a press; see `studies.geometry.scores.Model`."""
        depth = clip_depths(skin, press.poses, indenter)
        smooth = smoothed_depths(skin_smoother(skin), depth, self.pyramid)
        force = self.stiffness_n_m * penetration_vectors(skin, depth)
        return Prediction(clipped_skin(skin, smooth), force)


def fit(
    train: Sequence[Press],
    indenters: Mapping[str, Indenter],
    skin: SkinMesh,
    *,
    seed: int = 0,
) -> Taxim:
    """Return Taxim with the pyramid that comes closest to the measured surfaces.

    Differential evolution within `BOUNDS`, of a fixed length, over `SEARCH_FRAMES` frames that the
    seed draws of those in contact; the stiffness is the least-squares one over all frames.

    Args:
        train: presses with skin and force.
        indenters: their indenters, by name.
        skin: the measured skin at rest.
        seed: of the frames and of the search.

    Raises:
        ValueError: no press, one without skin or force, or no contact.
    """
    check_training(train)
    depths = [clip_depths(skin, p.poses, indenters[p.indenter]) for p in train]
    depth = np.concatenate(depths)
    force = np.concatenate([p.force_n for p in train if p.force_n is not None])
    skins = np.concatenate([p.skin_position_m for p in train if p.skin_position_m is not None])
    stiffness = fit_stiffness(penetration_vectors(skin, depth), force)
    touching = np.flatnonzero(depth.max(axis=1) > 0.0)
    count = min(SEARCH_FRAMES, len(touching))
    drawn = np.random.default_rng(seed).choice(touching, size=count, replace=False)
    surfaces = [measured_surface(skins[frame], skin) for frame in drawn]
    pyramid = _closest_pyramid(skin, depth[drawn], surfaces, seed)
    return Taxim(pyramid, stiffness)


def _closest_pyramid(
    skin: SkinMesh, depth_m: FloatArray, surfaces: Sequence[MeasuredSurface], seed: int
) -> Pyramid:
    smoother = skin_smoother(skin)

    def error(parameters: FloatArray) -> float:
        smooth = smoothed_depths(smoother, depth_m, Pyramid(*parameters))
        return surface_rms_m(clipped_skin(skin, smooth), surfaces)

    found = differential_evolution(
        error,
        BOUNDS,
        maxiter=GENERATIONS,
        popsize=POPULATION_FACTOR,
        rng=seed,
        polish=False,
        tol=0.0,
    )
    return Pyramid(*(float(value) for value in found.x))
