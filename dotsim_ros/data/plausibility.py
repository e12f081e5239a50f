# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Whether a measured press can be what it says: coarse gates on force, skin and depth.

They refuse what no gel, gauge or arm gives: a force of the wrong sign or unit, a channel that never
moves, vertices in another order. What sensors do have, drift, scales, offsets of the pose, late
clocks, passes by a wide margin: it is for the fit and the gap finder to see.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from dotsim_ros.data.presses import Press
from dotsim_ros.data.trajectory import Topics
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.skin_mesh import SkinMesh, tip_depth_m
from dotsim_ros.io.arrays import FloatArray

SOFTEST_PA, HARDEST_PA = 2.0e3, 2.0e7
"""Young's moduli of what gels are cast of, from the softest silicone gel to hard polyurethane."""
LEAST_DEPTH_M = 0.5e-3
"""Shallower presses say too little to judge force and skin by them."""
LEAST_SKIN_DEPTH_M = 1.5e-3
"""So deep a press moves the skin, whatever an arm or a base gives way or a pose is off."""
STILL_SHARE = 0.1
"""Of the depth: a skin that moves less from frame to frame does not follow the indenter."""
FAR_M = 3.0e-3
"""How far from its place at rest a point may be beyond the depth of the press and the slide."""
FAR_SHARE = 0.1
"""Share of a frame's points that may be farther."""
FREE_M = 1.0e-3
"""An indenter so far off the skin at rest touches nothing."""
FREE_FORCE_N = 0.5
FREE_FORCE_SHARE = 0.25
"""A force without contact of more than both, the second of the press's largest, is no drift."""
FOLLOWING = 0.1
"""Correlation that a force at least has with the depth; presses, holds and slides have 0.9."""
TOLD_APART = 2.0
"""By what factor the stiffness that one frame shows may leave the range of gels."""


LIKE_M = 4.0e-3
"""Median distance between the skins of a sensor and of its data: units differ by less."""


def check_same_shape(skin: SkinMesh, own: SkinMesh, *, data: str, sensor: str) -> None:
    """Refuse the skin of a data set that is not that of the sensor, both named for the message.

    Raises:
        ValueError: the skins lie apart.
    """
    apart_m = max(
        float(np.median(KDTree(one.rest_position_m).query(other.rest_position_m)[0]))
        for one, other in ((skin, own), (own, skin))
    )
    if apart_m > LIKE_M:
        raise ValueError(
            f"the skin of {data} lies {1e3 * apart_m:.1f} mm off that of the sensor {sensor} "
            f"(median), expected the same shape within {1e3 * LIKE_M:.0f} mm; name the sensor that "
            "was measured with --sensor"
        )


def check_press(
    press: Press, indenter: Indenter, skin: SkinMesh, *, has_vertices: bool, topics: Topics
) -> None:
    """Refuse a press whose channels do not belong together.

    Args:
        press, indenter: as measured.
        skin: at rest; of the data set, or of the sensor where that has none.
        has_vertices: whether the measured skin lists its vertices.
        topics: of its channels, for the message.

    Raises:
        ValueError: force or skin are no answer to the poses.
    """
    depth_m = np.asarray(tip_depth_m(skin, press.poses))
    if press.skin_position_m is not None:
        if has_vertices:
            _check_order(press, skin, depth_m, topics.skin)
        _check_motion(press.skin_position_m, depth_m, topics.skin)
    if press.force_n is not None:
        _check_force(press, indenter, skin, depth_m, topics.wrench)


def _check_order(press: Press, skin: SkinMesh, depth_m: FloatArray, topic: str) -> None:
    """Refuse points that are not where their vertices can be."""
    assert press.skin_position_m is not None
    moved_m = np.linalg.norm(press.skin_position_m - skin.rest_position_m, axis=2)
    tip_m = np.stack([pose.position_m for pose in press.poses])
    # In a slide the skin goes along with the tip.
    way_m = float(
        np.linalg.norm(tip_m[depth_m > 0.0] - tip_m[depth_m > 0.0][:1], axis=1).max(initial=0.0)
    )
    limit_m = FAR_M + way_m
    for frame, far in enumerate(np.mean(moved_m > limit_m, axis=1).tolist()):
        if far > FAR_SHARE:
            raise ValueError(
                f"{topic}, frame {frame}: {100 * far:.0f} % of the points lie more than "
                f"{1e3 * limit_m:.1f} mm from the vertices at rest that they are said to be, "
                "expected the order of skin_mesh.npz in the sensor's base frame; list the points "
                "in that order, or remove skin_mesh.npz so that they need not correspond"
            )


def _check_motion(skin_m: FloatArray, depth_m: FloatArray, topic: str) -> None:
    """Refuse a skin that stays where it is while it is pressed."""
    span_m = float(np.ptp(np.maximum(depth_m, 0.0)))
    if span_m < LEAST_SKIN_DEPTH_M:
        return
    moved_m = float(np.linalg.norm(skin_m - skin_m[int(depth_m.argmin())], axis=2).max())
    if moved_m < STILL_SHARE * span_m:
        raise ValueError(
            f"{topic}: no point moves more than {1e3 * moved_m:.2f} mm while the tip goes "
            f"{1e3 * span_m:.1f} mm deep, expected the skin to follow the indenter; record the "
            "skin of every frame, not that at rest, and check that poses are those of the tip"
        )


def _check_force(
    press: Press, indenter: Indenter, skin: SkinMesh, depth_m: FloatArray, topic: str
) -> None:
    """Refuse a force that does not answer the poses, or that no gel answers with."""
    assert press.force_n is not None
    out_of_gel = np.stack([pose.rotation()[:, 2] for pose in press.poses])
    outward_n = np.sum(press.force_n * out_of_gel, axis=1)
    size_n = np.linalg.norm(press.force_n, axis=1)
    limit_n = max(FREE_FORCE_N, FREE_FORCE_SHARE * float(size_n.max()))
    for frame in np.flatnonzero((size_n > limit_n) & (depth_m < -FREE_M)).tolist():
        distance_m = indenter.distance_from(skin.rest_position_m, press.poses[frame])
        away_m = float(distance_m.min(initial=np.inf))
        if away_m > FREE_M:
            raise ValueError(
                f"{topic}, frame {frame}: a force of {size_n[frame]:.3g} N where the indenter is "
                f"{1e3 * away_m:.1f} mm off the skin, expected none; set the gauge to zero in air, "
                "and stamp pose and force by one clock"
            )
    deepest = int(depth_m.argmax())
    deepest_m = float(depth_m[deepest])
    if deepest_m < LEAST_DEPTH_M:
        return
    place = f"{topic}: at {1e3 * deepest_m:.1f} mm of depth (frame {deepest})"
    is_moving = float(np.ptp(np.maximum(depth_m, 0.0))) >= LEAST_DEPTH_M
    if is_moving and float(np.ptp(press.force_n, axis=0).max()) == 0.0:
        raise ValueError(
            f"{place} the force is {size_n[deepest]:.4g} N, the same as in every other frame; "
            "expected it to grow with the depth; record the gauge while it measures"
        )
    if size_n[deepest] == 0.0:
        raise ValueError(
            f"{place} the force is zero; expected that of the gel on the indenter; record the "
            "gauge while it measures"
        )
    follows = float(np.corrcoef(depth_m, outward_n)[0, 1]) if is_moving else 1.0
    if outward_n[deepest] < 0.0 and (not is_moving or follows < -FOLLOWING):
        raise ValueError(
            f"{place} the force pulls the indenter into the gel, {outward_n[deepest]:.3g} N along "
            "its +z axis; expected the force of the gel on the indenter, which pushes it out: "
            "reverse the sign of the wrench, or turn the indenter's frame so that +z points out of "
            "the gel"
        )
    if not follows >= FOLLOWING:
        raise ValueError(
            f"{place} the force does not follow the press: its correlation with the depth is "
            f"{follows:.2f}, expected near 1 and {FOLLOWING} at least; stamp pose and force by one "
            "clock, and check that both are of the same press"
        )
    # The punch of the area that the indenter takes of the skin at rest shows a stiffness that is
    # half to all of a gel's, whatever its shape.
    inside = indenter.distance_from(skin.rest_position_m, press.poses[deepest]) < 0.0
    area_m2 = float(skin.rest_area_m2[inside].sum())
    if area_m2 == 0.0:
        return
    radius_m = float(np.sqrt(area_m2 / np.pi))
    shown_pa = 0.75 * float(outward_n[deepest]) / (2.0 * radius_m * deepest_m)
    if not SOFTEST_PA / (2.0 * TOLD_APART) <= shown_pa <= TOLD_APART * HARDEST_PA:
        hint = "millinewtons" if shown_pa > HARDEST_PA else "kilonewtons"
        raise ValueError(
            f"{place} the force is {outward_n[deepest]:.3g} N along the indenter's axis, that of a "
            f"gel with a Young's modulus of some {shown_pa:.1e} Pa; expected newtons and "
            f"{SOFTEST_PA:.0e} to {HARDEST_PA:.0e} Pa; if these are {hint}, convert them; else "
            "check the poses"
        )
