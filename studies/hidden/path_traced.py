# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The sensor's inside by an independent renderer: Mitsuba 3, a path tracer.

Mitsuba (Jakob et al., "Mitsuba 3 renderer", 2022, mitsuba-renderer.org) shares nothing with this
project's images: light goes between the parts of the dome as often as it likes, LEDs have a size,
the indenter's dent throws shadows. The scene is the outer skin as a mesh with a diffuse coat seen
from within, a dark base, and nine LEDs on it; the gel is clear and the camera inside of it, so
there is no refraction. The camera's rays are made here: an equidistant fisheye at any place and
direction, with a pupil of any size.

An LED has one colour, and so is seen by one channel, so three scenes without colour are rendered
with the LEDs of one colour each: a path that draws one of nine LEDs, six of them in vain for a
channel, would be ten times as noisy. Light from outside is a fourth scene.

Lengths of the scene are millimetres (its rays end some 1e-4 of a unit before a surface).
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dotsim_ros.io.arrays import FloatArray

AnyIntArray = NDArray[np.integer]

LEAST_LLVM = 16
"""Dr.Jit loads an older LLVM too, and aborts the process with it."""
LLVM_PLACES = ("/usr/lib", "/usr/lib64", "/usr/lib/*-linux-gnu", "/usr/lib/llvm-*/lib")

MM = 1.0e3
MAP_SIZE = 512
MAP_REACH_RAD = 0.55 * np.pi
"""A map of the coat shows directions from the dome's centre: the distance from its middle is the
angle from the axis, and half its width this angle."""

LED_RING_M, LED_HEIGHT_M, LED_RADIUS_M = 10.0e-3, 0.8e-3, 0.6e-3
LED_AZIMUTH_DEG = (75.0, 195.0, 315.0)
"""Directions of the red, the green and the blue group of LEDs, from +x towards +y."""
LED_SPREAD_DEG = 17.0
LED_TILT_DEG = 12.0
"""LEDs lean outwards, so that the camera sees their backs."""
DARK = 0.03
"""Reflectance of the base, of the LEDs' backs and of dust."""


def llvm_library(places: Iterable[str] = LLVM_PLACES) -> Path | None:
    """Return the newest libLLVM that Dr.Jit can work with; None where there is none.

    That of the variable DRJIT_LIBLLVM_PATH goes first, if it is new enough.

    Args:
        places: folders to look into, with wildcards.
    """
    named = os.environ.get("DRJIT_LIBLLVM_PATH", "")
    if named and _llvm_version(Path(named)) >= LEAST_LLVM and Path(named).is_file():
        return Path(named)
    found = [
        path
        for place in places
        for path in Path("/").glob(f"{place.lstrip('/')}/libLLVM*.so*")
        if path.is_file() and _llvm_version(path) >= LEAST_LLVM
    ]
    return max(found, key=lambda path: (_llvm_version(path), path.name), default=None)


def _llvm_version(path: Path) -> int:
    """Return the major version in a library's name, links followed; 0 for none."""
    for name in (path.name, path.resolve().name):
        found = re.match(r"libLLVM(?:-|\.so\.)(\d+)", name)
        if found is not None:
            return int(found[1])
    return 0


def open_mitsuba(variant: str = "") -> ModuleType:
    """Return Mitsuba, ready to render with one thread.

    Args:
        variant: of Mitsuba; empty for llvm_ad_rgb where there is an LLVM for it, else scalar_rgb,
            which is five times slower.

    Raises:
        ImportError: Mitsuba is not installed.
        ValueError: an LLVM variant without a libLLVM that it works with.
    """
    library = llvm_library()
    if library is not None:
        os.environ["DRJIT_LIBLLVM_PATH"] = str(library)
    import drjit
    import mitsuba

    # Dr.Jit loads its LLVM as it is imported, which may have been before, without our choice.
    works = _loaded_llvm() >= LEAST_LLVM
    if variant.startswith("llvm") and not works:
        raise ValueError(
            f"{variant} needs libLLVM {LEAST_LLVM} or newer, loaded is {_loaded_llvm() or 'none'}; "
            "install one, or name it in DRJIT_LIBLLVM_PATH before Mitsuba is imported"
        )
    drjit.set_thread_count(1)
    mitsuba.set_variant(variant or ("llvm_ad_rgb" if works else "scalar_rgb"))
    return mitsuba


def _loaded_llvm() -> int:
    """Return the major version of the oldest libLLVM in this process; 0 for none."""
    try:
        lines = Path("/proc/self/maps").read_text(encoding="utf-8").splitlines()
    except OSError:
        return 0
    paths = {Path(line.split()[-1]) for line in lines if "libLLVM" in line}
    return min(map(_llvm_version, paths), default=0)


@dataclass(frozen=True)
class Eye:
    """The camera.

    Attributes:
        position_m: of its pupil.
        turn_rad: rotation vector from looking along +z with x to the right and y down.
        half_height_angle_rad: from the axis, seen at half the image's height.
        edge_loss: of brightness there, by the fourth power of a cosine.
        pupil_m: radius of the pupil; 0 for a pinhole.
        focus_m: distance at which a pupil sees sharp.
    """

    position_m: tuple[float, float, float] = (0.0, 0.0, 2.5e-3)
    turn_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    half_height_angle_rad: float = float(np.radians(86.0))
    edge_loss: float = 0.0
    pupil_m: float = 0.0
    focus_m: float = 13.0e-3

    def rays(
        self, width: int, height: int, sample_count: int, random: np.random.Generator
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return origins (H * W * S, 3), metres, unit directions (H * W * S, 3) and weights
        (H * W * S,) of the rays of all pixels, those of a pixel next to each other.

        A pixel's S rays are spread evenly over its square.
        """
        across, along = _spread(width * height, sample_count, random)
        y, x = np.divmod(np.repeat(np.arange(width * height), sample_count), width)
        offset_x = x + across - 0.5 * width
        offset_y = y + along - 0.5 * height
        distance = np.hypot(offset_x, offset_y)
        angle = distance * (self.half_height_angle_rad / (0.5 * height))
        share = np.sin(angle) / np.maximum(distance, 1e-12)
        direction = np.stack([share * offset_x, share * offset_y, np.cos(angle)], axis=1)
        turn = Rotation.from_rotvec(self.turn_rad)
        origin = np.zeros_like(direction)
        if self.pupil_m > 0.0:
            # The pupil stands across the ray: that of a fisheye turns towards the light.
            first = np.stack([direction[:, 2], np.zeros(len(angle)), -direction[:, 0]], axis=1)
            first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
            second = np.cross(direction, first)
            radius = self.pupil_m * np.sqrt(random.random((len(angle), 1)))
            turned = 2.0 * np.pi * random.random((len(angle), 1))
            origin = radius * (np.cos(turned) * first + np.sin(turned) * second)
            direction = self.focus_m * direction - origin
            direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        slant = angle / self.half_height_angle_rad * np.arccos((1.0 - self.edge_loss) ** 0.25)
        weight = np.cos(np.minimum(slant, 0.5 * np.pi)) ** 4
        return turn.apply(origin) + self.position_m, turn.apply(direction), weight


@dataclass(frozen=True)
class Inside:
    """What the camera looks at.

    Attributes:
        coat: (N, N) reflectance over a map of the coat (`map_directions`).
        led_power: (9,) radiance of the LEDs, in any unit: red, green, blue, three each.
        glow: (N, N) radiance that comes through the coat from outside, all colours alike, over
            the map; None for none.
        dust_m: (K, 3) places of grains in the gel.
        dust_radius_m: their radius.
        led_radius_m: that of the LEDs.
    """

    coat: FloatArray
    led_power: FloatArray = field(default_factory=lambda: np.ones(9))
    glow: FloatArray | None = None
    dust_m: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    dust_radius_m: float = 0.1e-3
    led_radius_m: float = LED_RADIUS_M


def map_directions() -> FloatArray:
    """Return (N, N, 3) the unit directions from the dome's centre of a map of the coat: x grows
    with the column, y with the row."""
    place = MAP_REACH_RAD * ((2.0 * np.arange(MAP_SIZE) + 1.0) / MAP_SIZE - 1.0)
    x, y = np.meshgrid(place, place)
    angle = np.hypot(x, y)
    share = np.sin(angle) / np.maximum(angle, 1e-12)
    return np.stack([share * x, share * y, np.cos(angle)], axis=-1)


def map_places(rest_position_m: FloatArray) -> FloatArray:
    """Return (V, 2) where vertices at rest lie in a map of the coat, 0 to 1 along its columns and
    rows."""
    across = np.hypot(rest_position_m[:, 0], rest_position_m[:, 1])
    angle = np.arctan2(across, rest_position_m[:, 2])
    share = angle / (2.0 * MAP_REACH_RAD) / np.maximum(across, 1e-12)
    return 0.5 + share[:, None] * rest_position_m[:, :2]


def led_places() -> tuple[FloatArray, FloatArray]:
    """Return (9, 3) the LEDs' places, metres, and (9, 3) where they point."""
    middle = np.repeat(LED_AZIMUTH_DEG, 3) + np.tile([-LED_SPREAD_DEG, 0.0, LED_SPREAD_DEG], 3)
    azimuth, tilt = np.radians(middle), np.radians(LED_TILT_DEG)
    outward = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(9)], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    return LED_RING_M * outward + LED_HEIGHT_M * up, np.sin(tilt) * outward + np.cos(tilt) * up


class InsideRenderer:
    """Renders one sensor's inside for any shape of its skin.

    Args:
        rest_position_m: (V, 3) the skin at rest, base frame, its base at z = 0.
        triangles: (T, 3) of it, counter-clockwise from outside.
        inside: what there is to see.
        width, height: of the images.
        sample_count: rays a pixel and colour.
        most_edges: longest path that light is followed along; 2 is direct light.
        mitsuba: as `open_mitsuba` returns it.
    """

    def __init__(
        self,
        rest_position_m: FloatArray,
        triangles: AnyIntArray,
        inside: Inside,
        *,
        width: int,
        height: int,
        sample_count: int,
        most_edges: int = 5,
        mitsuba: ModuleType,
    ) -> None:
        self._mi = mitsuba
        self._is_scalar = str(mitsuba.variant()).startswith("scalar")
        self.inside, self.width, self.height = inside, width, height
        self.sample_count = sample_count
        self._integrator = mitsuba.load_dict(
            {"type": "path", "max_depth": most_edges, "rr_depth": most_edges + 1}
        )
        # One ray at a time there are no neighbours to spread samples among.
        kind = "independent" if self._is_scalar else "multijitter"
        self._sampler = mitsuba.load_dict({"type": kind, "sample_count": sample_count})
        if not self._is_scalar:
            self._sampler.set_samples_per_wavefront(sample_count)
        self._scenes = [
            self._scene(rest_position_m, triangles, range(3 * colour, 3 * colour + 3))
            for colour in range(3)
        ]
        if inside.glow is not None:
            self._scenes.append(self._scene(rest_position_m, triangles, ()))
        self._parameters = [mitsuba.traverse(scene) for scene in self._scenes]

    def radiance(
        self, skin_position_m: FloatArray, eye: Eye, *, led_share: float = 1.0, seed: int
    ) -> FloatArray:
        """Return (H, W, 3) the mean radiance of red, green and blue that the camera receives.

        Args:
            skin_position_m: (V, 3) of the skin.
            eye: the camera.
            led_share: of the LEDs' power that they have.
            seed: of all samples; images of one scene by different seeds differ by noise.
        """
        found = np.empty((len(self._scenes), self.height, self.width))
        for number, parameters in enumerate(self._parameters):
            vertices = np.ravel(MM * skin_position_m).astype(np.float32)
            parameters["coat.vertex_positions"] = vertices
            for led in range(9):
                key = f"led_{led}.emitter.radiance.value"
                if key in parameters:
                    parameters[key] = float(led_share * self.inside.led_power[led])
            parameters.update()
            random = np.random.default_rng([seed, number])
            origin, direction, weight = eye.rays(self.width, self.height, self.sample_count, random)
            traced = self._traced(number, MM * origin, direction, int(random.integers(2**31)))
            mean = (weight * traced).reshape(self.height, self.width, -1).mean(axis=-1)
            found[number] = mean
        return np.moveaxis(found[:3] + found[3:].sum(axis=0), 0, -1)

    def _traced(
        self, number: int, origin_mm: FloatArray, direction: FloatArray, seed: int
    ) -> FloatArray:
        """Return (N,) the radiance along rays of one scene."""
        mi, scene = self._mi, self._scenes[number]
        if not self._is_scalar:
            self._sampler.seed(seed, len(direction))
            ray = mi.RayDifferential3f(mi.Point3f(origin_mm.T), mi.Vector3f(direction.T))
            spectrum, _, _ = self._integrator.sample(scene, self._sampler, ray)
            return np.asarray(spectrum, dtype=np.float64)[0]
        self._sampler.seed(seed)
        found = np.empty(len(direction))
        for k, (start, way) in enumerate(zip(origin_mm, direction, strict=True)):
            ray = mi.RayDifferential3f(mi.Point3f(start), mi.Vector3f(way))
            spectrum, _, _ = self._integrator.sample(scene, self._sampler, ray)
            found[k] = spectrum[0]
        return found

    def _scene(
        self, rest_position_m: FloatArray, triangles: AnyIntArray, lit: Iterable[int]
    ) -> Any:
        """Return the scene with some of the LEDs lit; with none, light comes from outside."""
        mi = self._mi
        lit = tuple(lit)
        dark = {"type": "twosided", "bsdf": _diffuse(DARK)}
        entries: dict[str, Any] = {
            "type": "scene",
            "coat": self._coat(rest_position_m, triangles, glows=not lit),
            "base": {
                "type": "disk",
                "to_world": mi.ScalarTransform4f().scale(
                    MM * float(np.linalg.norm(rest_position_m, axis=1).max())
                ),
                "bsdf": dark,
            },
        }
        for led, (place, way) in enumerate(zip(*led_places(), strict=True)):
            entries[f"led_{led}"] = {
                "type": "disk",
                "to_world": mi.ScalarTransform4f()
                .look_at(
                    origin=(MM * place).tolist(),
                    target=(MM * place + way).tolist(),
                    up=[0.0, 0.0, 1.0],
                )
                .scale(MM * self.inside.led_radius_m),
                "bsdf": dark,
            }
            if led in lit:
                power = float(self.inside.led_power[led])
                entries[f"led_{led}"]["emitter"] = {
                    "type": "area",
                    "radiance": {"type": "rgb", "value": [power] * 3},
                }
        for grain, place in enumerate(self.inside.dust_m):
            entries[f"grain_{grain}"] = {
                "type": "sphere",
                "center": (MM * place).tolist(),
                "radius": MM * self.inside.dust_radius_m,
                "bsdf": dark,
            }
        return mi.load_dict(entries)

    def _coat(self, rest_position_m: FloatArray, triangles: AnyIntArray, *, glows: bool) -> Any:
        """Return the skin's mesh, its front inside."""
        mi = self._mi
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(
            {"type": "diffuse", "reflectance": self._texture(self.inside.coat)}
        )
        if glows and self.inside.glow is not None:
            properties["emitter"] = mi.load_dict(
                {"type": "area", "radiance": self._texture(self.inside.glow)}
            )
        mesh = mi.Mesh(
            "coat",
            vertex_count=len(rest_position_m),
            face_count=len(triangles),
            has_vertex_normals=True,
            has_vertex_texcoords=True,
            props=properties,
        )
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = np.ravel(MM * rest_position_m).astype(np.float32)
        parameters["vertex_texcoords"] = np.ravel(map_places(rest_position_m)).astype(np.float32)
        parameters["faces"] = np.ravel(triangles[:, ::-1]).astype(np.uint32)
        parameters.update()
        return mesh

    def _texture(self, values: FloatArray) -> dict[str, Any]:
        """Return a texture of values (N, N) over a map of the coat."""
        pixels = np.repeat(values[..., None], 3, axis=2).astype(np.float32)
        return {"type": "bitmap", "bitmap": self._mi.Bitmap(pixels), "raw": True}


def _diffuse(reflectance: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": [reflectance] * 3}}


def _spread(
    pixel_count: int, sample_count: int, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return x and y (P * S each), 0 to 1, of places in the squares of P pixels: one in each cell
    of a grid, the rest anywhere."""
    side = int(np.sqrt(sample_count))
    number = np.arange(sample_count)
    in_grid = number < side**2
    row, column = np.divmod(number, side)
    shape = (pixel_count, sample_count)
    x, y = random.random(shape), random.random(shape)
    return (
        np.where(in_grid, (column + x) / side, x).ravel(),
        np.where(in_grid, (row + y) / side, y).ravel(),
    )
