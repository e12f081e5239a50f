"""Learning by touch, in small: it runs, goes on where it was, and refuses what it cannot take."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from dotsim_ros.tasks.environments.reinforcement import (
    CHECKPOINT,
    PpoSettings,
    success_share,
    train,
)

SMALL = PpoSettings(
    options={"observation": "depth", "image_size_px": [32, 32]},
    world_count=1,
    rollout=8,
    epochs=1,
    mini_batches=1,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.set_num_threads(1)
    made: Path = tmp_path_factory.mktemp("policy")
    train(SMALL, made, steps=8)
    return made


def test_it_goes_on_where_it_was(folder: Path) -> None:
    before = torch.load(folder / CHECKPOINT, weights_only=True)["network"]
    told: list[str] = []
    progress = train(SMALL, folder, steps=16, tell=told.append)
    after = torch.load(folder / CHECKPOINT, weights_only=True)["network"]
    assert progress.steps == 16
    assert [row[0] for row in progress.curve] == [8, 16]
    assert len(told) == 1
    assert any(not torch.equal(before[name], after[name]) for name in before)
    assert not list(folder.glob("*part*"))


def test_a_policy_is_judged_on_given_seeds(folder: Path) -> None:
    share = success_share(SMALL, folder, [100, 101])
    assert share in (0.0, 0.5, 1.0)
    assert success_share(SMALL, folder, [100, 101]) == share


def test_a_checkpoint_of_other_settings_is_refused(folder: Path) -> None:
    with pytest.raises(ValueError, match="learnt with other settings"):
        train(replace(SMALL, learning_rate=1e-3), folder, steps=24)


def test_a_checkpoint_of_another_version_is_refused(folder: Path, tmp_path: Path) -> None:
    content = torch.load(folder / CHECKPOINT, weights_only=True)
    torch.save(content | {"format": 0}, tmp_path / CHECKPOINT)
    with pytest.raises(ValueError, match="of format 0, expected 2"):
        success_share(SMALL, tmp_path, [0])


def test_a_broken_checkpoint_is_told(tmp_path: Path) -> None:
    (tmp_path / CHECKPOINT).write_bytes(b"no network")
    with pytest.raises(ValueError, match="cannot be read"):
        train(SMALL, tmp_path, steps=8)


def test_a_folder_without_a_policy_is_told(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=CHECKPOINT):
        success_share(SMALL, tmp_path, [0])
