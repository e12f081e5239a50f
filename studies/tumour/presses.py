# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Presses onto soft skins, simulated: our gel and layer, both deformable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from dotsim_ros.gel.discretization import discretize
from dotsim_ros.gel.elasticity import ElasticBody
from dotsim_ros.gel.make import body_of, law_of, skin_of
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import Float32Array, FloatArray
from dotsim_ros.io.cache import GEL, content_key, load_arrays, store_arrays
from dotsim_ros.io.documents import ArrayForm, Arrays
from dotsim_ros.specification import SensorSpecification
from studies.tumour.pair.equilibrium import GelAndLayer, PairError, PairSettings
from studies.tumour.pair.layer import LayerSpecification, SoftLayer
from studies.tumour.skins import Press

GRID_M = 3.6e-3
MARKERS_M = 1.2e-3
"""Of the gel's grid and its skin's markers: forces are 1 to 3 % above those of a grid of 2.4 mm."""
STEP_M = 1.0e-3
"""Between two equilibria the sensor goes no deeper than this."""
SAME_M = 1.0e-7
"""Markers this close lie at one place."""


def coarse(sensor: SensorSpecification) -> SensorSpecification:
    """Return the sensor with the markers that presses are solved with.

    Raises:
        ValueError: its gel is no dome.
    """
    if sensor.gel.shape != "dome":
        raise ValueError(
            f"sensor {sensor.name} has gel.shape {sensor.gel.shape!r}, expected 'dome': skins are "
            "pressed by a dome"
        )
    return replace(sensor, gel=replace(sensor.gel, skin_spacing_m=MARKERS_M))


@dataclass(frozen=True)
class SolvedPress:
    """A press, and the gel's skin in it.

    Attributes:
        press: what was asked.
        skin_m: (T, F, V, 3) the gel's markers in each frame, for each turn about the sensor's axis.
        force_n: (F,) normal force.
    """

    press: Press
    skin_m: Float32Array
    force_n: FloatArray


class Simulation:
    """Our gel and layers, one minimum of their energy for each frame.

    Args:
        sensor: as `coarse` returns it.
        cache: folder of the presses solved before.
    """

    def __init__(self, sensor: SensorSpecification, cache: Path) -> None:
        self.sensor, self._cache = sensor, cache
        self.skin = skin_of(sensor.gel)
        self._pair: GelAndLayer | None = None

    def solved(
        self, layer: LayerSpecification, presses: Sequence[Press], turns: int
    ) -> list[SolvedPress]:
        """Return the presses that could be solved; others are reported and left out.

        Args:
            layer: the soft skin.
            presses: onto it.
            turns: of `skin_turns`, how many of each press.
        """
        found = []
        for number, press in enumerate(presses, start=1):
            made = self._kept(layer, press, f"press {number} of {len(presses)}")
            if made is not None:
                skin, force = made
                found.append(SolvedPress(press, turned_skins(self.skin, skin, turns), force))
        return found

    def _kept(
        self, layer: LayerSpecification, press: Press, name: str
    ) -> tuple[Float32Array, FloatArray] | None:
        s = self.sensor
        key = content_key(
            (*GEL, "../studies/tumour"), (s.gel, s.material), PairSettings(), layer, press
        )
        path = self._cache / "simulated" / f"{key}.npz"
        known = load_arrays(path, press_forms((len(press.depths_m), self.skin.vertex_count, 3)))
        if known is None:
            print(f"simulating {name}")
            known = self._solve(layer, press, name)
            store_arrays(path, known)
        if not known["is_solved"].all():
            print(f"{name} has no equilibrium and is left out")
            return None
        return known["skin_m"], known["force_n"]

    def _solve(self, layer: LayerSpecification, press: Press, name: str) -> Arrays:
        s = self.sensor
        if self._pair is None:
            grid = discretize(body_of(s.gel), self.skin.rest_position_m, GRID_M)
            self._pair = GelAndLayer(ElasticBody(grid, law_of(s.material)), self.skin)
        count = len(press.depths_m)
        skin = np.zeros((count, self.skin.vertex_count, 3), dtype=np.float32)
        force, is_solved = np.zeros(count), np.zeros(count, dtype=np.bool_)
        state = self._pair.put(SoftLayer(layer, press.insert))
        try:
            reached = 0.0
            for frame, depth in enumerate(press.depths_m):
                steps = int(np.ceil((depth - reached) / STEP_M))
                for between in np.linspace(reached, depth, steps + 1)[1:]:
                    pose = press.pose(layer, s.gel.outer_radius_m, float(between))
                    state = self._pair.press(state, pose)
                reached = depth
                skin[frame] = state.skin_position_m
                force[frame] = np.linalg.norm(state.wrench.force_n)
                is_solved[frame] = True
        except PairError as error:
            print(f"{name}: {error}")
        return {"skin_m": skin, "force_n": force, "is_solved": is_solved}


def press_forms(shape: tuple[int, ...]) -> dict[str, ArrayForm]:
    """Return what a kept press holds: `skin_m` of a shape (..., F, V, 3), and by frame the force
    and whether it was solved."""
    frames = (shape[-3],)
    return {
        "skin_m": ArrayForm(shape),
        "force_n": ArrayForm(frames),
        "is_solved": ArrayForm(frames, "truth value"),
    }


def skin_turns(count: int) -> FloatArray:
    """Return (count,) turns about the sensor's axis that map the skin's markers onto each other.

    Raises:
        ValueError: not 1 to 5 of them.
    """
    if not 1 <= count <= 5:
        raise ValueError(f"{count} turns of each press, expected 1 to 5")
    return np.asarray(2.0 * np.pi / 5.0 * np.arange(count), dtype=np.float64)


def turned_skins(skin: SkinMesh, position_m: Float32Array, count: int) -> Float32Array:
    """Return skins (F, V, 3) turned about the sensor's axis, (count, F, V, 3): a press from another
    side, since dome and markers are alike in each fifth of a turn.

    Raises:
        ValueError: the markers are not alike.
    """
    rest = skin.rest_position_m
    found = np.empty((count, *position_m.shape), dtype=np.float32)
    for number, angle in enumerate(skin_turns(count)):
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        far, source = KDTree(rest @ turn.T).query(rest)
        if float(far.max()) > SAME_M:
            raise ValueError(
                f"a fifth of a turn leaves markers {far.max():.3g} m from each other, expected "
                f"{SAME_M} m at most: the skin is none of `dome_skin`"
            )
        found[number] = (position_m @ turn.T)[:, source]
    return found
