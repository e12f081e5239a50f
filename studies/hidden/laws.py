# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Hidden effects, with other laws than those that are looked for.

Stiffening is exponential, not polynomial (Fung 1967; the solver takes its series to third order);
relaxation has two modes; softening follows an error function; an arm gives way more than in
proportion to the force; a late clock jitters; some effects are of no library at all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from scipy.special import erf

from dotsim_ros.gel.material import PronySeries
from dotsim_ros.gel.values import GelValues
from dotsim_ros.geometry.pose import Pose, interpolate
from dotsim_ros.io.arrays import FloatArray


@dataclass(frozen=True)
class LawMotion:
    """A trajectory: F true poses, their times (F,), and the forces (F, 3) that an arm feels
    there without the effect."""

    poses: list[Pose]
    stamp_s: FloatArray
    force_n: FloatArray


@dataclass(frozen=True)
class LawAnswer:
    """What the gel answers: skin (F, V, 3), force (F, 3), and when (F,) in the session."""

    skin_position_m: FloatArray
    force_n: FloatArray
    rest_m: FloatArray
    stamp_s: FloatArray
    session_s: float


@dataclass(frozen=True)
class HiddenLaw:
    """A hidden effect.

    Attributes:
        name: in the truth.
        library: name of the effect that the library knows it by; empty for one it does not know.
        also: names of further effects of the library that are parts of it.
        low, high: range of its size.
        unit: of its size.
        gel: from the gel and the size to the gel and its relaxation.
        motion: from a motion, the size and two generators, the unit's and the trajectory's, to the
            poses as they are.
        answer: from what the gel answers and the size to what is measured.
    """

    name: str
    library: str
    low: float
    high: float
    unit: str
    gel: Callable[[GelValues, float], tuple[GelValues, PronySeries | None]] | None = None
    motion: Callable[[LawMotion, float, Generator, Generator], list[Pose]] | None = None
    answer: Callable[[LawAnswer, float], tuple[FloatArray, FloatArray]] | None = None
    also: tuple[str, ...] = ()


def _slippery(values: GelValues, size: float) -> tuple[GelValues, None]:
    return replace(values, friction=values.friction * size), None


def _exponential(values: GelValues, size: float) -> tuple[GelValues, None]:
    # C10 (exp(b x) - 1) / b = C10 (x + b x^2 / 2 + b^2 x^3 / 6 + ...)
    c20 = values.c20_ratio + 0.5 * size
    return replace(values, c20_ratio=c20, c30_ratio=size**2 / 6.0), None


def _two_modes(values: GelValues, size: float) -> tuple[GelValues, PronySeries]:
    return values, PronySeries((0.6 * size, 0.4 * size), (0.6, 3.0))


def _compressible(values: GelValues, size: float) -> tuple[GelValues, None]:
    return replace(values, poisson_ratio=size), None


def _thin(values: GelValues, size: float) -> tuple[GelValues, None]:
    return replace(values, thickness_m=values.thickness_m * (1.0 - size)), None


def _mounted_off(motion: LawMotion, size: float, unit: Generator, _: Generator) -> list[Pose]:
    direction = unit.standard_normal(3) * [0.3, 0.3, 1.0]
    shift = size * direction / np.linalg.norm(direction)
    return [Pose(p.position_m + shift, p.quaternion_xyzw) for p in motion.poses]


def _late(motion: LawMotion, size: float, _: Generator, random: Generator) -> list[Pose]:
    poses = [motion.poses[0]]
    for frame in range(1, len(motion.poses)):
        duration = motion.stamp_s[frame] - motion.stamp_s[frame - 1]
        late = min(1.0, size * (1.0 + 0.1 * random.standard_normal()) / duration)
        poses.append(interpolate(motion.poses[frame], motion.poses[frame - 1], max(0.0, late)))
    return poses


def _gives_way(motion: LawMotion, size: float, _unit: Generator, _: Generator) -> list[Pose]:
    poses = []
    for pose, force in zip(motion.poses, motion.force_n, strict=True):
        load = float(np.linalg.norm(force))
        lost = size * load * (1.0 + 0.1 * load)
        direction = force / load if load > 0.05 else np.zeros(3)
        poses.append(Pose(pose.position_m + lost * direction, pose.quaternion_xyzw))
    return poses


def _scaled(answer: LawAnswer, size: float) -> tuple[FloatArray, FloatArray]:
    return answer.skin_position_m, (1.0 + size) * answer.force_n


def _softened(answer: LawAnswer, size: float) -> tuple[FloatArray, FloatArray]:
    load = np.linalg.norm(answer.force_n, axis=1)
    peak = np.maximum.accumulate(load)
    fallen = (peak - load) / np.maximum(peak, 1e-9)
    share = 1.0 - size * erf(3.0 * fallen)
    return answer.skin_position_m, share[:, None] * answer.force_n


def _set(answer: LawAnswer, size: float) -> tuple[FloatArray, FloatArray]:
    moved = answer.skin_position_m - answer.rest_m
    depth = np.linalg.norm(moved, axis=2).max(axis=1)
    deepest = np.argmax(depth)
    left = np.zeros_like(moved)
    left[deepest:] = size * moved[deepest]
    share = 1.0 - depth / max(float(depth.max()), 1e-9)
    return answer.skin_position_m + share[:, None, None] * left, answer.force_n


def _crosstalk(answer: LawAnswer, size: float) -> tuple[FloatArray, FloatArray]:
    mixed = answer.force_n.copy()
    mixed[:, 0] += size * answer.force_n[:, 2]
    return answer.skin_position_m, mixed


def _sticky_base(answer: LawAnswer, size: float) -> tuple[FloatArray, FloatArray]:
    height = answer.rest_m[:, 2] / answer.rest_m[:, 2].max()
    lean = answer.force_n[:, None, :] * [1.0, 1.0, 0.0] * (size * (1.0 - height))[None, :, None]
    return answer.skin_position_m + lean, answer.force_n


def _swollen(answer: LawAnswer, size: float) -> tuple[FloatArray, FloatArray]:
    # The skin stands out by so much, except at the bonded base.
    distance = np.linalg.norm(answer.rest_m, axis=1, keepdims=True)
    height = answer.rest_m[:, 2:] / answer.rest_m[:, 2].max()
    outward = answer.rest_m / np.maximum(distance, 1e-9)
    return answer.skin_position_m + size * height * outward, answer.force_n


def _late_skin(answer: LawAnswer, size: float) -> tuple[FloatArray, FloatArray]:
    # The skin is seen by a slower clock than pose and force.
    seen = answer.stamp_s - size
    right = np.clip(np.searchsorted(answer.stamp_s, seen), 1, len(seen) - 1)
    left = right - 1
    step = answer.stamp_s[right] - answer.stamp_s[left]
    share = np.clip((seen - answer.stamp_s[left]) / step, 0.0, 1.0)[:, None, None]
    skin = answer.skin_position_m
    return (1.0 - share) * skin[left] + share * skin[right], answer.force_n


LAWS: Mapping[str, HiddenLaw] = {
    law.name: law
    for law in (
        HiddenLaw("slippery", "coulomb_slip", 0.3, 0.7, "of friction", gel=_slippery),
        HiddenLaw(
            "exponential_stiffening", "hyperelastic_stiffening", 0.25, 0.8, "b", gel=_exponential
        ),
        HiddenLaw(
            "two_mode_relaxation", "viscoelastic_relaxation", 0.1, 0.35, "share", gel=_two_modes
        ),
        HiddenLaw("compressible", "compressibility", 0.40, 0.45, "nu", gel=_compressible),
        HiddenLaw("thin", "thickness_error", 0.05, 0.12, "of thickness", gel=_thin),
        HiddenLaw("mounted_off", "pose_offset", 0.15e-3, 0.4e-3, "m", motion=_mounted_off,
            also=("pose_offset_x", "pose_offset_y")),
        HiddenLaw("late", "latency", 0.02, 0.06, "s", motion=_late),
        HiddenLaw("gives_way", "base_compliance", 0.03e-3, 0.1e-3, "m/N", motion=_gives_way),
        HiddenLaw("scaled_force", "force_scale", 0.15, 0.3, "share", answer=_scaled),
        HiddenLaw("softened", "mullins_softening", 0.15, 0.35, "share", answer=_softened),
        HiddenLaw("set", "permanent_set", 0.04, 0.1, "of the peak", answer=_set),
        HiddenLaw("crosstalk", "force_crosstalk_x", 0.1, 0.25, "share", answer=_crosstalk),
        HiddenLaw("leaning_base", "", 0.05e-3, 0.2e-3, "m/N", answer=_sticky_base),
        HiddenLaw("swollen", "", 0.1e-3, 0.3e-3, "m", answer=_swollen),
        HiddenLaw("late_skin", "", 0.05, 0.15, "s", answer=_late_skin),
    )
}  # fmt: skip

FORMULAS_OF_LIBRARY = (
    "slippery",
    "compressible",
    "thin",
    "mounted_off",
    "scaled_force",
    "crosstalk",
)
"""Laws that are the library's own formulas in other letters: finding them tells nothing about an
effect of another form."""
OTHER_LAWS = tuple(name for name in LAWS if name not in FORMULAS_OF_LIBRARY)
