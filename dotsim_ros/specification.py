# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a sensor is, as data: every field with its unit, range, default and meaning.

A sensor is read from a YAML file, checked, frozen, and written here.

    python -m dotsim_ros.specification

prints the tables of all fields; with `--markdown docs/api/sensor_fields.md` it writes them.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import math
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike

from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import read_yaml, value_text
from dotsim_ros.io.files import expanded, shipped_path, whole_file, write_text
from dotsim_ros.io.printable import printable
from dotsim_ros.io.quantity import (
    check_fields,
    field_table,
    number_text,
    quantities_of,
    quantity,
    section_from,
)

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
LARGEST_DISTANCE_M = 0.1
"""Of the camera from the gel's box: tactile sensors look at it from a few centimetres at most."""
LARGEST_MEMORY_BYTES = 16e9
"""What one sensor may take: the default dome on a grid of 1.2 mm, unrefined, still does."""
FILES = ("idle_image", "residual")
"""Fields of a camera that name a file or a folder."""
WHOLE_CORE_RAD = (0.0, 0.0, math.pi)
"""A patch that is all of the core."""
GRAIN_SHARE = 0.6
"""Size of the coat's fine texture, over that of a blotch."""


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

    shape: str = quantity(
        "dome",
        choices=SHAPES,
        help="Half a ball, a flat block, or a block whose upper face bends down towards its sides.",
    )
    skin_spacing_m: float = quantity(
        0.5e-3,
        unit="m",
        low=5e-5,
        high=5e-3,
        help="Largest distance between neighbouring skin markers; at most half the dome's radius, "
        "or half the pad's shorter side.",
    )
    outer_radius_m: float = quantity(
        0.01575,
        unit="m",
        low=1e-3,
        high=LARGEST_LENGTH_M,
        help="Radius of the free surface of a dome.",
    )
    core_radius_m: float = quantity(
        0.006,
        unit="m",
        low=0.0,
        high=LARGEST_LENGTH_M,
        help="Radius of the rigid core that a dome is bonded to, less than the outer radius; 0 for "
        "none.",
    )
    pad_size_m: tuple[float, float, float] = quantity(
        (0.02, 0.025, 0.004),
        unit="m",
        low=5e-4,
        high=LARGEST_LENGTH_M,
        help="Lengths of a pad along x and y, and its thickness along z, in its middle.",
    )
    face_radius_m: tuple[float, float] = quantity(
        (0.0, 0.0),
        unit="m",
        low=0.0,
        high=10.0,
        help="Radii of the upper face of a curved pad along x and y, 0 for straight: equal ones "
        "are a part of a ball, one of 0 is a part of a cylinder.",
    )
    bond_slip_share: float = quantity(
        0.0,
        low=0.0,
        high=1.0,
        help="How far a dome has come off its core: what the bond lets through of the sliding "
        "between skin and core under a uniform shear; 0 is bonded, 1 slides freely. Implicit "
        "solver only.",
    )
    loose_patch_rad: tuple[float, float, float] = quantity(
        WHOLE_CORE_RAD,
        unit="rad",
        low=-math.pi,
        high=math.pi,
        help="Where it has come off, seen from the core's centre: the patch's middle as an angle "
        "from the z axis towards x and towards y, and its radius; pi is the whole core.",
    )

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

    law: str = quantity("neo_hookean", choices=LAWS, help="Elastic law.")
    youngs_modulus_pa: float = quantity(
        3.0e5,
        unit="Pa",
        low=1e2,
        high=1e9,
        help="E of neo_hookean, from a loose jelly to a hard rubber.",
    )
    poisson_ratio: float = quantity(0.48, low=0.0, high=0.4999, help="nu of neo_hookean.")
    c10_pa: float = quantity(
        0.0, unit="Pa", low=-1e9, high=1e9, help="C10 of mooney_rivlin and yeoh."
    )
    c01_pa: float = quantity(0.0, unit="Pa", low=-1e9, high=1e9, help="C01 of mooney_rivlin.")
    c20_pa: float = quantity(0.0, unit="Pa", low=-1e9, high=1e9, help="C20 of yeoh.")
    c30_pa: float = quantity(0.0, unit="Pa", low=-1e9, high=1e9, help="C30 of yeoh.")
    bulk_modulus_pa: float = quantity(
        0.0,
        unit="Pa",
        low=0.0,
        high=1e13,
        help="K of mooney_rivlin and yeoh; the limit is that of the largest E at the largest nu.",
    )
    prony_shares: tuple[float, ...] = quantity(
        (),
        low=0.0,
        high=1.0,
        excludes_low=True,
        help="Shares of the shape-changing stress that relax, together below 1; none: elastic.",
    )
    prony_times_s: tuple[float, ...] = quantity(
        (), unit="s", low=1e-6, high=1e7, help="Times in which they relax, as many."
    )
    density_kg_m3: float = quantity(
        1070.0,
        unit="kg/m^3",
        low=1.0,
        high=3e4,
        help="Density; it matters to dynamic and explicit solvers only.",
    )

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

    friction_coefficient: float = quantity(0.4, low=0.0, high=5.0, help="mu of Coulomb's law.")
    stiffness: float = quantity(
        120.0,
        low=0.0,
        high=1e5,
        excludes_low=True,
        help="Stiffness of the contact, in units of Young's modulus over 1.2 mm; the skin's "
        "penetration is the pressure divided by it.",
    )
    tangential_ratio: float = quantity(
        0.25,
        low=0.0,
        high=100.0,
        excludes_low=True,
        help="Tangential over normal stiffness while sticking.",
    )

    def __post_init__(self) -> None:
        check_fields("contact", self)


def _same(value: float) -> float:
    return value


def _log(value: float) -> float:
    return float(np.log(value))


def _exp(value: float) -> float:
    return float(np.exp(value))


def _log_compressibility(poisson_ratio: float) -> float:
    return float(np.log(0.5 - poisson_ratio))


def _poisson_ratio(coordinate: float) -> float:
    return float(0.5 - np.exp(coordinate))


COORDINATES: dict[str, tuple[Callable[[float], float], Callable[[float], float]]] = {
    "": (_same, _same),
    "log": (_log, _exp),
    "log(1/2 - nu)": (_log_compressibility, _poisson_ratio),
}
"""From a value to the coordinate in which the gel's response is close to linear, and back."""


@dataclass(frozen=True)
class GelParameter:
    """One of `GelValues`, as calibration, effects and the twin know it.

    Attributes:
        field: of `GelValues`.
        section, entry: where a sensor's file has the same number; empty for one that `gel.values`
            works out from several.
        unit: of its value.
        name: of `--fit` and reports; empty for one that no calibration fits.
        bounds: smallest and largest value that is searched.
        coordinate: that it is searched in, a key of `COORDINATES`.
        prior_width: one standard deviation of the prior, in the coordinate.
        step: of the differences, in the coordinate: so large that the solver's tolerance does not
            matter, so small that the answer is straight over it.
        model_error: RMS of the coordinate, by which the constant that fits a unit differs from that
            of its material, which another solver was given; None where that is not known. Learnt
            from five units of the series of the gap finder's study, judged on five others
            (docs/calibration.md).
    """

    field: str
    unit: str
    section: str = ""
    entry: str = ""
    name: str = ""
    bounds: tuple[float, float] = (-math.inf, math.inf)
    coordinate: str = ""
    prior_width: float = math.nan
    step: float = math.nan
    model_error: float | None = None

    @property
    def is_elastic(self) -> bool:
        """Whether a gel must be recreated for another value: all but the contact's numbers, and
        Young's modulus, which scales the force alone."""
        return self.section != "contact" and self.field != "youngs_modulus_pa"

    def to_coordinate(self, value: float) -> float:
        """Return the coordinate of a value."""
        return COORDINATES[self.coordinate][0](value)

    def to_value(self, coordinate: float) -> float:
        """Return the value at a coordinate."""
        return COORDINATES[self.coordinate][1](coordinate)

    def bound_of(self, value: float) -> float | None:
        """Return the bound that a value lies at; None for one between them."""
        return next((bound for bound in self.bounds if np.isclose(value, bound, rtol=1e-6)), None)


def _own(default: float, unit: str = "", **fit: Any) -> Any:
    """Return a field of `GelValues` that follows from several numbers of a sensor's file."""
    return field(default=default, metadata={"unit": unit, **fit})


def _entry(section: str, entry: str, *, unit: str | None = None, **fit: Any) -> Any:
    """Return a field of `GelValues` that a section has: its default and, unless given, unit."""
    default, known = quantities_of(_GEL_SECTIONS[section])[entry]
    place = {"section": section, "entry": entry, "unit": known.unit if unit is None else unit}
    return field(default=default, metadata={**place, **fit})


_GEL_SECTIONS: dict[str, type] = {
    "gel": GelSpecification,
    "material": MaterialSpecification,
    "contact": ContactSpecification,
}


@dataclass(frozen=True)
class GelValues:
    """The gel's parameters that a calibration or an effect changes, each declared here alone: its
    place in a sensor's file (with unit, range and default there), and how it is searched.

    A number that a section has needs a line here, and then `gel.values` reads and writes it,
    `--fit` knows it by its name, and the twin makes another gel for it.

    Attributes:
        youngs_modulus_pa, poisson_ratio: at small strain, of whichever law.
        friction: coefficient of the contact.
        contact_stiffness: of the contact, in units of E over 1.2 mm.
        c20_ratio, c30_ratio: Yeoh's C20 and C30 over C10; both 0 for a neo-Hookean gel.
        thickness_m: from the core's surface, or the pad's base, to the free surface.
        bond_slip_share, loose_patch_rad: how far the gel has come off its core, and where, as in
            `GelSpecification`.
    """

    youngs_modulus_pa: float = _own(
        MaterialSpecification.youngs_modulus_pa,
        "Pa",
        name="E",
        bounds=(1e3, 1e8),
        coordinate="log",
        prior_width=0.5,
        step=0.05,
        model_error=0.018,
    )
    poisson_ratio: float = _own(
        MaterialSpecification.poisson_ratio,
        name="nu",
        bounds=(0.2, 0.4999),
        coordinate="log(1/2 - nu)",
        prior_width=0.8,
        step=0.2,
        model_error=0.515,
    )
    friction: float = _entry(
        "contact",
        "friction_coefficient",
        name="friction",
        bounds=(0.02, 3.0),
        coordinate="log",
        prior_width=0.5,
        step=0.1,
        model_error=0.192,
    )
    contact_stiffness: float = _entry(
        "contact",
        "stiffness",
        unit="E/1.2 mm",
        name="contact_stiffness",
        bounds=(2.0, 1e3),
        coordinate="log",
        prior_width=1.0,
        step=0.2,
    )
    c20_ratio: float = _own(
        0.0, "of C10", name="c20", bounds=(-0.3, 2.0), prior_width=0.2, step=0.05
    )
    c30_ratio: float = _own(
        0.0, "of C10", name="c30", bounds=(-0.1, 2.0), prior_width=0.1, step=0.05
    )
    thickness_m: float = _own(
        GelSpecification().thickness_m,
        "m",
        name="thickness",
        bounds=(1e-3, 0.1),
        prior_width=0.3e-3,
        step=0.1e-3,
    )
    bond_slip_share: float = _entry("gel", "bond_slip_share")
    loose_patch_rad: tuple[float, float, float] = _entry("gel", "loose_patch_rad")


GEL_PARAMETERS = {each.name: GelParameter(each.name, **each.metadata) for each in fields(GelValues)}
"""By their fields of `GelValues`."""


@dataclass(frozen=True)
class SolverSpecification:
    """Resolution and effort of the gel's solver."""

    method: str = quantity(
        "implicit",
        choices=METHODS,
        help="Equilibrium in every frame, or the paper's explicit scheme (neo_hookean only).",
    )
    grid_spacing_m: float = quantity(
        2.4e-3,
        unit="m",
        low=2e-4,
        high=1e-2,
        help="Spacing of the grid, at most half the gel's smallest extent; half of it takes some "
        "30 times the memory.",
    )
    refined: bool = quantity(
        True,
        help="Whether contact acts on the skin of a grid of half the spacing (to first order).",
    )
    tolerance_m: float = quantity(
        10.0e-6,
        unit="m",
        low=1e-12,
        high=1e-3,
        help="Newton's method ends when it expects to be this close to the equilibrium on the "
        "skin, and within 1 % of the force for each 1e-5 m of it.",
    )
    iterations: int = quantity(15, low=1, high=1000, help="Most Newton iterations of a substep.")
    friction_passes: int = quantity(
        5,
        low=1,
        high=1000,
        help="Pressures that limit friction in a substep, one after the other; the first is "
        "extrapolated from the last substep.",
    )
    dynamic: bool = quantity(
        False, help="Whether steps are backward Euler with inertia instead of quasi-static."
    )

    def __post_init__(self) -> None:
        check_fields("solver", self)


@dataclass(frozen=True)
class CameraSpecification:
    """The camera: a fisheye or a pinhole in the optical frame of REP 103 (z forward, x right, y
    down), behind the skin. What it looks through is taken to be clear and not to refract."""

    projection: str = quantity(
        "equidistant",
        choices=PROJECTIONS,
        help="How rays meet the image: at a distance from the principal point that is the focal "
        "length times the angle from the axis (a fisheye), or times its tangent.",
    )
    width: int = quantity(640, unit="px", low=16, high=4096, help="Width of the image.")
    height: int = quantity(480, unit="px", low=16, high=4096, help="Height of the image.")
    position_m: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0025),
        unit="m",
        low=-0.3,
        high=0.3,
        help="Place of the optical frame in the base frame: behind the skin, at most 0.1 m from "
        "the box around the gel.",
    )
    quaternion_xyzw: tuple[float, float, float, float] = quantity(
        (0.0, 0.0, 0.0, 1.0),
        low=-1.001,
        high=1.001,
        help="Rotation from the optical frame to the base frame, of length 1 within 0.001.",
    )
    colour: str = quantity(
        "rgb",
        choices=COLOURS,
        help="A grey camera sees all LEDs alike, and its images have three equal channels.",
    )
    half_height_angle_deg: float = quantity(
        86.0,
        unit="deg",
        low=1.0,
        high=180.0,
        help="Angle from the axis that is seen at half the image's height, without distortion; at "
        f"most {WIDEST_PINHOLE_DEG:g} for a pinhole.",
    )
    pixel_aspect: float = quantity(
        1.0,
        low=0.5,
        high=2.0,
        help="Focal length along x over that along y, fx / fy of a calibrated camera; "
        "half_height_angle_deg sets that along y.",
    )
    principal_point_px: tuple[float, float] = quantity(
        (319.5, 239.5),
        unit="px",
        low=-4096.0,
        high=8192.0,
        help="x and y where the axis meets the image, the first pixel's centre being 0, 0; at most "
        "an image's size outside of it.",
    )
    distortion: tuple[float, float, float, float] = quantity(
        (0.0, 0.0, 0.0, 0.0),
        low=-100.0,
        high=100.0,
        help="k1 to k4 of the equidistant model, or k1, k2, p1, p2 of a pinhole's plumb_bob.",
    )
    idle_image: str = quantity(
        "images/densetact2_idle.png",
        help="File of the image without contact, next to this file, below `params/` or absolute; "
        "empty: the image is drawn from the sections lighting, vignetting and pattern.",
    )
    residual: str = quantity(
        "",
        help="Folder of the network that completes the image, beside this file, below `params/` or "
        "absolute; empty for none.",
    )

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

    deviation_levels: float = quantity(
        0.0, unit="grey levels of 255", low=0.0, high=50.0, help="Standard deviation; 0 for none."
    )
    seed: int = quantity(0, low=0, high=2**31 - 1, help="Another seed, another noise.")

    def __post_init__(self) -> None:
        check_fields("noise", self)


@dataclass(frozen=True)
class LightingSpecification:
    """Nine LEDs around the z axis (three red, three green, three blue) on a ring or in three
    straight rows, and the coat that they light. A crosstalk of 1 makes all of them white. Used
    where the idle image has no description of its own next to it."""

    radius_m: float = quantity(
        0.010,
        unit="m",
        low=1e-4,
        high=0.3,
        help="Radius of the ring, or distance of the rows from the z axis.",
    )
    height_m: float = quantity(
        0.0005, unit="m", low=-0.3, high=0.3, help="Height of the ring over the base plane."
    )
    azimuth_deg: tuple[float, float, float] = quantity(
        (60.0, 180.0, -60.0),
        unit="deg",
        low=-720.0,
        high=720.0,
        help="Directions of the red, the green and the blue group, from +x towards +y.",
    )
    spread_deg: float = quantity(
        12.0,
        unit="deg",
        low=0.0,
        high=120.0,
        help="Angle between two neighbours of one group on the ring.",
    )
    row_length_m: float = quantity(
        0.0,
        unit="m",
        low=0.0,
        high=0.3,
        help="Length of the straight row that a group forms across its direction, as along a "
        "pad's side; 0 for a part of the ring.",
    )
    crosstalk: float = quantity(
        0.1,
        low=0.0,
        high=1.0,
        help="Share of an LED's light that the camera sees in each of the other two colours.",
    )
    ambient_fraction: float = quantity(
        1.0,
        low=0.0,
        high=1e9,
        excludes_low=True,
        help="Light that a press does not change, over the mean direct light at rest; the larger, "
        "the weaker the shading.",
    )
    exponent: float = quantity(
        1.0,
        low=0.0,
        high=10.0,
        excludes_low=True,
        help="Exponent of brightness over light; 1 for a camera with a linear response.",
    )
    gloss: float = quantity(
        0.0,
        low=0.0,
        high=1e3,
        help="Light that the coat mirrors of an LED, over what it scatters; 0 for a dull coat.",
    )
    gloss_exponent: float = quantity(
        80.0,
        low=0.0,
        high=1e5,
        excludes_low=True,
        help="Sharpness of what the coat mirrors; larger is a smoother coat.",
    )

    def __post_init__(self) -> None:
        check_fields("lighting", self)


@dataclass(frozen=True)
class VignettingSpecification:
    """Loss of brightness towards the edge of the image. Used as `lighting` is."""

    falloff: tuple[float, ...] = quantity(
        (),
        low=-100.0,
        high=100.0,
        help="c1, c2, ...: brightness is 1 + c1 s + c2 s^2 + ... with s the square of the distance "
        "from the principal point over half the image's height.",
    )

    def __post_init__(self) -> None:
        check_fields("vignetting", self)


@dataclass(frozen=True)
class PatternSpecification:
    """The coat's random pattern in an idle image that is drawn."""

    blotch_m: float = quantity(
        0.22e-3, unit="m", low=1e-5, high=0.02, help="Size of the dark blotches."
    )
    dark_share: float = quantity(0.45, low=0.0, high=1.0, help="Part of the coat that is dark.")
    contrast: float = quantity(
        0.45, low=0.0, high=1.0, help="How much darker a blotch is than the coat."
    )
    grain: float = quantity(
        0.06,
        low=0.0,
        high=1.0,
        help="Standard deviation of the coat's fine texture over its brightness.",
    )
    rim_angle_deg: float = quantity(
        92.0,
        unit="deg",
        low=1.0,
        high=180.0,
        help="Angle from the camera's axis where its mount ends the view.",
    )
    noise_levels: float = quantity(
        1.0,
        unit="grey levels of 255",
        low=0.0,
        high=50.0,
        help="Standard deviation of the noise that the idle image was taken with.",
    )
    seed: int = quantity(0, low=0, high=2**31 - 1, help="Another seed, another pattern.")

    def __post_init__(self) -> None:
        check_fields("pattern", self)


@dataclass(frozen=True)
class MarkerSpecification:
    """A grid of dots that is printed on the skin, around the z axis and as it is seen along it;
    none by default. They are drawn where the idle image is; an image that is named shows its own.
    """

    columns: int = quantity(0, low=0, high=200, help="Dots along x; 0 for none.")
    rows: int = quantity(0, low=0, high=200, help="Dots along y; 0 for none.")
    spacing_m: tuple[float, float] = quantity(
        (1.5e-3, 1.5e-3),
        unit="m",
        low=1e-5,
        high=LARGEST_LENGTH_M,
        help="From one dot to the next along x and y, middle to middle.",
    )
    radius_m: float = quantity(0.25e-3, unit="m", low=1e-5, high=0.02, help="Radius of a dot.")
    darkness: float = quantity(
        0.9, low=0.0, high=1.0, help="Light that a dot swallows of what the coat sends back."
    )

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


SECTIONS: dict[str, type[Any]] = {
    "gel": GelSpecification,
    "material": MaterialSpecification,
    "contact": ContactSpecification,
    "solver": SolverSpecification,
    "camera": CameraSpecification,
    "noise": NoiseSpecification,
    "lighting": LightingSpecification,
    "vignetting": VignettingSpecification,
    "pattern": PatternSpecification,
    "markers": MarkerSpecification,
}
SOURCE_MARK = "Source: "
"""Begins the line of a sensor's comment that says where its numbers come from."""
WRITTEN_BY_NEED = ("noise", "lighting", "vignetting", "pattern", "markers")
"""Sections that a written file has only where they differ from their defaults."""


@dataclass(frozen=True)
class SensorSpecification:
    """A whole sensor.

    Raises:
        ValueError: two sections contradict each other, or the sensor would take more memory than
            `LARGEST_MEMORY_BYTES`.
    """

    name: str = quantity(
        "densetact2", help="Name of the sensor; that of the file where it gives none."
    )
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


def sensor_path(source: str | Path) -> Path:
    """Return the file of a sensor, given itself or by the sensor's name.

    Raises:
        FileNotFoundError: no sensor of this name comes with the package.
    """
    path = expanded(source)
    if path.suffix in (".yaml", ".yml"):
        return path
    return shipped_path("sensors", str(source), "sensor", "the path of a YAML file")


def load_sensor(source: str | Path) -> SensorSpecification:
    """Read a sensor from a YAML file, or by name from `params/sensors/`.

    An idle image or a network that lies next to the file is found there, wherever the folder is.

    Raises:
        FileNotFoundError: no such file or name.
        ValueError: an entry is unknown, of the wrong type or out of range; the message names it.
    """
    path = sensor_path(source)
    return _read_beside(path.resolve().parent, path)


def _read_beside(folder: Path, path: Path) -> SensorSpecification:
    """Return the sensor of a file, whose image and network may lie in a folder."""
    sensor = sensor_from(read_yaml(path), str(path), name=path.stem)
    found: dict[str, Any] = {
        name: str(folder / value)
        for name, value in _files_of(sensor.camera)
        # A name that no file can have is looked for, and refused, where it is used.
        if not Path(value).is_absolute() and os.path.exists(folder / value)
    }
    return dataclasses.replace(sensor, camera=dataclasses.replace(sensor.camera, **found))


def _files_of(camera: CameraSpecification) -> list[tuple[str, str]]:
    """Return the fields of a camera that name a file, with their values, where they do."""
    return [(name, getattr(camera, name)) for name in FILES if getattr(camera, name)]


def given_sensor(sensor: str | Path | SensorSpecification) -> SensorSpecification:
    """Return a specification as it is, or the one that `load_sensor` reads."""
    return sensor if isinstance(sensor, SensorSpecification) else load_sensor(sensor)


def sensor_from(document: Any, source: str, *, name: str = "") -> SensorSpecification:
    """Return the sensor of a mapping of sections as a sensor's YAML file holds them.

    Args:
        document: the mapping.
        source: where it comes from, for messages.
        name: of a sensor whose mapping gives none.

    Raises:
        ValueError: it is no mapping, or an entry is unknown, of the wrong type or out of range;
            the message names it.
    """
    if not isinstance(document, dict):
        raise ValueError(f"{source} holds no mapping; see params/sensors/densetact2.yaml")
    unknown = sorted(str(section) for section in set(document) - set(SECTIONS) - {"name"})
    if unknown:
        raise ValueError(f"{source}: unknown sections {unknown}; known are {sorted(SECTIONS)}")
    try:
        sections = {
            section: section_from(kind, section, document.get(section))
            for section, kind in SECTIONS.items()
        }
        return SensorSpecification(name=document.get("name", name), **sections)
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from error


def write_sensor(path: Path, specification: SensorSpecification, comment: str) -> None:
    """Write a sensor's file, whole or not at all, and check that it loads as the same sensor.

    Args:
        path: of the file, ending in .yaml.
        specification: the sensor.
        comment: lines that say where its constants come from.

    Raises:
        ValueError: the suffix is another, or the file does not give the sensor back.
    """
    if path.suffix not in (".yaml", ".yml"):
        raise ValueError(f"{path}: a sensor's file must end in .yaml")
    document: dict[str, Any] = {"name": specification.name}
    for section, kind in SECTIONS.items():
        values = getattr(specification, section)
        if section not in WRITTEN_BY_NEED or values != kind():
            document[section] = _plain(dataclasses.asdict(values))
    folder = path.resolve().parent
    for name, value in _files_of(specification.camera):
        if Path(value).is_relative_to(folder):
            document["camera"][name] = str(Path(value).relative_to(folder))
    head = "".join(f"# {printable(line)}\n" for line in comment.splitlines())
    with whole_file(path) as part:
        part.write_text(head + yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
        if _read_beside(folder, part) != specification:
            raise ValueError(f"{path} does not give the sensor back that was written")


def read_comment(path: Path) -> list[str]:
    """Return the lines of the comment that begins a sensor's file, without their marks."""
    lines = path.read_text(encoding="utf-8").splitlines()
    head = itertools.takewhile(lambda line: line.startswith("#"), lines)
    return [line.removeprefix("#").removeprefix(" ") for line in head]


def read_source(path: Path) -> str:
    """Return where a sensor's numbers come from: what its comment says after `Source: `, or the
    comment's first line."""
    comment = read_comment(path)
    stated = [line.removeprefix(SOURCE_MARK) for line in comment if line.startswith(SOURCE_MARK)]
    return next(iter([*stated, *comment]), "").rstrip(":")


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    return {
        name: list(value) if isinstance(value, tuple) else value for name, value in values.items()
    }


_HEAD = """\
# The fields of a sensor's file

A sensor is one YAML file. `python -m dotsim_ros.specification` prints this page from the code that
reads it.

```yaml
name: my_pad
gel:
  shape: flat_pad
  pad_size_m: [0.03, 0.03, 0.005]
solver:
  grid_spacing_m: 0.002
camera:
  position_m: [0.0, 0.0, -0.02]
  half_height_angle_deg: 35.0
  idle_image: ""
lighting:
  radius_m: 0.02
  height_m: -0.004
```

- Load it by its path, or put it into `params/sensors/` and load it by its name: parameter `sensor`
  of `tactile_sim`, option `--sensor` of the commands, `load_sensor` in Python. A section or a field
  that is left out has its default.
- Lengths are in metres and all else in SI units, angles in degrees where the name ends so. The base
  plane of the gel is z = 0, +z points out of the gel, and the z axis is its middle.
- A value that is unknown, of another type or out of its range is refused: the error names the
  field, the value and the range. Nothing is rounded, and quoted text is not a number. Numbers are
  finite.
- Fields that contradict each other are refused: a core as large as its dome, a grid wider than
  half the gel's smallest extent, a camera in front of the skin or more than {distance} m from the
  gel, an explicit solver with another law than its own, and a sensor that would take more than
  {gigabytes} GB of memory. `dotsim_ros.specification.size_of` returns that memory beforehand,
  within a third.

**Idle image.** The simulated image is the [idle image](../camera.md#the-idle-image), warped and
shaded. Where `camera.idle_image` is empty it is drawn from the sections `lighting`, `vignetting`
and `pattern`, in a few seconds when the sensor is created. To keep it as a file:

```bash
python -m dotsim_ros.optics.pattern my_pad_idle.png --sensor my_pad.yaml
```

This writes the image and, next to it, a file with its lights. Such a file comes before the sensor's
own sections `lighting` and `vignetting`.

**Pads.** `flat_pad` is a block of gel on a clear plate at z = 0. The camera stands below and looks
up at the inner side of the upper face, the only one that is seen. `params/sensors/flat_pad.yaml` is
one, made with the command above. A `curved_pad` differs by its upper face, which is highest in the
middle and a part of a ball or a cylinder.

**Camera.** Of a calibrated camera's CameraInfo, with K = [fx 0 cx; 0 fy cy; 0 0 1],
`half_height_angle_deg` is `degrees(atan(height / (2 fy)))` for `plumb_bob` (projection `pinhole`)
and `degrees(height / (2 fy))` for `equidistant`, `pixel_aspect` is fx / fy, `principal_point_px` is
[cx, cy], and `distortion` the first four of D; a k3 of `plumb_bob` must be 0.

**Noise.** `noise` adds normal noise to every image of `TactileSensor`. It is drawn by `noise.seed`
and the frame's time since the last `reset`: the same motion after a reset gives the same images to
the last bit, and `reset(noise_seed=7)` other ones. `tactile_sim` draws it by the frame's stamp
instead, and its parameter `image_noise_levels` comes before the sensor's own where it is not
negative.
"""


def field_page() -> str:
    """Return the documentation of a sensor's file, in Markdown."""
    parts = [
        _HEAD.format(distance=LARGEST_DISTANCE_M, gigabytes=f"{LARGEST_MEMORY_BYTES / 1e9:.0f}"),
        "\n## Top level\n\nThe name, and the sections below.\n\n",
        field_table(SensorSpecification),
    ]
    for section, kind in SECTIONS.items():
        meaning = " ".join((kind.__doc__ or "").split())
        parts.append(f"\n## `{section}`\n\n{meaning}\n\n{field_table(kind)}")
    return "".join(parts)


def main() -> None:
    """Print the documentation of a sensor's file, or write it."""
    parser = argparse.ArgumentParser(
        prog="python -m dotsim_ros.specification",
        description="Print every field of a sensor's file with its unit, range and default.",
        epilog="example: python -m dotsim_ros.specification --markdown docs/api/sensor_fields.md",
    )
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the page to this file")
    arguments = parser.parse_args()
    if arguments.markdown is None:
        print(field_page(), end="")
    else:
        write_text(arguments.markdown, field_page())


if __name__ == "__main__":
    main()
