# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a camera sees of a skin that a rigid indenter clips: the geometry that Tacto shades."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.twin.footage import OpticalPress
from studies.rivals.clipping import clip_depths, clipped_skin


def clipped_press(
    press: OpticalPress, poses: Sequence[Pose], indenter: Indenter, renderer: SkinRenderer
) -> OpticalPress:
    """Return a press with the depth and the normals of the clipped skin.

    Args:
        press: its frames.
        poses: of the indenter's frame in the base frame, one for each frame.
        indenter: the rigid shape.
        renderer: of the skin at rest, through the press's camera.

    Raises:
        ValueError: another number of poses than of frames.
    """
    if len(poses) != len(press.measured):
        raise ValueError(
            f"{press.name}: {len(poses)} poses and {len(press.measured)} images; a clipped skin "
            "needs one pose for each image, with the same stamp"
        )
    depth = clip_depths(renderer.skin_mesh, poses, indenter)
    views = [renderer.render(position) for position in clipped_skin(renderer.skin_mesh, depth)]
    return replace(
        press,
        depth_m=np.stack([view.depth_m for view in views]),
        normal=np.stack([view.normal for view in views]),
    )
