# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Learning by touch, in small: it runs, goes on where it was, and refuses what it cannot take."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import gymnasium
import pytest
import torch

from dotsim_ros.control.environments import reinforcement
from dotsim_ros.control.environments.box_yaw import BoxYawTask
from dotsim_ros.control.environments.reinforcement import (
    CHECKPOINT,
    FORMAT,
    PpoSettings,
    SeenScaler,
    learnt_moves,
    make_world,
    success_share,
    train,
)

SMALL = PpoSettings(
    options={"observation": "depth", "image_size_px": [16, 16]},
    world_count=1,
    rollout=8,
    epochs=1,
    mini_batches=1,
)


@pytest.fixture(scope="module", autouse=True)
def few_random_moves() -> Iterator[None]:
    """Scale what is seen by a few moves, where training itself takes no more."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reinforcement, "RANDOM_MOVES", 8)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.set_num_threads(1)
    made: Path = tmp_path_factory.mktemp("policy")
    train(SMALL, made, steps=8)
    return made


def test_a_training_that_was_broken_off_goes_on(folder: Path) -> None:
    before = torch.load(folder / CHECKPOINT, weights_only=True)["network"]
    told: list[str] = []

    def break_off(line: str) -> None:
        told.append(line)
        if len(told) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(SMALL, folder, steps=10**6, tell=break_off)
    after = torch.load(folder / CHECKPOINT, weights_only=True)
    assert any(not torch.equal(before[name], after["network"][name]) for name in before)
    assert json.loads(after["progress"])["steps"] == 24
    progress = train(SMALL, folder, steps=32, tell=told.append)
    assert [row[0] for row in progress.curve] == [8, 16, 24, 32]
    assert len(told) == 3
    assert not list(folder.glob("*part*"))


def test_a_policy_is_judged_on_given_seeds(folder: Path) -> None:
    # In a third of a second an episode ends like one of a second.
    task = BoxYawTask(duration_s=1.0 / 3.0)
    share = success_share(SMALL, folder, [100, 101], task=task)
    assert share in (0.0, 0.5, 1.0)
    assert success_share(SMALL, folder, [100, 101], task=task) == share


def test_a_checkpoint_of_another_training_is_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="learnt with other settings"):
        train(replace(SMALL, learning_rate=1e-3), folder, steps=40)
    with pytest.raises(FileNotFoundError, match=CHECKPOINT):
        success_share(SMALL, tmp_path, [0])
    content = torch.load(folder / CHECKPOINT, weights_only=True)
    torch.save(content | {"format": 0}, tmp_path / CHECKPOINT)
    with pytest.raises(ValueError, match=f"of format 0, expected {FORMAT}"):
        success_share(SMALL, tmp_path, [0])
    (tmp_path / CHECKPOINT).write_bytes(b"no network")
    with pytest.raises(ValueError, match="cannot be read"):
        train(SMALL, tmp_path, steps=8)


def test_the_policy_that_got_there_most_often_is_judged(folder: Path, tmp_path: Path) -> None:
    content = torch.load(folder / CHECKPOINT, weights_only=True)
    best = {name: torch.zeros_like(values) for name, values in content["best"].items()}
    best["policy_head.bias"][5] = 1.0
    torch.save(content | {"best": best}, tmp_path / CHECKPOINT)
    world = make_world(SMALL)
    move = learnt_moves(SMALL, tmp_path, world)
    seen, _ = world.reset(seed=100)
    world.close()
    assert move(seen) == 5


def test_what_is_seen_is_scaled_by_pixel_and_channel() -> None:
    space = gymnasium.spaces.Box(-1.0, 1.0, (2, 2, 3))
    random = torch.Generator().manual_seed(0)
    seen = torch.randn(500, 12, generator=random) * torch.tensor([0.1, 3.0, 0.0]).repeat(4) + 7.0
    scaler = SeenScaler(space, device="cpu")
    scaler.learn(seen)
    scaled = scaler(seen)
    assert torch.allclose(scaled.mean(dim=0), torch.zeros(12), atol=1e-4)
    channels = scaled.reshape(-1, 3)
    assert torch.allclose(channels[:, :2].std(dim=0), torch.ones(2), atol=1e-2)
    assert not channels[:, 2].any()
