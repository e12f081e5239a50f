# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Answers kept on disk: another input gives another one, and a broken file is computed again."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dotsim_ros.calibration.fitting import FitProblem, PressFit, PressLinearisation
from dotsim_ros.calibration.loss import FORCE, POINTS, LossNoise
from dotsim_ros.calibration.loss import SKIN as SKIN_CHANNEL
from dotsim_ros.calibration.parameters import chosen_parameters
from dotsim_ros.calibration.stages import Task, Workers
from dotsim_ros.data.presses import Press
from dotsim_ros.data.reading import Observation
from dotsim_ros.data.recording import Phase, Recording
from dotsim_ros.effects.effect import Active
from dotsim_ros.effects.library import load_effects
from dotsim_ros.effects.simulate import EffectRequest, EffectSolver
from dotsim_ros.gel.values import values_of
from dotsim_ros.geometry.indenter import Indenter, IndenterMesh, load_mesh, sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin
from dotsim_ros.geometry.surface import indenter_surface
from dotsim_ros.io import cache
from dotsim_ros.specification import SensorSpecification, load_sensor
from dotsim_ros.twin.follow import SimulatedPress
from dotsim_ros.twin.solver import MAKING, TOGETHER, PressSolver

SENSOR = SensorSpecification()
SKIN = dome_skin(0.01575, 4e-3)
POSES = [Pose(np.array([0.0, 0.0, 0.0155 - 0.001 * frame])) for frame in range(3)]
"""Of a press of three frames."""


class Pool:
    """Stands where a pool of processes does: every request is answered by a function, and counted;
    a task is a request, or a tuple of them."""

    def __init__(self, answer: Callable[[Any], Any]) -> None:
        self.answer, self.count = answer, 0
        self.tasks: list[Any] = []

    def submit(self, _work: Callable[..., Any], task: Any) -> Future[Any]:
        future: Future[Any] = Future()
        if isinstance(task, int):  # a table of the refinement, which no answer here depends on
            future.set_result(None)
            return future
        self.tasks.append(task)
        self.count += len(task) if isinstance(task, tuple) else 1
        found = [self.answer(r) for r in task] if isinstance(task, tuple) else self.answer(task)
        future.set_result(found)
        return future


def solved(request: Any) -> SimulatedPress:
    count = len(request.poses)
    return SimulatedPress(
        np.repeat(SKIN.rest_position_m[None], count, axis=0), np.ones((count, 3)), True
    )


def mesh_of(indenter: Indenter, folder: Path) -> Indenter:
    """Return an indenter as a mesh that a file of one name holds."""
    import trimesh

    surface = indenter_surface(indenter, 1e-3)
    path = folder / "tip.stl"
    trimesh.Trimesh(surface.vertices_m, surface.triangles, process=False).export(path)
    return load_mesh(path)


def recording_of(indenter: Indenter) -> Recording:
    press = Press("press", "tip", POSES, np.arange(3.0), None, np.ones((3, 3)))
    depth_m = np.array([0.0, 1e-3, 2e-3])
    return Recording(press, indenter, 0.0, depth_m, (Phase.IDLE, Phase.LOAD, Phase.LOAD))


EFFECT = """
from dotsim_ros.effects.effect import FORCE, Effect, EffectParameter
from dotsim_ros.effects.builtin.pose import shifted
import numpy as np

def _motion(values):
    def moved(stamp_s, pose, force_n):
        return shifted(pose, np.array([0.0, 0.0, SHIFT]))
    return moved

EFFECT = Effect(name="lift", title="Lift", parameters=(EffectParameter("x", "", 0.0, 0.0, 1.0,
    (0.5,)),), channels=(FORCE,), protocol="any", excited_by=lambda recording: True,
    motion=_motion)
"""


def solve(
    folder: Path,
    pool: Pool,
    *,
    sensor: SensorSpecification = SENSOR,
    skin: SkinMesh = SKIN,
    indenter: Indenter | None = None,
    effects: Sequence[Path] = (),
) -> int:
    """Solve a press as the finder does; return how many solves that took."""
    before = pool.count
    presses = PressSolver(pool, folder / "solves", sensor, skin)  # type: ignore[arg-type]
    solver = EffectSolver(presses, sensor, skin)
    active = [Active(load_effects(effects)["lift"], {"x": 0.5})] if effects else []
    recording = recording_of(sphere(0.004) if indenter is None else indenter)
    solver.run([EffectRequest(recording, values_of(sensor), effects=active)])
    return pool.count - before


@pytest.mark.fault("find-gap", "an indenter's mesh, the sensor or an effect changed, its name not")
def test_a_solve_is_kept_under_all_that_decides_it(tmp_path, monkeypatch, answered):
    pool = Pool(solved)
    seen: dict[str, int] = {}
    ball = mesh_of(sphere(0.004), tmp_path)
    assert solve(tmp_path, pool, indenter=ball) == 1
    seen["nothing"] = solve(tmp_path, pool, indenter=ball)
    assert seen["nothing"] == 0
    # Another mesh in the file of the same name.
    seen["the mesh"] = solve(tmp_path, pool, indenter=mesh_of(sphere(0.0041), tmp_path))
    assert seen["the mesh"] == 1
    # Another sensor in the file of the same name: its gel, its solver, its contact.
    path = tmp_path / "sensor.yaml"
    for text in (
        "gel: {core_radius_m: 0.0061}",
        "solver: {grid_spacing_m: 0.003}",
        "contact: {stiffness: 51.0}",
        "material: {poisson_ratio: 0.47}",
    ):
        path.write_text(f"name: same\n{text}\n", encoding="utf-8")
        seen[text.partition(":")[0]] = solve(
            tmp_path, pool, sensor=load_sensor(path), indenter=ball
        )
        assert seen[text.partition(":")[0]] == 1, text
        assert solve(tmp_path, pool, sensor=load_sensor(path), indenter=ball) == 0, text
    # No solve depends on Young's modulus: the force is scaled afterwards.
    path.write_text("material: {youngs_modulus_pa: 1.0e5}", encoding="utf-8")
    seen["Young's modulus"] = solve(tmp_path, pool, sensor=load_sensor(path), indenter=ball)
    assert seen["Young's modulus"] == 0
    # The same vertices in other triangles weigh the skin's points otherwise.
    areas = replace(SKIN, rest_area_m2=SKIN.rest_area_m2[::-1].copy())
    assert solve(tmp_path, pool, skin=areas, indenter=ball) == 1
    # Another code in a user's effect of the same name and values.
    own = tmp_path / "own"
    own.mkdir()
    for shift, count in (("1e-4", 1), ("1e-4", 0), ("2e-4", 1)):
        (own / "lift.py").write_text(EFFECT.replace("SHIFT", shift), encoding="utf-8")
        seen["an effect's file"] = solve(tmp_path, pool, indenter=ball, effects=[own])
        assert seen["an effect's file"] == count, shift
    # Another version of the physics.
    monkeypatch.setattr(cache, "source_hash", lambda *_: "of other source")
    assert solve(tmp_path, pool, indenter=ball) == 1
    again, kept = ([what for what, n in seen.items() if n == count] for count in (1, 0))
    answered(f"solved again where {', '.join(again)} changed; kept where {', '.join(kept)} did")


BROKEN: dict[str, bytes] = {
    "empty": b"",
    "of something else": b"\x00" * 2000,
}


def arrays_of(**arrays: Any) -> Callable[[Path], None]:
    return lambda path: np.savez(path, **arrays)


SPOILT: dict[str, Callable[[Path], Any]] = {
    **{what: (lambda path, c=content: path.write_bytes(c)) for what, content in BROKEN.items()},
    "half of it": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "without the force": arrays_of(skin_position_m=np.zeros((3, SKIN.vertex_count, 3))),
    "of another press": arrays_of(
        skin_position_m=np.zeros((2, 5, 3)), force_n=np.zeros((2, 3)), converged=np.array(True)
    ),
    "not finite": arrays_of(
        skin_position_m=np.full((3, SKIN.vertex_count, 3), np.nan),
        force_n=np.zeros((3, 3)),
        converged=np.array(True),
    ),
    "objects": arrays_of(skin_position_m=np.array([{}], dtype=object)),
}


def test_presses_of_one_gel_are_one_task(tmp_path):
    pool = Pool(solved)
    presses = PressSolver(pool, tmp_path, SENSOR, SKIN)  # type: ignore[arg-type]
    solver = EffectSolver(presses, SENSOR, SKIN)
    recordings = [recording_of(sphere(radius)) for radius in np.linspace(3e-3, 5e-3, 12).tolist()]
    values = values_of(SENSOR)
    gels = (values, replace(values, friction=0.1), replace(values, poisson_ratio=0.4))
    done: list[tuple[int, int]] = []
    solver.run(
        [EffectRequest(recording, gel) for recording in recordings for gel in gels],
        lambda *counts: done.append(counts),
    )
    ratios = [{request.values.poisson_ratio for request in task} for task in pool.tasks]
    assert [len(each) for each in ratios] == [1] * 5
    # Friction is no reason to make a gel again.
    assert [len(task) for task in pool.tasks] == [TOGETHER, TOGETHER, TOGETHER, TOGETHER, 4]
    assert done[0] == (0, 36 + 2 * MAKING)
    assert done[-1] == (36 + 2 * MAKING, 36 + 2 * MAKING)


@pytest.mark.fault("find-gap", "a kept solve that is empty, cut short, or of something else")
@pytest.mark.parametrize("what", list(SPOILT))
def test_a_broken_solve_is_computed_anew(tmp_path, what, caplog, answered):
    pool = Pool(solved)
    assert solve(tmp_path, pool) == 1
    (path,) = (tmp_path / "solves").glob("*.npz")
    SPOILT[what](path)
    with caplog.at_level(logging.WARNING):
        assert solve(tmp_path, pool) == 1
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith(f"{path} cannot be used and is computed again: ")
    assert "pickle" not in line
    assert solve(tmp_path, pool) == 0
    if what == "empty":
        answered(line.replace(path.name, "KEY.npz"))


PROBLEM = FitProblem(chosen_parameters(["E", "nu"]), values_of(SENSOR), LossNoise(), POINTS)


def fitted(task: Task) -> PressFit:
    size = task.problem.size
    channels = (SKIN_CHANNEL, FORCE)
    found = PressLinearisation(
        task.point,
        {c: np.eye(size) for c in channels},
        {c: np.ones(size) for c in channels},
        dict.fromkeys(channels, 1.0),
        dict.fromkeys(channels, 9),
        3,
        True,
    )
    return PressFit(found, [2.0], 3, True)


def stage(folder: Path, pool: Pool, observation: Observation, **changes: Any) -> dict[str, Any]:
    given = {"sensor": SENSOR, "skin": SKIN, "problem": PROBLEM, **changes}
    problem: FitProblem = given["problem"]
    workers = Workers(pool, given["sensor"], given["skin"], folder)
    return dict(workers.run("start", [Task(observation, problem, problem.centre())]))


def observation_of(indenter: Indenter, name: str = "press") -> Observation:
    skin = np.repeat(SKIN.rest_position_m[None], 3, axis=0)
    return Observation(Press(name, "tip", POSES, np.arange(3.0), skin, np.ones((3, 3))), indenter)


def moved(mesh: IndenterMesh) -> IndenterMesh:
    vertices = mesh.vertices_m.copy()
    vertices[0, 2] += 1e-6
    return replace(mesh, vertices_m=vertices)


def test_a_stage_of_a_calibration_is_kept_under_all_that_decides_it(tmp_path):
    pool = Pool(fitted)
    ball = mesh_of(sphere(0.004), tmp_path)
    assert ball.mesh is not None
    first = stage(tmp_path, pool, observation_of(ball))["press"]
    again = stage(tmp_path, pool, observation_of(ball))["press"]
    assert pool.count == 1
    assert np.array_equal(
        first.best.information[SKIN_CHANNEL], again.best.information[SKIN_CHANNEL]
    )
    thicker = replace(SENSOR, gel=replace(SENSOR.gel, core_radius_m=0.0059))
    changed: list[tuple[Observation, dict[str, Any]]] = [
        (observation_of(replace(ball, mesh=moved(ball.mesh))), {}),
        (
            observation_of(ball),
            {"sensor": thicker},
        ),
        (observation_of(ball), {"skin": replace(SKIN, rest_area_m2=2.0 * SKIN.rest_area_m2)}),
        (observation_of(ball), {"problem": replace(PROBLEM, noise=LossNoise(force_n=0.02))}),
    ]
    for number, (observation, changes) in enumerate(changed, start=2):
        stage(tmp_path, pool, observation, **changes)
        assert pool.count == number


def json_with(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path], Any]:
    def spoil(path: Path) -> None:
        record = json.loads(path.read_text())
        path.write_text(json.dumps(change(record) or record))

    return spoil


def without_best(record: dict[str, Any]) -> None:
    del record["fit"]["best"]["gradient"]


def of_another_size(record: dict[str, Any]) -> None:
    record["fit"]["best"]["information"] = {SKIN_CHANNEL: [[1.0]], FORCE: [[1.0]]}


SPOILT_STAGE: dict[str, Callable[[Path], Any]] = {
    **{what: (lambda path, c=content: path.write_bytes(c)) for what, content in BROKEN.items()},
    "half of it": lambda path: path.write_text(path.read_text()[:400]),
    "a list": lambda path: path.write_text("[1, 2]"),
    "a fit without a gradient": json_with(without_best),
    "a fit of another size": json_with(of_another_size),
    "neither fit nor error": json_with(lambda record: {"key": record["key"]}),
}


@pytest.mark.fault("calibrate", "a stage's file that is empty, cut short, or of something else")
@pytest.mark.parametrize("what", list(SPOILT_STAGE))
def test_a_broken_stage_is_computed_anew(tmp_path, what, caplog, answered):
    pool, observation = Pool(fitted), observation_of(sphere(0.004))
    stage(tmp_path, pool, observation)
    path = tmp_path / "start" / "press.json"
    SPOILT_STAGE[what](path)
    with caplog.at_level(logging.WARNING):
        found = stage(tmp_path, pool, observation)["press"]
    assert pool.count == 2
    assert isinstance(found, PressFit)
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith(f"{path} cannot be used and is computed again: ")
    stage(tmp_path, pool, observation)
    assert pool.count == 2
    if what == "half of it":
        answered(line)


def test_a_press_with_a_long_name_has_a_file(tmp_path):
    pool = Pool(fitted)
    names = ["x" * 250, "x" * 249 + "y", "圧" * 85, "byte\udcff"]
    for name in names:
        assert name in stage(tmp_path, pool, observation_of(sphere(0.004), name))
    for name in names:
        stage(tmp_path, pool, observation_of(sphere(0.004), name))
    assert pool.count == len(names)
