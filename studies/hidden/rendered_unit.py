# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A unit of a sensor whose photographs are path-traced, and the data sets that it is measured in.

Skins are those of a measured data set, so neither the gel nor the light is this project's.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from dotsim_ros.data.data_set import DataSet
from dotsim_ros.data.data_set_writer import DataSetWriter
from dotsim_ros.data.trajectory import (
    ImageChannel,
    PoseChannel,
    SkinChannel,
    Trajectory,
    WrenchChannel,
)
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray, ImageArray
from studies.hidden.path_traced import (
    MAP_REACH_RAD,
    MAP_SIZE,
    Eye,
    Inside,
    InsideRenderer,
)

FULL_SCALE = 255.0
NOISE_LEVELS = 1.2
WHITE_LEVEL = 215.0
"""Grey level of the brightest hundredth of the idle photograph at commissioning."""
LEAK = 0.06
"""Share of a colour's light that each of the other channels sees."""
IDLE_COUNT = 5

BRIGHT, BLOT = 0.75, 0.35
"""Reflectance of the coat and of its pattern's blots."""
BLOT_RAD = 0.026
"""Blur of the noise that blots are made of, seen from the dome's centre."""
SMOOTHING = 4
"""How often each vertex of a measured skin takes half of its neighbours' mean: noise of 0.04 mm
falls to 0.01 mm."""
METERING_WIDTH = 0.35
"""Deviation of the bell that a metering camera weighs its photograph with, of the height."""
FADING_S = 4.0


@dataclass(frozen=True)
class RenderedUnit:
    """A sensor.

    Attributes:
        inside: what its camera looks at.
        eye: the camera.
        fading: share of the LEDs' power that is lost in the end, as t / (t + `FADING_S`).
        metering: how far the exposure follows the photograph: 1 keeps its metered mean.
    """

    inside: Inside
    eye: Eye = field(default_factory=Eye)
    fading: float = 0.0
    metering: float = 0.0


class Studio:
    """Takes photographs of one make of sensor.

    Args:
        source: a measured data set, whose skins are rendered.
        mitsuba: as `open_mitsuba` returns it.
        width, height: of the photographs.
        sample_count: rays a pixel and colour.

    Attributes:
        unit: the sensor at its commissioning.
        white: radiance that is white then.
        metered: metered mean of its idle photograph, of white.
    """

    def __init__(
        self,
        source: DataSet,
        mitsuba: ModuleType,
        *,
        width: int = 160,
        height: int = 120,
        sample_count: int = 16,
    ) -> None:
        self._source, self._mitsuba = source, mitsuba
        self._entries = {entry.name: entry for entry in source.entries}
        self._renderer: tuple[Inside, InsideRenderer] | None = None
        self.width, self.height, self.sample_count = width, height, sample_count
        self.skin: SkinMesh = source.skin_mesh()
        self._smooth = _smoothing(self.skin)
        self.unit = RenderedUnit(Inside(coat_pattern()))
        self.white, self.metered = 1.0, 1.0
        idle = self.light(self.unit, None, 0.0, seed=0)
        self.white = float(np.percentile(idle, 99.0)) * FULL_SCALE / WHITE_LEVEL
        self.metered = _metered(idle / self.white)

    def measure(
        self,
        directory: Path,
        names: Sequence[str],
        unit: RenderedUnit,
        *,
        frames: int,
        seed: int,
    ) -> None:
        """Write a data set of a unit: idle photographs and bags.

        Args:
            directory: of the data set, which must not exist.
            names: of the source's trajectories.
            unit: the sensor.
            frames: of each trajectory, thinned evenly, the first and the last among them.
            seed: of the samples and of the camera's noise.

        Raises:
            FileExistsError: there is a data set.
        """
        if directory.exists():
            raise FileExistsError(f"{directory} exists; name a folder that does not")
        directory.mkdir(parents=True)
        shutil.copytree(self._source.directory / "indenters", directory / "indenters")
        data_set = DataSetWriter(directory, self.skin)
        random = np.random.default_rng([seed, 1])
        for number in range(IDLE_COUNT):
            photograph = self.photograph(unit, None, 0.0, random)
            cv2.imwrite(
                str(directory / f"idle_{number}.png"), cv2.cvtColor(photograph, cv2.COLOR_RGB2BGR)
            )
        session_s = 0.0
        for name in names:
            trajectory = _thinned(self._entries[name].read(), frames)
            assert trajectory.skin is not None
            stamp_ns = trajectory.skin.stamp_ns
            times = session_s + 1e-9 * (stamp_ns - stamp_ns[0])
            skins = self.smooth_skins(trajectory.skin.position_m)
            photographs = [
                self.photograph(unit, skin, float(t), random)
                for skin, t in zip(skins, times, strict=True)
            ]
            session_s = float(times[-1])
            measured = replace(
                trajectory, image=ImageChannel(stamp_ns, np.stack(photographs)), name=name
            )
            mesh = directory / "indenters" / f"{self._entries[name].indenter}.stl"
            data_set.add(measured, load_indenter(mesh))

    def smooth_skins(self, position_m: NDArray[np.floating]) -> FloatArray:
        """Return measured skins (F, V, 3) with less of their noise; the base stays at rest."""
        rest = self.skin.rest_position_m
        moved = position_m.astype(np.float64) - rest
        for _ in range(SMOOTHING):
            moved = np.stack([self._smooth @ one for one in moved])
        moved[:, self.skin.on_base] = 0.0
        return np.asarray(rest + moved)

    def light(
        self, unit: RenderedUnit, skin_m: FloatArray | None, session_s: float, *, seed: int
    ) -> FloatArray:
        """Return (H, W, 3) the light that the three channels collect, of white.

        Args:
            unit: the sensor.
            skin_m: (V, 3) of its skin; None at rest.
            session_s: since the LEDs were switched on.
            seed: of the samples.
        """
        radiance = self._renderer_of(unit.inside).radiance(
            self.skin.rest_position_m if skin_m is None else skin_m,
            unit.eye,
            led_share=1.0 - unit.fading * session_s / (session_s + FADING_S),
            seed=seed,
        )
        return radiance @ (LEAK + (1.0 - 3.0 * LEAK) * np.eye(3)) / self.white

    def photograph(
        self,
        unit: RenderedUnit,
        skin_m: FloatArray | None,
        session_s: float,
        random: np.random.Generator,
    ) -> ImageArray:
        """Return (H, W, 3) what the camera gives: linear, noisy, whole and within its scale."""
        light = self.light(unit, skin_m, session_s, seed=int(random.integers(2**31)))
        light = light * (self.metered / _metered(light)) ** unit.metering
        levels = FULL_SCALE * light + NOISE_LEVELS * random.standard_normal(light.shape)
        return np.clip(np.rint(levels), 0.0, FULL_SCALE).astype(np.uint8)

    def _renderer_of(self, inside: Inside) -> InsideRenderer:
        """Return the renderer of a scene; that of the last one is kept."""
        if self._renderer is None or self._renderer[0] is not inside:
            renderer = InsideRenderer(
                self.skin.rest_position_m,
                self.skin.triangles,
                inside,
                width=self.width,
                height=self.height,
                sample_count=self.sample_count,
                mitsuba=self._mitsuba,
            )
            self._renderer = inside, renderer
        return self._renderer[1]


def coat_pattern() -> FloatArray:
    """Return (N, N) the reflectance of a coat with random dark blots, over a map of it."""
    rough = rough_map(2, BLOT_RAD)
    return np.asarray(BLOT + (BRIGHT - BLOT) / (1.0 + np.exp(-4.0 * (rough + 0.3))))


def rough_map(seed: int, blur_rad: float) -> FloatArray:
    """Return (N, N) blurred noise of unit variance, over a map of the coat."""
    noise = np.random.default_rng(seed).standard_normal((MAP_SIZE, MAP_SIZE))
    blur_px = 0.5 * MAP_SIZE * blur_rad / MAP_REACH_RAD
    rough = np.asarray(cv2.GaussianBlur(noise, (0, 0), blur_px), dtype=np.float64)
    return np.asarray(rough / rough.std())


def _smoothing(skin: SkinMesh) -> csr_matrix:
    """Return (V, V) what takes half of each vertex's value and half of its neighbours' mean."""
    count = skin.vertex_count
    start = skin.triangles.ravel()
    end = np.roll(skin.triangles, 1, axis=1).ravel()
    ones = np.ones(len(start))
    beside = csr_matrix((ones, (start, end)), shape=(count, count))
    beside = ((beside + beside.T) > 0).astype(np.float64)
    share = csr_matrix(0.5 / beside.sum(axis=1))
    return csr_matrix(beside.multiply(share) + 0.5 * csr_matrix(np.eye(count)))


def _metered(light: FloatArray) -> float:
    """Return the mean of a photograph (H, W, 3), most of it from the middle."""
    height, width = light.shape[:2]
    y, x = np.mgrid[0:height, 0:width]
    square = (x - 0.5 * (width - 1)) ** 2 + (y - 0.5 * (height - 1)) ** 2
    weight = np.exp(-0.5 * square / (METERING_WIDTH * height) ** 2)
    return float(np.average(light.mean(axis=2), weights=weight))


def _thinned(trajectory: Trajectory, frames: int) -> Trajectory:
    """Return some frames of a trajectory whose channels have the same stamps, without images."""
    pose, wrench, skin = trajectory.pose, trajectory.wrench, trajectory.skin
    assert pose is not None
    assert wrench is not None
    assert skin is not None
    kept = np.unique(np.linspace(0, len(pose.stamp_ns) - 1, frames).round().astype(int))
    return Trajectory(
        pose=PoseChannel(pose.stamp_ns[kept], pose.position_m[kept], pose.quaternion_xyzw[kept]),
        wrench=WrenchChannel(wrench.stamp_ns[kept], wrench.force_n[kept], wrench.torque_nm[kept]),
        skin=SkinChannel(skin.stamp_ns[kept], skin.position_m[kept]),
        name=trajectory.name,
    )
