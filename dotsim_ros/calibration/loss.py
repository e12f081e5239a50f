# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a simulated press misses of a measured one, in units of the measurement's noise.

The losses: the skin point to point where the clouds list the skin's vertices, or the paper's
bidirectional Chamfer distance where they do not, and the force. A fit minimises half the sum of
their squares.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dotsim_ros.data.presses import Press
from dotsim_ros.geometry.skin_mesh import SkinMesh, tip_depth_m
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.twin.follow import SimulatedPress

SKIN, FORCE = "skin", "force"
POINTS, CHAMFER = "points", "chamfer"


@dataclass(frozen=True)
class LossNoise:
    """One standard deviation of each error of the measurement.

    The error of discretisation is the same over a patch of the skin, so that the points of a patch
    count as one: an error s of white noise and one d of n points that err together have the
    variance s^2 + n d^2 each.

    Attributes:
        skin_m: white noise of a skin point, an axis.
        skin_discretisation_m: of the measured skin, an axis, the same over a patch...
        patch_radius_m: ...of this radius.
        force_n: white noise of the force, an axis.
        force_discretisation: of the force, relative, in the main the same in all frames.
        pose_m: of the indenter's position, an axis; prior of its offset.
        pose_rad: of the indenter's rotation, an axis; prior of its offset.
    """

    skin_m: float = 0.04e-3
    skin_discretisation_m: float = 0.1e-3
    patch_radius_m: float = 2.4e-3
    force_n: float = 0.015
    force_discretisation: float = 0.06
    pose_m: float = 0.015e-3
    pose_rad: float = 1.5e-3

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            # An error that a patch, or all frames, have in common may be none.
            least = "0 or more" if "discretisation" in name else "above 0"
            if not math.isfinite(value) or value < 0.0 or (value == 0.0 and least == "above 0"):
                raise ValueError(f"noise {name} is {value}, expected a number {least}")

    def skin_point_m(self, skin: SkinMesh) -> float:
        """Return the deviation of an axis of a point that its weight is the inverse of."""
        area = float(np.mean(skin.rest_area_m2))
        together = max(1.0, np.pi * self.patch_radius_m**2 / area)
        return float(np.hypot(self.skin_m, np.sqrt(together) * self.skin_discretisation_m))

    def offset(self) -> FloatArray:
        """Return the deviations (6,) of an indenter's offset: metres, radians."""
        return np.array([self.pose_m] * 3 + [self.pose_rad] * 3)


@dataclass(frozen=True)
class Partners:
    """Which points the Chamfer distance compares, frame by frame.

    Attributes:
        of_measured: (F, M) number of the simulated point nearest to each measured one.
        of_simulated: (F, V) number of the measured point nearest to each simulated one.
    """

    of_measured: NDArray[np.int64]
    of_simulated: NDArray[np.int64]


def nearest_partners(press: Press, simulated: SimulatedPress) -> Partners | None:
    """Return the nearest neighbours both ways; None where no skin was measured."""
    if press.skin_position_m is None:
        return None
    there, back = [], []
    for measured, own in zip(press.skin_position_m, simulated.skin_position_m, strict=True):
        there.append(cKDTree(own).query(measured)[1])
        back.append(cKDTree(measured).query(own)[1])
    return Partners(np.stack(there), np.stack(back))


def residuals(
    press: Press,
    simulated: SimulatedPress,
    noise: LossNoise,
    skin: SkinMesh,
    partners: Partners | None,
) -> dict[str, FloatArray]:
    """Return simulated minus measured over noise, (n,) for each channel that was measured, at the
    same poses. Without partners of the Chamfer distance the skin is compared point to point."""
    result = {}
    if press.skin_position_m is not None:
        own, measured = simulated.skin_position_m, press.skin_position_m
        sigma = noise.skin_point_m(skin)
        if partners is None:
            missed = ((own - measured)[:, ~skin.on_base] / sigma).ravel()
        else:
            frame = np.arange(len(own))[:, None]
            there = (own[frame, partners.of_measured] - measured) / sigma
            back = (own - measured[frame, partners.of_simulated]) / sigma
            # Both ways see the same errors, so each counts half.
            missed = np.sqrt(0.5) * np.concatenate([there.ravel(), back.ravel()])
        result[SKIN] = missed
    if press.force_n is not None:
        sigma_n = force_deviation_n(press, noise, skin)
        result[FORCE] = ((simulated.force_n - press.force_n) / sigma_n).ravel()
    return result


def force_deviation_n(press: Press, noise: LossNoise, skin: SkinMesh) -> FloatArray:
    """Return the deviation (F, 1) of an axis of the force in each frame.

    A surface that is off by d changes the depth of a press by as much, and with it the force, which
    grows with the depth's power of 3/2 (Hertz): shallow frames hold little information.
    """
    assert press.force_n is not None
    d = noise.skin_discretisation_m
    depth_m = np.maximum(tip_depth_m(skin, press.poses), max(d, 1.0e-6))
    relative = np.hypot(noise.force_discretisation, 1.5 * d / depth_m)
    size = np.linalg.norm(press.force_n, axis=1)
    return np.asarray(np.hypot(noise.force_n, relative * size)[:, None])
