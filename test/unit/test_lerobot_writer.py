# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Data sets in the layout of LeRobot: whole groups only, and read by LeRobot itself."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dotsim_ros.data.lerobot import writer as writing
from dotsim_ros.data.lerobot.writer import LeRobotWriter

for package in ("pyarrow", "av"):
    pytest.importorskip(package, reason="needs the extra dataset: pip install '.[dataset]'")

IMAGE, MARKERS, MASK = "observation.images.gel", "observation.tactile.markers", "mask"
FEATURES: dict[str, dict[str, Any]] = {
    IMAGE: {"dtype": "video", "shape": (48, 64, 3), "names": ["height", "width", "channels"]},
    MARKERS: {"dtype": "float32", "shape": (6, 2)},
    MASK: {"dtype": "bool", "shape": (12, 16)},
    "observation.state": {"dtype": "float32", "shape": (3,), "names": ["x", "y", "z"]},
    "slip": {"dtype": "float32", "shape": (1,)},
}
LENGTHS = (5, 7, 4)


def _episode(number: int) -> dict[str, np.ndarray]:
    random, count = np.random.default_rng(number), LENGTHS[number]
    slope = np.linspace(0, 200, 64)[None, None, :, None] + 10.0 * number
    image = np.broadcast_to(slope, (count, 48, 64, 3)) + 3.0 * np.arange(count)[:, None, None, None]
    return {
        IMAGE: image.clip(0, 255).astype(np.uint8),
        MARKERS: random.normal(size=(count, 6, 2)).astype(np.float32),
        MASK: random.uniform(size=(count, 12, 16)) > 0.5,
        "observation.state": random.normal(size=(count, 3)).astype(np.float32),
        "slip": random.uniform(size=count).astype(np.float32),
    }


def _write(folder: Path, numbers: range = range(len(LENGTHS))) -> None:
    with LeRobotWriter(folder, FEATURES, 25) as made:
        for number in numbers:
            made.add_episode(_episode(number), "press" if number % 2 else "slide")
            made.flush()


def _digests(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.mark.parametrize("ended_at", ["stats.json", "info.json"])
def test_a_writer_that_was_ended_in_a_group_goes_on_to_the_same_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ended_at: str
) -> None:
    _write(tmp_path / "whole")
    broken = tmp_path / "broken"
    _write(broken, range(1))
    real = writing.write_json

    def end(path: Path, content: Mapping[str, Any]) -> None:
        if path.name == ended_at:
            raise KeyboardInterrupt
        real(path, content)

    monkeypatch.setattr(writing, "write_json", end)
    with pytest.raises(KeyboardInterrupt):
        _write(broken, range(1, 2))
    assert json.loads((broken / writing.INFO).read_text())["total_episodes"] == 1
    monkeypatch.undo()
    _write(broken, range(1, len(LENGTHS)))
    assert _digests(broken) == _digests(tmp_path / "whole")


def test_statistics_are_those_of_all_frames(tmp_path: Path) -> None:
    _write(tmp_path)
    found = json.loads((tmp_path / writing.STATISTICS).read_text())
    states = np.concatenate([_episode(k)["observation.state"] for k in range(len(LENGTHS))])
    np.testing.assert_allclose(found["observation.state"]["mean"], states.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(found["observation.state"]["std"], states.std(axis=0), atol=1e-6)
    assert found["observation.state"]["count"] == [sum(LENGTHS)]
    assert np.shape(found[IMAGE]["mean"]) == (3, 1, 1)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"codebase_version": "v2.1"}, "is of the version 'v2.1', expected v3.0"),
        ({"fps": 30}, "other features or another rate"),
    ],
)
def test_another_data_set_is_refused_and_kept(
    tmp_path: Path, change: dict[str, Any], reason: str
) -> None:
    _write(tmp_path, range(1))
    info = tmp_path / writing.INFO
    info.write_text(json.dumps(json.loads(info.read_text()) | change))
    before = _digests(tmp_path)
    with pytest.raises(ValueError, match=reason):
        LeRobotWriter(tmp_path, FEATURES, 25)
    assert _digests(tmp_path) == before


def test_a_wrong_episode_is_not_appended(tmp_path: Path) -> None:
    with LeRobotWriter(tmp_path, FEATURES, 25) as made:
        made.add_episode(_episode(0), "press")
        with pytest.raises(ValueError, match=r"has the shape \(5, 5, 2\), expected \(5, 6, 2\)"):
            made.add_episode(_episode(0) | {MARKERS: np.zeros((5, 5, 2))}, "press")
        with pytest.raises(ValueError, match="expected as many"):
            made.add_episode(_episode(0) | {"slip": np.zeros(4)}, "press")
    assert json.loads((tmp_path / writing.INFO).read_text())["total_episodes"] == 1


def test_lerobot_reads_what_was_written(tmp_path: Path) -> None:
    module = pytest.importorskip(
        "lerobot.datasets.lerobot_dataset", reason="lerobot is not installed"
    )
    _write(tmp_path)
    read = module.LeRobotDataset("local/touches", root=tmp_path)
    assert (len(read), read.num_episodes) == (sum(LENGTHS), len(LENGTHS))
    row = 0
    for number, count in enumerate(LENGTHS):
        episode = _episode(number)
        for frame in range(count):
            item = read[row]
            assert item["task"] == ("press" if number % 2 else "slide")
            for key in FEATURES.keys() - {IMAGE}:
                np.testing.assert_array_equal(item[key].numpy(), episode[key][frame])
            seen = 255.0 * item[IMAGE].numpy().transpose(1, 2, 0)
            assert np.abs(seen - episode[IMAGE][frame]).mean() < 2.0
            row += 1
