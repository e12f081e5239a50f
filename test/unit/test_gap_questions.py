# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a trajectory would say before it is recorded, against closed forms and against drawn
answers; and the trajectories that can be asked for."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from dotsim_ros.data.data_set import DataSet, read_data_set
from dotsim_ros.data.data_set_writer import write_data_set
from dotsim_ros.data.scripted import Site
from dotsim_ros.data.trajectory import PoseChannel, Trajectory, WrenchChannel, write_trajectory
from dotsim_ros.effects.effect import FORCE, Effect, EffectParameter
from dotsim_ros.gap import ask, decision
from dotsim_ros.gap.findings import Findings, Question, Verdict
from dotsim_ros.gap.next_presses import write_questions
from dotsim_ros.gap.presses.catalogue import catalogue
from dotsim_ros.gap.presses.evidence import Segment, Variant
from dotsim_ros.gap.presses.inference import Evidence, fit, fit_nuisances
from dotsim_ros.gap.presses.information import Beliefs, distances, information, weights_of
from dotsim_ros.gap.presses.questions import Possible, beliefs_of
from dotsim_ros.gap.presses.screening import try_segment
from dotsim_ros.gap.presses.search_state import Ranked
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.io.replacement import remove_made
from dotsim_ros.specification import load_sensor

HALF = np.array([0.5, 0.5])


def beliefs(means: list[list[float]], variances: list[list[float]]) -> Beliefs:
    count = len(means)
    return Beliefs(
        np.full(count, 1.0 / count), np.array(means), np.stack(list(map(np.diag, variances)))
    )


def test_the_information_between_two_normal_explanations_has_its_closed_form() -> None:
    # Means 3 apart in noise of variance 1, the sizes being known.
    known = beliefs([[0.0], [3.0]], [[0.0], [0.0]])
    distance = distances(known, np.eye(1))
    assert distance[0, 1] == pytest.approx(9.0 / 8.0)
    expected = -np.log(0.5 * (1.0 + np.exp(-9.0 / 8.0)))
    assert information(HALF, distance) == pytest.approx(expected)
    # One mean, variances of 1 and 4: half the logarithm of (1 + 4) / (2 sqrt(1 * 4)).
    widths = distances(beliefs([[0.0], [0.0]], [[0.0], [3.0]]), np.eye(1))
    assert widths[0, 1] == pytest.approx(0.5 * np.log(5.0 / 4.0))
    # What is alike says nothing, what is far apart all that there is to say.
    assert information(HALF, distances(known, np.zeros((5, 1)))) == pytest.approx(0.0, abs=1e-12)
    assert information(HALF, distances(known, 1e3 * np.eye(1))) == pytest.approx(np.log(2.0))
    # No turn of the observables, and no further ones without a signal, change it.
    turned = np.zeros((40, 1))
    turned[7] = -1.0
    np.testing.assert_allclose(distances(known, turned), distance, atol=1e-12)


def test_a_nuisance_that_imitates_the_difference_leaves_no_information() -> None:
    means, column = [[0.0, 0.0], [3.0, 0.0]], np.array([[1.0, 1.0], [0.5, 0.5]])
    across = column * [[1.0, 1.0], [1.0, -1.0]]
    for deviation, imitated, seen in ((0.0, 1.4, 1.4), (1e3, 0.0, 0.9)):
        uncertain = beliefs(means, [[0.0, deviation**2]] * 2)
        # The same way, and another one.
        assert distances(uncertain, column)[0, 1] == pytest.approx(imitated, abs=0.05)
        assert distances(uncertain, across)[0, 1] == pytest.approx(seen, abs=0.05)


def test_no_explanation_is_ruled_out_for_good() -> None:
    weight = weights_of(np.array([0.0, -1.0, -800.0]), 0.01)
    assert weight.sum() == pytest.approx(1.0)
    assert weight[0] / weight[1] == pytest.approx(np.e)
    assert weight[2] == pytest.approx(0.01, rel=0.02)


EACH, COUNT = 60, 4
FACTOR = 1.5
"""Of a discrepancy that is representative."""


def test_answers_separate_two_effects_by_what_was_predicted() -> None:
    """Two effects that the data show alike; the data of a further trajectory, in which they differ,
    are drawn with the first one at work. Their gains, twice the logarithm of the likelihood, come
    to differ by what the distance says: 8 times it, and the factor that real data count less by."""
    random = np.random.default_rng(4)
    rows = COUNT * EACH
    nuisance = random.standard_normal((rows + EACH, 2))
    first = random.standard_normal(rows + EACH)
    second = first + 0.02 * random.standard_normal(rows + EACH)
    second[rows:] = 0.7 * first[rows:] + 0.5 * random.standard_normal(EACH)
    number = np.repeat(np.arange(COUNT + 1), EACH)

    def gains(residual: np.ndarray, count: int) -> list[float]:
        known = Evidence(residual, nuisance[:count], number[:count])
        return [
            -fit(known, column[:count, None], np.zeros(1)).objective for column in (first, second)
        ]

    grown, predicted = [], []
    for _ in range(20):
        noise = random.standard_normal(rows + EACH)
        residual = nuisance @ random.standard_normal(2) + 0.6 * first + noise
        evidence = Evidence(residual[:rows], nuisance[:rows], number[:rows])
        base = fit_nuisances(evidence).objective
        entries = []
        for name, column in (("first", first), ("second", second)):
            effect = Effect(
                name,
                name,
                (EffectParameter("size", "", 0.0, 0.0, 2.0, (1.0,)),),
                (FORCE,),
                "",
                bool,
            )
            variant = Variant(effect, {}, [0.0, 1.0])
            segment = Segment(variant, 0.0, np.zeros(rows), column[:rows], 0.0, 2.0)
            entries.append(Ranked(effect, [variant], try_segment(evidence, segment, base)))
        search = SimpleNamespace(
            evidence=evidence,
            pattern_columns=np.zeros((rows, 1)),
            least_factor=decision.MARGIN,
        )
        possible = [Possible(e.effect.name, e.effect.title, (e,)) for e in entries]
        found = beliefs_of(search, possible, entries)
        assert 0.2 < found.weight[0] < 0.8
        sizes = [e.trial.size for e in entries]
        columns = np.stack([first[rows:] * sizes[0], second[rows:] * sizes[1]], axis=1)
        asked = np.concatenate([nuisance[rows:], columns, np.zeros((EACH, 1))], axis=1)
        predicted.append(8.0 * FACTOR * distances(found, asked / np.sqrt(FACTOR))[0, 1])
        after, before = gains(residual, rows + EACH), gains(residual[:rows], rows)
        grown.append(after[0] - after[1] - before[0] + before[1])
        # A trajectory in which both do the same decides nothing.
        columns = np.repeat(first[rows:, None], 2, axis=1) * sizes
        alike = np.concatenate([nuisance[rows:], columns, np.zeros((EACH, 1))], axis=1)
        assert information(found.weight, distances(found, alike)) < 0.01
    assert 0.7 < np.mean(grown) / np.mean(predicted) < 1.4


@pytest.mark.parametrize("sensor", ["sensor_a", "gelsight_mini"])
def test_what_is_asked_for_stays_as_deep_as_the_data_went_and_on_the_gel(sensor: str) -> None:
    gel = load_sensor(sensor).gel
    found = catalogue(gel, {"ball": 1.5e-3, "torus": 1.0e-3})
    assert {"press", "slide", "twist", "cycles"} <= {one.kind for one in found}
    assert {one.indenter for one in found} == {"ball", "torus"}
    assert len({one.path for one in found if one.indenter == "ball"}) == len(found) - 2
    for one in found:
        assert len(one.poses) == len(one.stamp_s) <= 14
        assert (np.diff(one.stamp_s) > 0.0).all()
        position = np.stack([pose.position_m for pose in one.poses])
        if gel.shape == "dome":
            depth = gel.outer_radius_m - np.linalg.norm(position, axis=1)
        else:
            depth = gel.thickness_m - position[:, 2]
            assert (np.abs(position[:, :2]) < np.array(gel.bounds_m[1][:2])).all()
        assert depth.max() <= {"ball": 1.5e-3, "torus": 1.0e-3}[one.indenter] + 1e-9
        assert depth[[0, -1]].max() < 0.0


def test_a_command_that_fails_to_record_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stamp_ns = 1_000_000_000 * np.arange(3)
    poses = [Site().pose(depth_m) for depth_m in (-0.5e-3, 1.0e-3, 2.0e-3)]
    force_n = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.4], [0.0, 0.0, 1.0]])
    pressed = Trajectory(
        PoseChannel.of(stamp_ns, poses),
        WrenchChannel(stamp_ns, force_n, 0.0 * force_n),
        name="press",
    )
    given = [(pressed, sphere(0.004))]
    write_trajectory(tmp_path / "answers" / "asked_1_press", pressed)
    own, out = write_data_set(tmp_path / "data", given), tmp_path / "report"
    out.mkdir()
    asked = Question(
        "asked_1_press", "sphere", "a press", 17.0, 0.5, {}, [0.0, 1.0], [[0.0] * 6 + [1.0]] * 2
    )
    searched = []

    def find(data_set: DataSet, *, out: Path, next_presses: int, **_: object) -> Findings:
        searched.append([entry.name for entry in data_set.entries])
        if len(data_set.entries) > 1 or not next_presses:
            return Findings(Verdict.NAMED, "Found.")
        remove_made(out, "next")
        write_questions(out, [asked], data_set)
        return Findings(Verdict.SET, "One of two.", questions=(asked,))

    monkeypatch.setattr(ask, "find_gap", find)

    def run(command: str) -> Findings:
        return ask.search_and_ask(
            own.directory,
            command,
            sensor="sensor_a",
            out=out,
            next_presses=1,
            rounds=2,
            announce=said.append,
        )

    def copied(folder: object) -> Path:
        recorder = tmp_path / f"{len(said)}.sh"
        recorder.write_text(f'cp -r {folder}/* "$2"\n', encoding="utf-8")
        return recorder

    said: list[str] = []
    for command, reason in (
        ("false", "ended with status 1, expected 0 and a bag of each trajectory in .*next: mend"),
        ("true", "left no bag that can be used: .*no bag at .*asked_1_press"),
        (f"sh {copied('$1/bags')}", "left no bag that can be used: .*asked_1_press"),
        ("no_such_program", "cannot be run: .*name a program"),
    ):
        with pytest.raises(ValueError, match=reason):
            run(command)
    assert searched == 4 * [["press"]]
    assert run(f"sh {copied(tmp_path / 'answers')}").verdict is Verdict.NAMED
    assert searched[4:] == [["press"], ["press", "asked_1_press"]]
    assert said[-1] == "One of two. Round 1 of 2: asked_1_press"
    # A further call goes on from there, and the measured data stay as they are.
    assert run("false").verdict is Verdict.NAMED
    assert len(read_data_set(own.directory).entries) == 1
    assert sorted(path.name for path in (out / "asked").iterdir()) == [
        "bags",
        "dataset.yaml",
        "indenters",
        "recording.kept",
    ]
    other = write_data_set(tmp_path / "other", given)
    with pytest.raises(ValueError, match=r"goes on from another data set than .*other"):
        ask.search_and_ask(
            other.directory,
            "true",
            sensor="sensor_a",
            out=out,
            next_presses=1,
            rounds=1,
            announce=said.append,
        )
