# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Learns a policy from each of several seeds, and judges all in worlds that they never saw."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from dotsim_ros.control.environments.box_yaw import MOVES
from dotsim_ros.control.environments.reinforcement import (
    Episode,
    PpoSettings,
    Progress,
    learnt_moves,
    make_world,
    run_episodes,
    train,
)
from dotsim_ros.io.cache import PHYSICS, content_key
from dotsim_ros.io.files import write_json
from dotsim_ros.io.worker_pool.pool import Crew, open_pool
from studies.rl.worlds import AS_LEARNT, WORLDS, options_of

FIRST_EPISODE = 1_000_000
"""Seed of the first episode that policies are judged on; training draws its own below."""
BLIND = "random moves"
BLIND_EPISODES = 40
"""At most, of each kind of blind moves: they mostly play to the end, three times as long."""


@dataclass(frozen=True)
class Study:
    """What is asked.

    Attributes:
        settings: of the training; each policy has another seed.
        seeds: how many policies.
        steps: of each training.
        seconds: limit of the time of each training.
        enough: a training ends where a larger share of its last episodes got there.
        episodes: each policy is judged on in each world.
    """

    settings: PpoSettings = field(default_factory=PpoSettings)
    seeds: int = 5
    steps: int = 8_000
    seconds: float = 3600.0
    enough: float = 0.95
    episodes: int = 100

    def judged_on(self) -> range:
        """Return the seeds of the episodes that policies are judged on."""
        return range(FIRST_EPISODE, FIRST_EPISODE + self.episodes)

    def blind_on(self) -> range:
        """Return the seeds of the episodes that blind moves are judged on, the first of these."""
        return self.judged_on()[:BLIND_EPISODES]


def run_study(
    study: Study, folder: Path, *, workers: Crew, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Return the figures of a study; what is kept of it in `folder` is not done again.

    `success_rate` is that in the world that was learnt in, with its deviation between the seeds;
    `minutes` is what the longest training took, and `steps_per_second` holds for all of them.

    Args:
        study: what is asked.
        folder: its `kept_folder`.
        workers: how many processes, or workers of Ray, each of which learns a policy or plays
            blind moves.
        tell: called with a line about each row.
    """
    jobs: list[tuple[Callable[..., dict[str, Any]], int | str]] = [
        *((learnt_row, seed) for seed in range(study.seeds)),
        *((blind_row, name) for name in (BLIND, *(f"always {k}" for k in range(len(MOVES))))),
    ]
    rows: dict[int | str, dict[str, Any]] = {}
    with open_pool(workers, prepare, writes=(folder,)) as pool:
        running = {pool.submit(job, study, folder, of): of for job, of in jobs}
        for done in as_completed(running):
            row = rows[running[done]] = done.result()
            tell(f"{row['name']}: {row['success']}")
    learnt = [rows[seed] for seed in range(study.seeds)]
    blind = [row for of, row in rows.items() if isinstance(of, str)]
    constant = [row for row in blind if row["name"] != BLIND]
    success_in = {world: _summary([row["success"][world] for row in learnt]) for world in WORLDS}
    return {
        "study": asdict(study),
        "learnt": learnt,
        "blind_episodes": len(study.blind_on()),
        "success_rate": {key: success_in[AS_LEARNT][key] for key in ("mean", "std")},
        "minutes": max(row["minutes"] for row in learnt),
        "steps_per_second": round(
            sum(row["steps"] for row in learnt) / sum(row["seconds"] for row in learnt), 1
        ),
        "success": success_in,
        "random_success": next(row for row in blind if row["name"] == BLIND)["success"][AS_LEARNT],
        "best_single_move": max(constant, key=lambda row: row["success"][AS_LEARNT]),
    }


def learnt_row(study: Study, folder: Path, seed: int) -> dict[str, Any]:
    """Learn the policy of a seed and return how it is judged in each world."""
    settings = replace(study.settings, seed=seed)
    place = policy_folder(folder, seed)
    progress = train(settings, place, steps=study.steps, seconds=study.seconds, enough=study.enough)
    judged = {}
    for world in WORLDS:
        path = place / f"{_file_name(world)}-{study.episodes}.json"
        judged[world] = played_episodes(path, settings, place, world, study.judged_on())
    return {
        "name": f"seed {seed}",
        "success": {world: success(episodes) for world, episodes in judged.items()},
        "frames": _mean_frames(judged[AS_LEARNT]),
        "steps": progress.steps,
        "seconds": progress.seconds,
        "minutes": round(progress.seconds / 60.0, 1),
        "minutes_to_90": minutes_to(progress, 0.9),
        "curve": progress.curve,
    }


def played_episodes(
    path: Path, settings: PpoSettings, place: Path, world: str, seeds: Sequence[int]
) -> list[Episode]:
    """Return how the policy of a folder plays in a world, from a file where it has done so before.

    Args:
        path: of the file.
        settings: that the policy was learnt with.
        place: its folder.
        world: of `WORLDS`.
        seeds: of the episodes.
    """

    def play() -> list[Episode]:
        made = make_world(settings, **options_of(world))
        played = run_episodes(made, learnt_moves(settings, place, made), seeds)
        made.close()
        return played

    return _kept(path, play)


def blind_row(study: Study, folder: Path, name: str) -> dict[str, Any]:
    """Return how moves that see nothing do, in the world that the policies learn in."""
    random = np.random.default_rng(0)

    def move(_seen: Any) -> np.int64:
        if name == BLIND:
            return np.int64(random.integers(len(MOVES)))
        return np.int64(name.rpartition(" ")[2])

    def play() -> list[Episode]:
        world = make_world(study.settings)
        played = run_episodes(world, move, study.blind_on())
        world.close()
        return played

    episodes = _kept(folder / f"{_file_name(name)}-{len(study.blind_on())}.json", play)
    return {
        "name": name,
        "success": {AS_LEARNT: success(episodes)},
        "frames": _mean_frames(episodes),
    }


def kept_folder(study: Study, cache: Path) -> Path:
    """Return where a study keeps what it has done: another place for other code or settings."""
    return cache / content_key(
        (*PHYSICS, "control", "../studies/rl"),
        study.settings,
        study.steps,
        study.seconds,
        study.enough,
    )


def policy_folder(folder: Path, seed: int) -> Path:
    """Return the folder of the policy of a seed, in that of a study."""
    return folder / f"seed_{seed}"


def success(episodes: list[Episode]) -> float:
    """Return the share of episodes that got there."""
    return float(np.mean([episode.is_success for episode in episodes]))


def minutes_to(progress: Progress, share: float) -> float | None:
    """Return when that share of the last fifty episodes of a training had got there, or None.

    The curve's points are taken as equally long.
    """
    for number, (_, reached, _) in enumerate(progress.curve, start=1):
        if reached >= share:
            return round(progress.seconds / 60.0 * number / len(progress.curve), 1)
    return None


def prepare() -> None:
    """Prepare a worker: each has a core of its own."""
    torch.set_num_threads(1)


def _kept(path: Path, play: Callable[[], list[Episode]]) -> list[Episode]:
    """Return the episodes of a file, which is written where it is not there."""
    if not path.is_file():
        write_json(path, {"episodes": [asdict(episode) for episode in play()]})
    return [Episode(**episode) for episode in json.loads(path.read_text("utf-8"))["episodes"]]


def _file_name(name: str) -> str:
    return name.replace(" ", "_")


def _mean_frames(episodes: list[Episode]) -> float:
    return round(float(np.mean([episode.frames for episode in episodes])), 1)


def _summary(shares: list[float]) -> dict[str, float]:
    return {
        "mean": round(float(np.mean(shares)), 4),
        "std": round(float(np.std(shares)), 4),
        "least": min(shares),
    }
