"""The evaluation of reinforcement learning, in small: its rows, its pictures, and going on."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from dotsim_ros.cli.main import main
from dotsim_ros.evaluation.rl.study import FIRST_EPISODE, Study
from dotsim_ros.evaluation.rl.sweep import VALIDATION, run_sweep, settings_to_try
from dotsim_ros.evaluation.rl.worlds import AS_LEARNT, WORLDS
from dotsim_ros.tasks.environments.reinforcement import PpoSettings


def evaluate(folder: Path) -> dict[str, object]:
    given = ["evaluate", "rl", "--seeds", "1", "--steps", "96", "--episodes", "1"]
    places = ["--out", f"{folder}/out", "--images", f"{folder}/images", "--cache", f"{folder}/kept"]
    assert main([*given, *places, "--image-size", "16", "--workers", "2"]) == 0
    found: dict[str, object] = json.loads((folder / "out" / "rl.json").read_text("utf-8"))
    return found


def test_a_study_is_printed_kept_and_not_done_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = evaluate(tmp_path)
    page = capsys.readouterr().out
    assert (tmp_path / "out" / "rl.md").read_text("utf-8") in page
    assert set(found["success"]) == set(WORLDS)  # type: ignore[call-overload]
    (row,) = found["learnt"]  # type: ignore[misc]
    # At least one update.
    assert row["steps"] == PpoSettings().rollout
    assert row["success"][AS_LEARNT] in (0.0, 1.0)
    for name in WORLDS:
        assert f"PPO, {name}" in page
    with Image.open(tmp_path / "images" / "rl_rollout.gif") as rollout:
        assert rollout.n_frames > 4
    assert (tmp_path / "images" / "rl_curve.png").stat().st_size > 1000
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "kept").rglob("*.json")}
    assert len(kept) == len(WORLDS) + 10
    again = evaluate(tmp_path)
    assert again["learnt"] == found["learnt"]
    assert {path: path.stat().st_mtime_ns for path in kept} == kept


def test_settings_are_tried_and_the_best_go_on(tmp_path: Path) -> None:
    settings = PpoSettings(
        options={"observation": "depth", "image_size_px": [16, 16]}, epochs=1, mini_batches=1
    )
    asked = Study(settings, steps=16, episodes=1)
    values = {"rollout": [16.0, 24.0], "learning_rate": [1e-9]}
    study, rows = run_sweep(asked, values, tmp_path, workers=2, tell=lambda _line: None)
    assert [(row["rollout"], row["steps"]) for row in rows] == [(16, 16), (24, 24)]
    best = max(rows, key=lambda row: row["success"])
    assert study == replace(
        asked, settings=replace(settings, rollout=best["rollout"], learning_rate=1e-9)
    )


def test_settings_that_are_tried_are_not_those_of_a_judged_policy() -> None:
    tried = settings_to_try(Study(), {"rollout": [16], "discount": [0.9, 0.99]})
    assert [(one.rollout, one.discount) for one in tried] == [(16, 0.9), (16, 0.99)]
    assert {one.seed for one in tried}.isdisjoint(range(Study().seeds))
    assert VALIDATION not in Study(episodes=VALIDATION - FIRST_EPISODE).judged_on()


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (["speed", "1"], "no setting speed to try"),
        (["rollout", "1.5"], "expected whole numbers from 1"),
        (["discount", "-1"], "expected numbers from 0"),
        (["discount"], "without a value"),
        (["discount", "much"], "expected numbers"),
    ],
)
def test_what_cannot_be_tried_is_told(
    given: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", "rl", "--try", *given]) == 1
    assert told in capsys.readouterr().err
