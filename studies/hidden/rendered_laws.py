# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Hidden effects of a path-traced unit: each is wrong in its scene or in its camera.

LEDs shine weaker, light comes through the coat, the coat scatters less, the camera stands or looks
elsewhere or is out of focus, grains lie in the gel. None is an operator on images.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from studies.hidden.path_traced import map_directions
from studies.hidden.rendered_unit import RenderedUnit, rough_map


@dataclass(frozen=True)
class RenderedLaw:
    """A hidden effect.

    Attributes:
        name: in the truth.
        library: names of effects of the library that are right for it; none where it has none.
        sizes: from small to obvious.
        unit: of the size.
        change: from a unit, the size and the radiance that is white at commissioning to the unit
            with the effect.
    """

    name: str
    library: tuple[str, ...]
    sizes: tuple[float, ...]
    unit: str
    change: Callable[[RenderedUnit, float, float], RenderedUnit]


def _fading(unit: RenderedUnit, size: float, _: float) -> RenderedUnit:
    return replace(unit, fading=size)


def _weak(*leds: int) -> Callable[[RenderedUnit, float, float], RenderedUnit]:
    def change(unit: RenderedUnit, size: float, _: float) -> RenderedUnit:
        power = unit.inside.led_power.copy()
        power[list(leds)] *= 1.0 - size
        return replace(unit, inside=replace(unit.inside, led_power=power))

    return change


def _daylight(unit: RenderedUnit, size: float, white: float) -> RenderedUnit:
    # A window at one side.
    side = map_directions() @ np.array([np.cos(0.7), np.sin(0.7), 0.0])
    return replace(unit, inside=replace(unit.inside, glow=size * white * (1.0 + 0.4 * side)))


def _moved(unit: RenderedUnit, size: float, _: float) -> RenderedUnit:
    shift = size * np.array([0.8, -0.6, 0.0])
    x, y, z = (np.array(unit.eye.position_m) + shift).tolist()
    return replace(unit, eye=replace(unit.eye, position_m=(x, y, z)))


def _turned(unit: RenderedUnit, size: float, _: float) -> RenderedUnit:
    return replace(unit, eye=replace(unit.eye, turn_rad=(0.8 * size, -0.5 * size, 0.33 * size)))


def _dark_edge(unit: RenderedUnit, size: float, _: float) -> RenderedUnit:
    return replace(unit, eye=replace(unit.eye, edge_loss=size))


def _metering(unit: RenderedUnit, size: float, _: float) -> RenderedUnit:
    return replace(unit, metering=size)


def _worn(unit: RenderedUnit, size: float, _: float) -> RenderedUnit:
    middle = np.array([np.sin(0.6) * np.cos(2.2), np.sin(0.6) * np.sin(2.2), np.cos(0.6)])
    angle = np.arccos(np.clip(map_directions() @ middle, -1.0, 1.0))
    worn = angle / 0.25 + 0.2 * rough_map(11, 0.05) < 1.0
    coat = unit.inside.coat * (1.0 - size * worn)
    return replace(unit, inside=replace(unit.inside, coat=coat))


def _out_of_focus(unit: RenderedUnit, size: float, _: float) -> RenderedUnit:
    return replace(unit, eye=replace(unit.eye, pupil_m=size, focus_m=6.0e-3))


def _dusty(unit: RenderedUnit, size: float, _: float) -> RenderedUnit:
    random = np.random.default_rng(17)
    way = random.standard_normal((14, 3))
    way[:, 2] = np.abs(way[:, 2])
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    places = np.array(unit.eye.position_m) + 2.0e-3 * way
    return replace(unit, inside=replace(unit.inside, dust_m=places, dust_radius_m=size))


LAWS: Mapping[str, RenderedLaw] = {
    law.name: law
    for law in (
        RenderedLaw("fading_leds", ("led_dimming",), (0.05, 0.15), "share", _fading),
        RenderedLaw("weak_green", ("led_imbalance_green",), (0.03, 0.1), "share", _weak(3, 4, 5)),
        RenderedLaw("one_weak_blue", ("led_imbalance_blue",), (0.3,), "share", _weak(7)),
        RenderedLaw("daylight", ("daylight",), (0.01, 0.03), "of white", _daylight),
        RenderedLaw("moved_camera", ("camera_displacement",), (0.1e-3, 0.4e-3), "m", _moved),
        RenderedLaw("turned_camera", ("camera_extrinsics",), (0.006, 0.02), "rad", _turned),
        RenderedLaw("dark_edge", ("vignetting",), (0.04, 0.12), "edge loss", _dark_edge),
        RenderedLaw("metering", ("auto_exposure",), (1.0,), "strength", _metering),
        RenderedLaw("worn_spot", ("worn_coat",), (0.15, 0.4), "share", _worn),
        RenderedLaw("out_of_focus", ("defocus",), (0.15e-3, 0.4e-3), "m", _out_of_focus),
        RenderedLaw("dusty", (), (0.06e-3,), "m", _dusty),
    )
}  # fmt: skip
