# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The evaluation of reinforcement learning, in small: its rows, its pictures, and going on."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from work_here import open_pool_here

from dotsim_ros.control.environments import box_yaw, reinforcement
from dotsim_ros.io.worker_pool import pool
from studies import run
from studies.rl import study, worlds
from studies.rl.study import Study, settings_to_try
from studies.rl.worlds import AS_LEARNT, WORLDS


def evaluate(folder: Path) -> dict[str, Any]:
    given = ["--seeds", "1", "--steps", "8", "--episodes", "1", "--image-size", "16"]
    for tried in (["rollout", "8", "12"], ["epochs", "1"], ["mini_batches", "1"]):
        given += [f"--tried.{tried[0]}", *tried[1:]]
    given += ["--images", f"{folder}/images", "--cache", f"{folder}/kept"]
    assert run.run("rl", given, json_directory=folder)
    found: dict[str, Any] = json.loads((folder / "rl.json").read_text("utf-8"))
    return found


def test_settings_are_tried_and_what_was_learnt_is_not_learnt_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool, "open_worker_pool", open_pool_here)
    monkeypatch.setattr(study, "ROLLOUT_EPISODES", 1)
    # What is seen is scaled by a few moves, where training itself takes no more.
    monkeypatch.setattr(reinforcement, "RANDOM_MOVES", 8)
    # Episodes of a third of a second are played and judged like those of one.
    task = partial(box_yaw.BoxYawTask, duration_s=1.0 / 3.0)
    monkeypatch.setattr(box_yaw, "BoxYawTask", task)
    monkeypatch.setattr(worlds, "BoxYawTask", task)
    # Of the moves that are played blind, two are tried like nine.
    monkeypatch.setattr(study, "MOVES", study.MOVES[:2])
    found = evaluate(tmp_path)
    assert [(row["rollout"], row["steps"]) for row in found["sweep"]] == [(8, 8), (12, 12)]
    best = max(found["sweep"], key=lambda row: row["success"])
    settings = found["study"]["settings"]
    assert settings["rollout"] == best["rollout"]
    assert (settings["epochs"], settings["mini_batches"]) == (1, 1)
    assert set(found["success"]) == set(WORLDS)
    (row,) = found["learnt"]
    # At least one update.
    assert row["steps"] == best["rollout"]
    assert row["success"][AS_LEARNT] in (0.0, 1.0)
    with Image.open(tmp_path / "images" / "rl_rollout.gif") as rollout:
        assert rollout.n_frames > 4
    assert (tmp_path / "images" / "rl_curve.png").stat().st_size > 1000
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "kept").rglob("*.json")}
    assert len(kept) == len(found["sweep"]) + len(WORLDS) + 3
    again = evaluate(tmp_path)
    assert again["learnt"] == found["learnt"]
    assert {path: path.stat().st_mtime_ns for path in kept} == kept


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"speed": [1.0]}, "no setting speed to try"),
        ({"rollout": [1.5]}, "expected whole numbers from 1"),
        ({"discount": [-1.0]}, "expected numbers from 0"),
        ({"discount": []}, "without a value"),
    ],
)
def test_what_cannot_be_tried_is_refused(values: dict[str, list[float]], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        settings_to_try(Study(), values)
