# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Real presses on a DenseTact, recorded on a CNC stage, as motions on the dome of this package.

The recording (`presses.npz`: `position_mm` (M, 3), `offset` (K + 1,), `sensor` (K,)) holds the
stage's positions only, in millimetres in the stage's frame. What is worked out from them:

- The first points of the presses on one gel lie on a sphere: its centre is the dome's, its radius,
  20.1 mm, is that of the real gel, 16.1 mm, and of a round tip of 4 mm.
- The first points cover the half of that sphere with y above the centre's y (the lowest lies 8.1 mm
  above it, the highest 20.2 mm; in x and z they spread evenly to either side): the dome's axis is
  the stage's +y. `STAGE_TO_BASE` turns +y to +z of the base frame and keeps x. The azimuth of the
  camera about the axis was not recorded.
- Every press is one straight line inwards in steps of 0.1 mm, without times.

A press is put on our dome by moving it as a whole along the outward direction of its first point
by (outer radius + indenter radius) - 20.1 mm. Depths and lengths stay those of the stage, and a
press that began off the real gel begins as far off ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dotsim_ros.data.motion import Motion, at_speed, held, joined, pose_along, reversed_motion
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import ArrayForm, read_arrays

DOME_CENTRE_MM = {
    "hard_gel_sensor_1_auto": (-22.72, -0.96, -22.44),
    "hard_gel_sensor_2_auto": (-22.38, 7.80, -22.85),
}
"""Least-squares centre of the first points of each gel, in the stage's frame."""

FIRST_CONTACT_RADIUS_M = 0.0201
"""Distance of the tip's centre from the dome's at first contact: gel 16.1 mm and tip 4 mm."""

STAGE_TO_BASE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation from the stage's axes to the base frame: +y becomes +z."""


PRESSES_FORMS = {
    "position_mm": ArrayForm((None, 3)),
    "offset": ArrayForm((None,), "whole number"),
    "sensor": ArrayForm((None,), "text"),
}
"""The arrays of a recording of presses."""


@dataclass(frozen=True)
class ShippedPress:
    """One real press on a gel: (N, 3) centre of the round tip in the base frame of the real gel."""

    index: int
    gel: str
    centre_m: FloatArray

    def poses(self, *, outer_radius_m: float, indenter_radius_m: float) -> list[Pose]:
        """Return the indenter's poses on a dome, tip frame in the base frame.

        The indenter's +z points against the press, so that its tip leads. The stage's positions are
        taken for the point `indenter_radius_m` behind the tip: the centre of a sphere.
        """
        first = self.centre_m[0]
        outward = first / np.linalg.norm(first)
        shift = (outer_radius_m + indenter_radius_m - FIRST_CONTACT_RADIUS_M) * outward
        axis = first - self.centre_m[-1]
        axis = axis / np.linalg.norm(axis)
        tips = self.centre_m + shift - indenter_radius_m * axis
        return [pose_along(tip, axis) for tip in tips]

    def motion(
        self,
        *,
        outer_radius_m: float,
        indenter_radius_m: float,
        speed_m_s: float,
        hold_s: float,
        depth_limit_m: float = np.inf,
        clearance_m: float = 0.002,
    ) -> Motion:
        """Return the press from a clearance off its first point, a hold, and the way back.

        It turns where the indenter's centre has come `depth_limit_m` nearer to the dome's than at
        first contact.

        Raises:
            ValueError: a speed, hold, limit or clearance out of range.
        """
        if not (depth_limit_m > 0.0 and clearance_m > 0.0):
            raise ValueError(
                f"depth limit {depth_limit_m} m and clearance {clearance_m} m must be positive"
            )
        poses = self.poses(outer_radius_m=outer_radius_m, indenter_radius_m=indenter_radius_m)
        axis = poses[0].rotation()[:, 2]
        centres = np.array([pose.position_m + indenter_radius_m * axis for pose in poses])
        depth = outer_radius_m + indenter_radius_m - np.linalg.norm(centres, axis=1)
        allowed = [pose for pose, deep in zip(poses, depth, strict=True) if deep <= depth_limit_m]
        start = Pose(
            (allowed or poses)[0].position_m + clearance_m * axis, poses[0].quaternion_xyzw
        )
        way = at_speed([start, *allowed], speed_m_s=speed_m_s)
        return joined(way, held(way.poses[-1], hold_s), reversed_motion(way))


def read_presses(path: str | Path) -> tuple[ShippedPress, ...]:
    """Read a recording of real presses, a `presses.npz`.

    Raises:
        FileNotFoundError: no such file.
        ValueError: it holds no such arrays, arrays that do not fit, or an unknown gel.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no recording of presses at {path}")
    arrays = read_arrays(path, PRESSES_FORMS)
    position_mm = np.asarray(arrays["position_mm"], dtype=np.float64)
    offset = arrays["offset"]
    gels = [str(gel) for gel in arrays["sensor"]]
    fits = (
        offset.shape == (len(gels) + 1,)
        and offset[0] == 0
        and offset[-1] == len(position_mm)
        and bool((np.diff(offset) >= 2).all())
    )
    if not fits:
        raise ValueError(
            f"{path}: offset must rise from 0 to {len(position_mm)} in {len(gels)} steps of at "
            "least 2"
        )
    unknown = sorted(set(gels) - set(DOME_CENTRE_MM))
    if unknown:
        raise ValueError(
            f"{path}: no centre is known for {', '.join(unknown)}; known are "
            f"{', '.join(DOME_CENTRE_MM)}"
        )
    presses = []
    for index, gel in enumerate(gels):
        stage_mm = position_mm[offset[index] : offset[index + 1]] - DOME_CENTRE_MM[gel]
        presses.append(ShippedPress(index, gel, 1e-3 * stage_mm @ STAGE_TO_BASE.T))
    return tuple(presses)
