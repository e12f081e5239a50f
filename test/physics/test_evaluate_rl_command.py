"""The evaluation of reinforcement learning, in small: its rows, its pictures, and going on."""

import json
from pathlib import Path

import pytest
from PIL import Image

from dotsim_ros.cli.main import main
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
