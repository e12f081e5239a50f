# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Photographs of a ball on a flat gel, next to what this package's pad does under the ball.

Neither the ball's pose nor the force is known of such photographs, only the circle of contact: the
depth is the one that makes that circle. The pad is wide, so the press is solved once in its middle,
and its displacement, a function of the distance from the ball's axis, is laid where the circle is.

The camera looks straight at the pad through a lens without distortion, so that a millimetre of the
flat gel has the same number of pixels everywhere. How far away it is is not known either; what it
sees depends on that little.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dotsim_ros.data.contact_circle import BallPress
from dotsim_ros.gel.implicit.gel import CORE_CLEARANCE_M, PressTooDeepError
from dotsim_ros.gel.make import Gel, make_gel, skin_of
from dotsim_ros.geometry.camera import Camera, PinholeCamera
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray, ImageArray
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.lighting import Lighting
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.footage import OpticalPress, Rest

CAMERA_DISTANCE_M = 0.03
"""Distance of the camera from the pad's face; such sensors are about as large."""
FIRST_DEPTH, LAST_DEPTH, DEPTH_COUNT = 0.4 / 2.35, 2.4 / 2.35, 21
"""Depths of the presses that are solved, over the ball's radius."""
WIDER = 2.0
"""The deepest of them makes a circle so many times wider than the widest that is asked for; wider
ones would only take their time, and depth that a pad may not have."""
CLEARANCE_MARGIN_M = 0.1e-3
LEAST_PAD_M = round(CORE_CLEARANCE_M + 2.0 * CLEARANCE_MARGIN_M, 9)
"""Thickness of the thinnest pad that a ball is pressed into."""
STEP_S = 0.05
TOUCHING_M = 40.0e-6
PROFILE_STEP_M = 0.1e-3
UNCHANGING = Lighting(ambient_fraction=1e9)
"""The real sensor's lights are not known; what changes is left to be learned."""


def flat_camera(width: int, height: int, thickness_m: float, pixels_per_metre: float) -> Camera:
    """Return the camera that looks up at a pad's face from below."""
    return PinholeCamera(
        width=width,
        height=height,
        focal_px=pixels_per_metre * CAMERA_DISTANCE_M,
        principal_point_px=np.array([0.5 * (width - 1), 0.5 * (height - 1)]),
        distortion=np.zeros(4),
        pose=Pose(np.array([0.0, 0.0, thickness_m - CAMERA_DISTANCE_M])),
    )


@dataclass(frozen=True)
class PressProfiles:
    """How a ball moves a wide pad's face, D depths.

    Attributes:
        contact_radius_m: (D,) radius of the circle of contact, increasing.
        distance_m: (N,) from the ball's axis, at rest.
        outward_m: (D, N) displacement away from the axis.
        upward_m: (D, N) displacement along +z, negative under the ball.
    """

    contact_radius_m: FloatArray
    distance_m: FloatArray
    outward_m: FloatArray
    upward_m: FloatArray

    def displace(self, skin: SkinMesh, axis_m: FloatArray, contact_radius_m: float) -> FloatArray:
        """Return the skin (V, 3) pressed where the ball's axis (2,) meets the pad, base frame, with
        a circle of contact; beyond the circles known, with the nearest one."""
        known = self.contact_radius_m
        place = float(np.interp(contact_radius_m, known, np.arange(len(known), dtype=np.float64)))
        lower = min(int(place), len(known) - 2)
        share = place - lower
        offset = skin.rest_position_m[:, :2] - axis_m
        distance = np.linalg.norm(offset, axis=1)
        outward, upward = (
            np.interp(
                distance,
                self.distance_m,
                (1.0 - share) * field[lower] + share * field[lower + 1],
            )
            for field in (self.outward_m, self.upward_m)
        )
        direction = offset / np.maximum(distance, 1e-9)[:, None]
        moved = skin.rest_position_m.copy()
        moved[:, :2] += outward[:, None] * direction
        moved[:, 2] += upward
        return moved


def press_depths_m(
    gel: Gel, thickness_m: float, ball_radius_m: float, widest_m: float
) -> FloatArray:
    """Return the depths (D,) to press a ball to, from `FIRST_DEPTH` over `LAST_DEPTH` on.

    They end deep enough for the widest circle of contact, and before the ball is too near the base.
    """
    depths = ball_radius_m * np.linspace(FIRST_DEPTH, LAST_DEPTH, DEPTH_COUNT)
    last = float(depths[-1])
    # By Hertz; a pad's circle is the wider, the thinner it is.
    share = min(1.0, (WIDER * widest_m) ** 2 / ball_radius_m / last)
    try:
        # Between the points of its base the gel takes some balls deeper than its clearance.
        gel.check_depth(Pose(np.array([0.0, 0.0, thickness_m - share * last])))
    except PressTooDeepError:
        share = min(share, (thickness_m - CORE_CLEARANCE_M - CLEARANCE_MARGIN_M) / last)
    return share * depths


def press_profiles(
    sensor: SensorSpecification, ball_radius_m: float, widest_m: float = math.inf
) -> PressProfiles:
    """Press a ball into the middle of a pad, ever deeper, and return what its face does.

    Args:
        sensor: of the pad.
        ball_radius_m: of the ball.
        widest_m: radius of the widest circle of contact that is asked for; by default the ball is
            pressed in as deep as the pad takes it, to little more than its radius.

    Raises:
        ValueError: the pad is too thin, or the gel could not be solved.
    """
    top = sensor.gel.pad_size_m[2]
    if top < LEAST_PAD_M:
        raise ValueError(
            f"the pad is {1e3 * top:g} mm thick, expected {1e3 * LEAST_PAD_M:g} or more: a ball is "
            f"pressed to {1e3 * CORE_CLEARANCE_M:g} mm above the base at most; check its thickness"
        )
    skin = skin_of(sensor.gel)
    gel = make_gel(sensor, skin, sphere(ball_radius_m))
    rest = skin.rest_position_m
    distance = np.linalg.norm(rest[:, :2], axis=1)
    # One ring of vertices after the other: their mean has no direction that the grid prefers.
    ring = np.minimum(distance / PROFILE_STEP_M, 1e6).astype(np.int64)
    inside = distance < 0.5 * min(sensor.gel.pad_size_m[:2])
    counts = np.bincount(ring[inside])
    filled = counts > 0
    mean_distance = np.bincount(ring[inside], distance[inside])[filled] / counts[filled]
    radial = rest[:, :2] / np.maximum(distance, 1e-9)[:, None]
    radii: list[float] = []
    outward: list[FloatArray] = []
    upward: list[FloatArray] = []
    for depth in press_depths_m(gel, top, ball_radius_m, widest_m):
        pose = Pose(np.array([0.0, 0.0, top - depth]))
        position = gel.step(pose, STEP_S).skin_position_m
        motion = position - rest
        gap = np.linalg.norm(position - pose.position_m - [0.0, 0.0, ball_radius_m], axis=1)
        touching = np.linalg.norm(position[:, :2], axis=1)[gap < ball_radius_m + TOUCHING_M]
        radii.append(float(touching.max(initial=0.0)))
        for kept, values in (
            (outward, np.sum(motion[:, :2] * radial, axis=1)),
            (upward, motion[:, 2]),
        ):
            kept.append(np.bincount(ring[inside], values[inside])[filled] / counts[filled])
    # The outermost vertex in contact steps from ring to ring; a parabola goes through the middle.
    depths = np.arange(len(radii), dtype=np.float64)
    smooth = np.polynomial.Polynomial.fit(depths, radii, 2)(depths)
    rising = np.maximum.accumulate(smooth) + 1e-9 * depths
    return PressProfiles(rising, mean_distance, np.stack(outward), np.stack(upward))


@dataclass(frozen=True)
class FlatScene:
    """A camera without distortion over a pad, and what it sees of the gel untouched."""

    camera: Camera
    skin: SkinMesh
    rest: Rest
    pixels_per_metre: float

    def axis_m(self, press: BallPress) -> FloatArray:
        """Return (2,) where the ball's axis meets the pad, base frame."""
        return np.asarray(
            (press.centre_px - self.camera.principal_point_px) / self.pixels_per_metre
        )


def flat_scene(idle: ImageArray, sensor: SensorSpecification, pixels_per_metre: float) -> FlatScene:
    """Return the camera over a pad, with the image without contact.

    Raises:
        ValueError: the pad is smaller than what the camera sees.
    """
    height, width = idle.shape[:2]
    seen, pad = np.array([width, height]) / pixels_per_metre, sensor.gel.pad_size_m[:2]
    if np.any(seen > pad):
        raise ValueError(
            f"at {pixels_per_metre / 1e3:.2f} pixels a millimetre the image of {width}x{height} "
            f"shows {1e3 * seen[0]:.1f} x {1e3 * seen[1]:.1f} mm, more than the pad's "
            f"{1e3 * pad[0]:.1f} x {1e3 * pad[1]:.1f}; check the scale, or give the sensor a "
            "larger pad"
        )
    camera = flat_camera(width, height, sensor.gel.pad_size_m[2], pixels_per_metre)
    skin = skin_of(sensor.gel)
    view = SkinRenderer(camera, skin).render(skin.rest_position_m)
    lit = np.ones(idle.shape[:2], dtype=np.bool_)
    rest = Rest(idle, view.depth_m, view.normal, lit)
    return FlatScene(camera, skin, rest, pixels_per_metre)


def gel_presses(
    presses: Sequence[BallPress], scene: FlatScene, profiles: PressProfiles
) -> list[OpticalPress]:
    """Return the presses with the shape of this package's gel, one frame each."""
    renderer = SkinRenderer(scene.camera, scene.skin)
    image = ImageRenderer(scene.camera, scene.skin, scene.rest.idle, lighting=UNCHANGING)
    seen = []
    for press in presses:
        position = profiles.displace(
            scene.skin, scene.axis_m(press), press.radius_px / scene.pixels_per_metre
        )
        view = renderer.render(position)
        deepest = float((scene.skin.rest_position_m - position)[:, 2].max())
        seen.append(
            OpticalPress(
                name=press.name,
                indenter="ball",
                tip_depth_m=np.array([deepest]),
                measured=press.image[None],
                depth_m=view.depth_m[None],
                normal=view.normal[None],
                warped=image.warp(view)[None],
            )
        )
    return seen
