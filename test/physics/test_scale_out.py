# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The same answers whatever the number of workers, and wherever they are."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dotsim_ros.control.policy.demonstration import Plan, demonstrate, episode_file
from dotsim_ros.gel.make import skin_of
from dotsim_ros.gel.material import PronySeries
from dotsim_ros.gel.values import values_of
from dotsim_ros.geometry.indenter import Indenter, IndenterKind, IndenterMesh, load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.worker_pool.pool import Crew, RayWorkers
from dotsim_ros.io.worker_pool.ray_cluster import ON_THIS_MACHINE, SETTINGS
from dotsim_ros.specification import SensorSpecification, load_sensor
from dotsim_ros.twin.follow import SimulatedPress
from dotsim_ros.twin.solver import SolveRequest, open_press_solver

ray = pytest.importorskip("ray", reason="needs the extra scale: pip install '.[scale]'")
ROOT = Path(__file__).parents[2]
COARSE = replace(load_sensor("densetact2"), name="coarse")
COARSE = replace(COARSE, solver=replace(COARSE.solver, refined=False, grid_spacing_m=4.8e-3))
# A small image, whose pattern is drawn soon.
SMALL = replace(
    COARSE,
    camera=replace(
        COARSE.camera, width=160, height=120, principal_point_px=(79.5, 59.5), idle_image=""
    ),
)


@pytest.fixture(scope="module")
def on_ray():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
        for name, value in (SETTINGS | ON_THIS_MACHINE).items():
            patch.setenv(name, value)
        yield RayWorkers(2, "local")
        ray.shutdown()


def presses(sensor: SensorSpecification, count: int) -> list[SolveRequest]:
    """Presses of a ball whose mesh is large enough to be shared."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=2.0e-3)
    vertices_m = np.asarray(mesh.vertices) + np.array([0.0, 0.0, 2.0e-3])
    surface = IndenterMesh(vertices_m, np.asarray(mesh.faces, dtype=np.int32))
    shape = Indenter(IndenterKind.MESH, (), mesh=surface)
    apex_m = skin_of(sensor.gel).apex_m
    return [
        SolveRequest(
            f"press {number}",
            shape,
            tuple(
                Pose(apex_m + np.array([5e-4 * number, 0.0, -depth])) for depth in (0.5e-3, 1.0e-3)
            ),
            np.array([0.0, 0.1]),
            values_of(sensor),
            PronySeries((), ()),
        )
        for number in range(count)
    ]


def solved(folder: Path, crew: Crew) -> list[SimulatedPress]:
    requests = presses(COARSE, 2)
    with open_press_solver(COARSE, skin_of(COARSE.gel), folder, workers=crew) as solver:
        found = solver.run_each(requests)
        assert solver.solve_count == len(requests)
    assert len(list(folder.glob("*.npz"))) == len(requests)
    return [press for press in found if isinstance(press, SimulatedPress)]


def test_presses_are_the_same_to_the_last_bit(tmp_path, on_ray):
    alone = solved(tmp_path / "alone", 1)
    assert len(alone) == 2
    assert np.ptp([press.force_n for press in alone]) > 0.0
    for number, crew in enumerate((2, on_ray)):
        for press, other in zip(alone, solved(tmp_path / str(number), crew), strict=True):
            np.testing.assert_array_equal(press.skin_position_m, other.skin_position_m)
            np.testing.assert_array_equal(press.force_n, other.force_n)


def test_episodes_are_the_same_to_the_last_bit(tmp_path, on_ray):
    plan = Plan("coarse", ("line",), episode_count=2, frame_count=10, look_count=1)
    ball = load_indenter("sphere_4mm")
    done: list[tuple[int, int]] = []
    for name, crew in (("alone", 1), ("ray", on_ray)):
        demonstrate(
            SMALL,
            ball,
            plan,
            tmp_path / name,
            progress=lambda *now: done.append(now),
            workers=crew,
        )
    assert done == [(1, 2), (2, 2)] * 2
    for number in range(2):
        with (
            np.load(episode_file(tmp_path / "alone", number)) as alone,
            np.load(episode_file(tmp_path / "ray", number)) as other,
        ):
            assert alone.files == other.files
            for key in alone.files:
                np.testing.assert_array_equal(alone[key], other[key])
