# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The sections of a sensor's file: every field with its unit, range, default and meaning."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import value_text
from dotsim_ros.io.quantity import check_fields, number_text, quantity

SHAPES = ("dome", "flat_pad", "curved_pad")
METHODS = ("implicit", "explicit")
LAWS = ("neo_hookean", "mooney_rivlin", "yeoh")
PROJECTIONS = ("equidistant", "pinhole")
COLOURS = ("rgb", "grey")

SMALLEST_HEIGHT_M = 5e-4
"""Of a curved pad at its corners."""
LARGEST_LENGTH_M = 0.2
"""Of a gel: that of a large palm. A length in millimetres is beyond it, and so is recognised."""
WIDEST_PINHOLE_DEG = 80.0
"""At half the height of a pinhole's image; beyond it a fisheye is meant."""
WHOLE_CORE_RAD = (0.0, 0.0, math.pi)
"""A patch that is all of the core."""


def face_drop_m(x_m: ArrayLike, y_m: ArrayLike, curvature_per_m: tuple[float, float]) -> FloatArray:
    """Return how far (...,) the face of a curved pad lies below its middle, NaN beyond its arc.

    The face is a biconic surface of conic constants 0: a ball's for equal curvatures, a cylinder's
    for one that is 0.

    Args:
        x_m, y_m: (...,) places, base frame.
        curvature_per_m: along x and y.
    """
    x, y = np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64)
    along_x, along_y = curvature_per_m
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1.0 - (along_x * x) ** 2 - (along_y * y) ** 2)
    return np.asarray((along_x * x**2 + along_y * y**2) / (1.0 + root))


@dataclass(frozen=True)
class GelSpecification:
    """Rest shape of the gel, on the base plane z = 0 and centred on the z axis."""

    shape: str = quantity("dome", choices=SHAPES)
    """Half a ball, a flat block, or a block whose upper face bends down towards its sides."""
    skin_spacing_m: float = quantity(0.5e-3, unit="m", low=5e-5, high=5e-3)
    """Largest distance between neighbouring skin markers; at most half the dome's radius, or half
    the pad's shorter side."""
    outer_radius_m: float = quantity(0.01575, unit="m", low=1e-3, high=LARGEST_LENGTH_M)
    """Radius of the free surface of a dome."""
    core_radius_m: float = quantity(0.006, unit="m", low=0.0, high=LARGEST_LENGTH_M)
    """Radius of the rigid core that a dome is bonded to, less than the outer radius; 0 for none."""
    pad_size_m: tuple[float, float, float] = quantity(
        (0.02, 0.025, 0.004), unit="m", low=5e-4, high=LARGEST_LENGTH_M
    )
    """Lengths of a pad along x and y, and its thickness along z, in its middle."""
    face_radius_m: tuple[float, float] = quantity((0.0, 0.0), unit="m", low=0.0, high=10.0)
    """Radii of the upper face of a curved pad along x and y, 0 for straight: equal ones are a part
    of a ball, one of 0 is a part of a cylinder."""
    bond_slip_share: float = quantity(0.0, low=0.0, high=1.0)
    """How far a dome has come off its core: what the bond lets through of the sliding between skin
    and core under a uniform shear; 0 is bonded, 1 slides freely. Implicit solver only."""
    loose_patch_rad: tuple[float, float, float] = quantity(
        WHOLE_CORE_RAD, unit="rad", low=-math.pi, high=math.pi
    )
    """Where it has come off, seen from the core's centre: the patch's middle as an angle from the z
    axis towards x and towards y, and its radius; pi is the whole core."""

    def __post_init__(self) -> None:
        check_fields("gel", self)
        if self.core_radius_m >= self.outer_radius_m:
            raise ValueError(
                f"gel.core_radius_m is {self.core_radius_m}, expected less than "
                f"gel.outer_radius_m ({self.outer_radius_m} m)"
            )
        is_dome = self.shape == "dome"
        self._check_face()
        if self.bond_slip_share > 0.0 and not (is_dome and self.core_radius_m > 0.0):
            raise ValueError(
                f"gel.bond_slip_share is {self.bond_slip_share}, expected 0 for a gel without a "
                "core: a dome with gel.core_radius_m above 0 has one"
            )
        if not self.loose_patch_rad[2] > 0.0:
            raise ValueError(
                f"gel.loose_patch_rad ends with a radius of {self.loose_patch_rad[2]}, expected "
                "more than 0; gel.bond_slip_share is 0 for a gel that is bonded everywhere"
            )
        side_m = self.outer_radius_m if is_dome else min(self.pad_size_m[:2])
        if self.skin_spacing_m > 0.5 * side_m:
            raise ValueError(
                f"gel.skin_spacing_m is {self.skin_spacing_m}, expected at most half of "
                f"{'gel.outer_radius_m' if is_dome else 'the shorter side of gel.pad_size_m'} "
                f"({number_text(0.5 * side_m)} m)"
            )

    def _check_face(self) -> None:
        text = f"gel.face_radius_m is {value_text(self.face_radius_m)}"
        if self.shape != "curved_pad":
            if any(self.face_radius_m):
                raise ValueError(
                    f"{text}, expected [0, 0] for the shape {self.shape!r}: 'curved_pad' has radii"
                )
            return
        x, y, thickness = self.pad_size_m
        corner_m = thickness - float(face_drop_m(0.5 * x, 0.5 * y, self.face_curvature_per_m))
        if not corner_m >= SMALLEST_HEIGHT_M:
            raise ValueError(
                f"{text}, which leaves less than {number_text(SMALLEST_HEIGHT_M)} m of gel at the "
                f"corners of a pad of gel.pad_size_m {value_text(self.pad_size_m)}; make it "
                "flatter or thicker"
            )

    @property
    def face_curvature_per_m(self) -> tuple[float, float]:
        """Curvature of a pad's upper face along x and y."""
        x, y = (1.0 / radius if radius > 0.0 else 0.0 for radius in self.face_radius_m)
        return x, y

    @property
    def bounds_m(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Lower and upper corner of a box around the gel."""
        if self.shape == "dome":
            r = self.outer_radius_m
            return (-r, -r, 0.0), (r, r, r)
        x, y, z = self.pad_size_m
        return (-0.5 * x, -0.5 * y, 0.0), (0.5 * x, 0.5 * y, z)

    @property
    def extent_m(self) -> float:
        """How far the gel reaches from the z axis, along x or y."""
        return max(self.bounds_m[1][:2])

    @property
    def thickness_m(self) -> float:
        """Thickness of the gel on the z axis."""
        if self.shape == "dome":
            return self.outer_radius_m - self.core_radius_m
        return self.pad_size_m[2]

    @property
    def skin_area_m2(self) -> float:
        """Area of the skin at rest."""
        if self.shape == "dome":
            return 2.0 * math.pi * self.outer_radius_m**2
        return self.pad_size_m[0] * self.pad_size_m[1]

    @property
    def volume_m3(self) -> float:
        """Volume of the gel at rest."""
        if self.shape == "dome":
            return 2.0 / 3.0 * math.pi * (self.outer_radius_m**3 - self.core_radius_m**3)
        return math.prod(self.pad_size_m)

    def has_behind(self, point_m: Iterable[float]) -> bool:
        """Return whether a point (3,) lies behind the skin, where a camera sees its inner side."""
        x, y, z = (float(v) for v in point_m)
        if self.shape != "dome":
            # Next to the pad as at its edge.
            x, y = (
                min(max(place, -0.5 * length), 0.5 * length)
                for place, length in zip((x, y), self.pad_size_m[:2], strict=True)
            )
            return z < self.pad_size_m[2] - float(face_drop_m(x, y, self.face_curvature_per_m))
        return math.hypot(x, y, max(z, 0.0)) < self.outer_radius_m


@dataclass(frozen=True)
class MaterialSpecification:
    """The gel's law: `neo_hookean` takes E and nu; the others take their constants and K."""

    law: str = quantity("neo_hookean", choices=LAWS)
    """Elastic law."""
    youngs_modulus_pa: float = quantity(3.0e5, unit="Pa", low=1e2, high=1e9)
    """E of neo_hookean, from a loose jelly to a hard rubber."""
    poisson_ratio: float = quantity(0.48, low=0.0, high=0.4999)
    """nu of neo_hookean."""
    c10_pa: float = quantity(0.0, unit="Pa", low=-1e9, high=1e9)
    """C10 of mooney_rivlin and yeoh."""
    c01_pa: float = quantity(0.0, unit="Pa", low=-1e9, high=1e9)
    """C01 of mooney_rivlin."""
    c20_pa: float = quantity(0.0, unit="Pa", low=-1e9, high=1e9)
    """C20 of yeoh."""
    c30_pa: float = quantity(0.0, unit="Pa", low=-1e9, high=1e9)
    """C30 of yeoh."""
    bulk_modulus_pa: float = quantity(0.0, unit="Pa", low=0.0, high=1e13)
    """K of mooney_rivlin and yeoh; the limit is that of the largest E at the largest nu."""
    prony_shares: tuple[float, ...] = quantity((), low=0.0, high=1.0, excludes_low=True)
    """Shares of the shape-changing stress that relax, together below 1; none: elastic."""
    prony_times_s: tuple[float, ...] = quantity((), unit="s", low=1e-6, high=1e7)
    """Times in which they relax, as many."""
    density_kg_m3: float = quantity(1070.0, unit="kg/m^3", low=1.0, high=3e4)
    """Density; it matters to dynamic and explicit solvers only."""

    def __post_init__(self) -> None:
        check_fields("material", self)
        if len(self.prony_shares) != len(self.prony_times_s):
            raise ValueError(
                f"material.prony_shares has {len(self.prony_shares)} entries and "
                f"material.prony_times_s has {len(self.prony_times_s)}, expected as many"
            )
        if sum(self.prony_shares) >= 1.0:
            raise ValueError(
                f"material.prony_shares is {value_text(self.prony_shares)}, expected a sum below 1"
            )
        bulk_pa = {"bulk_modulus_pa": self.bulk_modulus_pa}
        needed: dict[str, dict[str, float]] = {
            "neo_hookean": {},
            "mooney_rivlin": {"c10_pa + material.c01_pa": self.c10_pa + self.c01_pa} | bulk_pa,
            "yeoh": {"c10_pa": self.c10_pa} | bulk_pa,
        }
        for name, value in needed[self.law].items():
            if not value > 0.0:
                raise ValueError(
                    f"material.{name} is {value}, expected a positive number of Pa for the law "
                    f"{self.law}"
                )


@dataclass(frozen=True)
class ContactSpecification:
    """Contact of the skin with the indenter."""

    friction_coefficient: float = quantity(0.4, low=0.0, high=5.0)
    """mu of Coulomb's law."""
    stiffness: float = quantity(120.0, low=0.0, high=1e5, excludes_low=True)
    """Stiffness of the contact, in units of Young's modulus over 1.2 mm; the skin's penetration is
    the pressure divided by it."""
    tangential_ratio: float = quantity(0.25, low=0.0, high=100.0, excludes_low=True)
    """Tangential over normal stiffness while sticking."""

    def __post_init__(self) -> None:
        check_fields("contact", self)


@dataclass(frozen=True)
class SolverSpecification:
    """Resolution and effort of the gel's solver."""

    method: str = quantity("implicit", choices=METHODS)
    """Equilibrium in every frame, or the paper's explicit scheme (neo_hookean only)."""
    grid_spacing_m: float = quantity(2.4e-3, unit="m", low=2e-4, high=1e-2)
    """Spacing of the grid, at most half the gel's smallest extent; half of it takes some 30 times
    the memory."""
    refined: bool = quantity(True)
    """Whether contact acts on the skin of a grid of half the spacing (to first order)."""
    tolerance_m: float = quantity(10.0e-6, unit="m", low=1e-12, high=1e-3)
    """Newton's method ends when it expects to be this close to the equilibrium on the skin, and
    within 1 % of the force for each 1e-5 m of it."""
    iterations: int = quantity(15, low=1, high=1000)
    """Most Newton iterations of a substep."""
    friction_passes: int = quantity(5, low=1, high=1000)
    """Pressures that limit friction in a substep, one after the other; the first is extrapolated
    from the last substep."""
    dynamic: bool = quantity(False)
    """Whether steps are backward Euler with inertia instead of quasi-static."""

    def __post_init__(self) -> None:
        check_fields("solver", self)


@dataclass(frozen=True)
class CameraSpecification:
    """The camera: a fisheye or a pinhole in the optical frame of REP 103 (z forward, x right, y
    down), behind the skin. What it looks through is taken to be clear and not to refract."""

    projection: str = quantity("equidistant", choices=PROJECTIONS)
    """How rays meet the image: at a distance from the principal point that is the focal length
    times the angle from the axis (a fisheye), or times its tangent."""
    width: int = quantity(640, unit="px", low=16, high=4096)
    """Width of the image."""
    height: int = quantity(480, unit="px", low=16, high=4096)
    """Height of the image."""
    position_m: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0025), unit="m", low=-0.3, high=0.3
    )
    """Place of the optical frame in the base frame: behind the skin, at most 0.1 m from the box
    around the gel."""
    quaternion_xyzw: tuple[float, float, float, float] = quantity(
        (0.0, 0.0, 0.0, 1.0), low=-1.001, high=1.001
    )
    """Rotation from the optical frame to the base frame, of length 1 within 0.001."""
    colour: str = quantity("rgb", choices=COLOURS)
    """A grey camera sees all LEDs alike, and its images have three equal channels."""
    half_height_angle_deg: float = quantity(86.0, unit="deg", low=1.0, high=180.0)
    """Angle from the axis that is seen at half the image's height, without distortion; at most 80
    for a pinhole."""
    pixel_aspect: float = quantity(1.0, low=0.5, high=2.0)
    """Focal length along x over that along y, fx / fy of a calibrated camera; half_height_angle_deg
    sets that along y."""
    principal_point_px: tuple[float, float] = quantity(
        (319.5, 239.5), unit="px", low=-4096.0, high=8192.0
    )
    """x and y where the axis meets the image, the first pixel's centre being 0, 0; at most an
    image's size outside of it."""
    distortion: tuple[float, float, float, float] = quantity(
        (0.0, 0.0, 0.0, 0.0), low=-100.0, high=100.0
    )
    """k1 to k4 of the equidistant model, or k1, k2, p1, p2 of a pinhole's plumb_bob."""
    idle_image: str = quantity("images/densetact2_idle.png")
    """File of the image without contact, next to this file, below `params/` or absolute; empty: the
    image is drawn from the sections lighting, vignetting and pattern."""
    residual: str = quantity("")
    """Folder of the network that completes the image, beside this file, below `params/` or
    absolute; empty for none."""

    @property
    def channel_count(self) -> int:
        """Channels of its images that differ."""
        return 1 if self.colour == "grey" else 3

    def __post_init__(self) -> None:
        check_fields("camera", self)
        if self.projection == "pinhole" and self.half_height_angle_deg > WIDEST_PINHOLE_DEG:
            raise ValueError(
                f"camera.half_height_angle_deg is {self.half_height_angle_deg}, expected at most "
                f"{WIDEST_PINHOLE_DEG:g} deg for the projection pinhole; 'equidistant' sees more"
            )
        length = math.hypot(*self.quaternion_xyzw)
        if abs(length - 1.0) > 1e-3:
            raise ValueError(
                f"camera.quaternion_xyzw is {value_text(self.quaternion_xyzw)}, of length "
                f"{length:.6g}, expected 1 within 0.001; normalise it"
            )
        for size, place in zip((self.width, self.height), self.principal_point_px, strict=True):
            if not -size <= place <= 2 * size:
                raise ValueError(
                    f"camera.principal_point_px is {value_text(self.principal_point_px)}, expected "
                    f"at most an image's size outside of the {self.width}x{self.height} image"
                )


@dataclass(frozen=True)
class NoiseSpecification:
    """Noise of the camera's sensor, added to every image where it is lit; none by default.

    It is drawn by the seed and by the simulated time since the sensor's last reset.
    """

    deviation_levels: float = quantity(0.0, unit="grey levels of 255", low=0.0, high=50.0)
    """Standard deviation; 0 for none."""
    seed: int = quantity(0, low=0, high=2**31 - 1)
    """Another seed, another noise."""

    def __post_init__(self) -> None:
        check_fields("noise", self)


@dataclass(frozen=True)
class LightingSpecification:
    """Nine LEDs around the z axis (three red, three green, three blue) on a ring or in three
    straight rows, and the coat that they light. A crosstalk of 1 makes all of them white. Used
    where the idle image has no description of its own next to it."""

    radius_m: float = quantity(0.010, unit="m", low=1e-4, high=0.3)
    """Radius of the ring, or distance of the rows from the z axis."""
    height_m: float = quantity(0.0005, unit="m", low=-0.3, high=0.3)
    """Height of the ring over the base plane."""
    azimuth_deg: tuple[float, float, float] = quantity(
        (60.0, 180.0, -60.0), unit="deg", low=-720.0, high=720.0
    )
    """Directions of the red, the green and the blue group, from +x towards +y."""
    spread_deg: float = quantity(12.0, unit="deg", low=0.0, high=120.0)
    """Angle between two neighbours of one group on the ring."""
    row_length_m: float = quantity(0.0, unit="m", low=0.0, high=0.3)
    """Length of the straight row that a group forms across its direction, as along a pad's side; 0
    for a part of the ring."""
    crosstalk: float = quantity(0.1, low=0.0, high=1.0)
    """Share of an LED's light that the camera sees in each of the other two colours."""
    ambient_fraction: float = quantity(1.0, low=0.0, high=1e9, excludes_low=True)
    """Light that a press does not change, over the mean direct light at rest; the larger, the
    weaker the shading."""
    exponent: float = quantity(1.0, low=0.0, high=10.0, excludes_low=True)
    """Exponent of brightness over light; 1 for a camera with a linear response."""
    gloss: float = quantity(0.0, low=0.0, high=1e3)
    """Light that the coat mirrors of an LED, over what it scatters; 0 for a dull coat."""
    gloss_exponent: float = quantity(80.0, low=0.0, high=1e5, excludes_low=True)
    """Sharpness of what the coat mirrors; larger is a smoother coat."""

    def __post_init__(self) -> None:
        check_fields("lighting", self)


@dataclass(frozen=True)
class VignettingSpecification:
    """Loss of brightness towards the edge of the image. Used as `lighting` is."""

    falloff: tuple[float, ...] = quantity((), low=-100.0, high=100.0)
    """c1, c2, ...: brightness is 1 + c1 s + c2 s^2 + ... with s the square of the distance from the
    principal point over half the image's height."""

    def __post_init__(self) -> None:
        check_fields("vignetting", self)


@dataclass(frozen=True)
class PatternSpecification:
    """The coat's random pattern in an idle image that is drawn."""

    blotch_m: float = quantity(0.22e-3, unit="m", low=1e-5, high=0.02)
    """Size of the dark blotches."""
    dark_share: float = quantity(0.45, low=0.0, high=1.0)
    """Part of the coat that is dark."""
    contrast: float = quantity(0.45, low=0.0, high=1.0)
    """How much darker a blotch is than the coat."""
    grain: float = quantity(0.06, low=0.0, high=1.0)
    """Standard deviation of the coat's fine texture over its brightness."""
    rim_angle_deg: float = quantity(92.0, unit="deg", low=1.0, high=180.0)
    """Angle from the camera's axis where its mount ends the view."""
    noise_levels: float = quantity(1.0, unit="grey levels of 255", low=0.0, high=50.0)
    """Standard deviation of the noise that the idle image was taken with."""
    seed: int = quantity(0, low=0, high=2**31 - 1)
    """Another seed, another pattern."""

    def __post_init__(self) -> None:
        check_fields("pattern", self)


@dataclass(frozen=True)
class MarkerSpecification:
    """A grid of dots that is printed on the skin, around the z axis and as it is seen along it;
    none by default. They are drawn where the idle image is; an image that is named shows its own.
    """

    columns: int = quantity(0, low=0, high=200)
    """Dots along x; 0 for none."""
    rows: int = quantity(0, low=0, high=200)
    """Dots along y; 0 for none."""
    spacing_m: tuple[float, float] = quantity(
        (1.5e-3, 1.5e-3), unit="m", low=1e-5, high=LARGEST_LENGTH_M
    )
    """From one dot to the next along x and y, middle to middle."""
    radius_m: float = quantity(0.25e-3, unit="m", low=1e-5, high=0.02)
    """Radius of a dot."""
    darkness: float = quantity(0.9, low=0.0, high=1.0)
    """Light that a dot swallows of what the coat sends back."""

    def __post_init__(self) -> None:
        check_fields("markers", self)
        if (self.columns > 0) != (self.rows > 0):
            raise ValueError(
                f"markers.columns is {self.columns} and markers.rows is {self.rows}, expected both "
                "above 0, or both 0 for none"
            )

    @property
    def corner_m(self) -> tuple[float, float]:
        """x and y of the grid's last dot."""
        x, y = self.spacing_m
        return 0.5 * x * (self.columns - 1), 0.5 * y * (self.rows - 1)
