# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A search that is not sure, the trajectory that it asks for, and the search with its recording,
which a command makes: this file as a program.

Presses at one speed in one direction cannot tell a latency from a pose offset along z, which moves
the indenter alike: the finder asks for what goes there and back, fast, and then names the latency.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.data.data_set_writer import DataSetWriter
from dotsim_ros.data.measurement import read_poses
from dotsim_ros.data.motion import at_speed
from dotsim_ros.data.scripted import Site
from dotsim_ros.data.trajectory import PoseChannel, SkinChannel, Trajectory, WrenchChannel
from dotsim_ros.effects.effect import Active
from dotsim_ros.effects.library import load_effects
from dotsim_ros.effects.simulate import EffectRequest, open_solver
from dotsim_ros.gap import decision
from dotsim_ros.gap.ask import search_and_ask
from dotsim_ros.gap.find import find_gap
from dotsim_ros.gap.findings import Findings, Verdict
from dotsim_ros.gap.presses import questions
from dotsim_ros.gap.presses.catalogue import Planned
from dotsim_ros.gel.values import values_of
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.specification import load_sensor

LATENCY_S = 0.06
DEPTHS_M = (-0.5e-3, 0.6e-3, 1.2e-3, 1.8e-3, 2.4e-3)
# A refined gel needs tables for each skin and Poisson's ratio: minutes.
SENSOR = load_sensor("sensor_a")
SENSOR = replace(SENSOR, solver=replace(SENSOR.solver, refined=False, grid_spacing_m=4.8e-3))
SKIN = dome_skin(SENSOR.gel.outer_radius_m, 2.5e-3)
DEVIATION_M, DEVIATION_N = 0.04e-3, 0.015


def record(planned: Path, measured: Path, solves: Path) -> None:
    """Record planned poses with a twin that is late."""
    effect = load_effects()["latency"]
    recordings, _ = read_poses(planned, skin=SKIN)
    random = np.random.default_rng(len(recordings))
    late = [Active(effect, {"latency_s": LATENCY_S})]
    with open_solver(SENSOR, SKIN, solves, workers=1) as solver:
        found = solver.run([EffectRequest(r, values_of(SENSOR), effects=late) for r in recordings])
    writer = DataSetWriter(measured, SKIN)
    for recording, one in zip(recordings, found, strict=True):
        stamp_ns = (1e9 * (recording.session_s + recording.press.stamp_s)).astype(np.int64)
        skin_m = one.skin_position_m + DEVIATION_M * random.standard_normal((SKIN.vertex_count, 3))
        force_n = one.force_n + DEVIATION_N * random.standard_normal(one.force_n.shape)
        measured_ones = Trajectory(
            pose=PoseChannel.of(stamp_ns, recording.press.poses),
            wrench=WrenchChannel(stamp_ns, force_n, np.zeros_like(force_n)),
            skin=SkinChannel(stamp_ns, skin_m.astype(np.float32)),
            name=recording.name,
        )
        writer.add(measured_ones, recording.indenter)


def press_once(folder: Path) -> None:
    """Plan presses that do not come back."""
    writer = DataSetWriter(folder, SKIN)
    for number, tilt_deg in enumerate((0.0, 15.0, 30.0)):
        site = Site(SENSOR.gel.outer_radius_m, np.deg2rad(tilt_deg))
        motion = at_speed([site.pose(depth) for depth in DEPTHS_M], speed_m_s=0.005)
        stamp_ns = (1e9 * (40.0 * number + motion.time_s)).astype(np.int64)
        trajectory = Trajectory(pose=PoseChannel.of(stamp_ns, motion.poses), name=f"press_{number}")
        writer.add(trajectory, sphere(0.004))


OPTIONS: dict[str, Any] = {
    "sensor": SENSOR,
    "candidates": ("latency", "pose_offset"),
    "workers": 1,
}


@pytest.fixture(autouse=True)
def few_to_choose_from(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = questions.catalogue

    def two(*given: object) -> list[Planned]:
        return [one for one in whole(*given) if one.kind in ("fast", "reversals")]

    monkeypatch.setattr(questions, "catalogue", two)


def gain_of_the_right(findings: Findings) -> float:
    score = {candidate.name: candidate.score for candidate in findings.candidates}
    return score["latency"] - score["pose_offset"]


def test_what_is_asked_for_decides_what_it_was_to_decide(tmp_path: Path) -> None:
    data, out = tmp_path / "data", tmp_path / "report"
    press_once(tmp_path / "plan")
    record(tmp_path / "plan", data, tmp_path / "truth")

    before = find_gap(data, out=out, next_presses=1, **OPTIONS)
    assert before.verdict is Verdict.SET
    assert {*before.named, *before.alternatives} == {"latency", "pose_offset"}
    assert {one.name for one in before.explanations} == {
        "no_gap",
        "latency",
        "pose_offset",
        "unknown",
    }
    (question,) = before.questions
    assert question.name == "asked_1_fast"
    assert "Record next: two presses to 2.4" in before.sentence
    assert 0.0 < question.information_nats < np.log(4.0)
    (planned,) = read_data_set(out / "next").entries
    assert planned.name == question.name
    solved = {path: path.stat().st_mtime_ns for path in (out / "run" / "solves").iterdir()}

    said: list[str] = []

    after = search_and_ask(
        data,
        f"{sys.executable} {Path(__file__)}",
        out=out,
        next_presses=1,
        rounds=2,
        announce=said.append,
        **OPTIONS,
    )
    assert len(said) == 1
    assert [entry.name for entry in read_data_set(data).entries] == [f"press_{k}" for k in range(3)]
    assert after.verdict is Verdict.NAMED
    assert after.named == ("latency",)
    assert after.questions == ()
    assert not (out / "next").exists()
    # What was asked for is searched; what was solved is not solved again.
    assert question.name in after.trajectories
    assert (
        solved.items()
        <= {p: p.stat().st_mtime_ns for p in (out / "run" / "solves").iterdir()}.items()
    )
    # The scores, twice the logarithm of the likelihood, come to differ by what the distance says at
    # least: it allows for all sizes that the data before left possible.
    predicted = 8.0 * decision.HEAVIER * question.apart_nats["pose_offset"]
    assert gain_of_the_right(after) - gain_of_the_right(before) > predicted


if __name__ == "__main__":
    planned, folder = map(Path, sys.argv[1:])
    record(planned, folder / "recorded", folder / "truth")
    for bag in (folder / "recorded" / "bags").iterdir():
        bag.rename(folder / bag.name)
