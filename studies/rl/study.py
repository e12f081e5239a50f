# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Learns a policy from each of several seeds, and judges all in worlds that they never saw."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

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
from dotsim_ros.io.files import cache_directory, write_json
from dotsim_ros.io.worker_pool.pool import Crew, crew, open_pool
from studies.rl.pictures import write_curve, write_rollout
from studies.rl.worlds import AS_LEARNT, WORLDS, options_of

FIRST_EPISODE = 1_000_000
"""Seed of the first episode that policies are judged on; training draws its own below."""
BLIND = "random moves"
BLIND_EPISODES = 40
"""At most, of each kind of blind moves: they mostly play to the end, three times as long."""


ROLLOUT_EPISODES = 4
SWEEP_SEED = 1_000
"""Of the policies of a sweep, which no study learns again."""
VALIDATION = 2 * FIRST_EPISODE
"""Seed of the first episode that settings are chosen by; policies are judged on others."""
NUMBERS = ("learning_rate", "discount", "entropy_share")
COUNTS = ("rollout", "epochs", "mini_batches")
TRIED = (*NUMBERS, *COUNTS)


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


def rl(
    *,
    seeds: int = 5,
    steps: int = 8_000,
    minutes: float = 60.0,
    episodes: int = 100,
    observation: Literal["depth", "image"] = "depth",
    image_size: int = 32,
    tried: dict[str, list[float]] | None = None,
    workers: int = 1,
    ray_address: str | None = None,
    images: Path = Path("docs/images"),
    cache: Path | None = None,
) -> dict[str, Any]:
    """A box turned by touch, learnt with PPO and judged in worlds that were never seen.

    Args:
        seeds: policies learnt.
        steps: of the world, for each policy.
        minutes: limit of each training.
        episodes: each policy is judged on.
        observation: what policies see.
        image_size: width and height of the image, pixels.
        tried: values of settings (`--tried.rollout 64 128`), each combination of which is learnt
            with once first; what does best on episodes that nothing else is judged on is kept.
        workers: processes, or workers of the Ray cluster, at most.
        ray_address: HOST:PORT of the head of a Ray cluster, auto or local (none).
        images: folder of the pictures.
        cache: folder of what was learnt before (the user's cache).

    Returns:
        Among others `success_rate`, that in the world that was learnt in, with its deviation
        between the seeds; `minutes`, what the longest training took; `steps_per_second`, which
        holds for all of them.

    Raises:
        ValueError: as `settings_to_try`.
    """
    size = [image_size] * 2
    study = Study(
        PpoSettings(options={"observation": observation, "image_size_px": size}),
        seeds=seeds,
        steps=steps,
        seconds=60.0 * minutes,
        episodes=episodes,
    )
    kept, team = cache or cache_directory() / "rl", crew(workers, ray_address)
    swept: dict[str, Any] = {}
    if tried:
        study, swept["sweep"] = run_sweep(study, tried, kept, team)
    folder = kept_folder(study, kept)
    rows = _rows(study, folder, team)
    learnt = [rows[seed] for seed in range(seeds)]
    blind = [row for of, row in rows.items() if isinstance(of, str)]
    constant = [row for row in blind if row["name"] != BLIND]
    success_in = {world: _summary([row["success"][world] for row in learnt]) for world in WORLDS}
    write_curve(images / "rl_curve.png", learnt)
    shown = study.judged_on()[:ROLLOUT_EPISODES]
    write_rollout(images / "rl_rollout.gif", study.settings, policy_folder(folder, 0), shown)
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
        "random_success": rows[BLIND]["success"][AS_LEARNT],
        "best_single_move": max(constant, key=lambda row: row["success"][AS_LEARNT]),
        **swept,
    }


def _rows(study: Study, folder: Path, workers: Crew) -> dict[int | str, dict[str, Any]]:
    """Return the rows of the policies by seed and of blind moves by name; what is kept of them in a
    folder is not done again."""
    jobs: list[tuple[Callable[..., dict[str, Any]], int | str]] = [
        *((learnt_row, seed) for seed in range(study.seeds)),
        *((blind_row, name) for name in (BLIND, *(f"always {k}" for k in range(len(MOVES))))),
    ]
    rows: dict[int | str, dict[str, Any]] = {}
    with open_pool(workers, prepare, writes=(folder,)) as pool:
        running = {pool.submit(job, study, folder, of): of for job, of in jobs}
        for done in as_completed(running):
            row = rows[running[done]] = done.result()
            print(f"{row['name']}: {row['success']}")
    return rows


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


def settings_to_try(study: Study, values: Mapping[str, Sequence[float]]) -> list[PpoSettings]:
    """Return the settings of a study with every combination of values, all of one seed.

    Args:
        study: the settings that nothing else is said of.
        values: by the name of the setting, of `TRIED`.

    Raises:
        ValueError: another name, no value, or one that is out of range.
    """
    for name, given in values.items():
        if name not in TRIED:
            raise ValueError(f"no setting {name} to try; known are {', '.join(TRIED)}")
        is_count = name in COUNTS
        least = 1.0 if is_count else 0.0
        wrong = [v for v in given if not least <= v < float("inf") or (is_count and v % 1)]
        if wrong or not given:
            raise ValueError(
                f"{name} is {', '.join(map(str, wrong)) or 'without a value'}, expected "
                f"{'whole numbers from 1' if is_count else 'numbers from 0'}"
            )
    tried = []
    for chosen in itertools.product(*values.values()):
        changes: dict[str, Any] = {
            name: int(value) if name in COUNTS else float(value)
            for name, value in zip(values, chosen, strict=True)
        }
        tried.append(replace(study.settings, seed=SWEEP_SEED, **changes))
    return tried


def run_sweep(
    study: Study,
    values: Mapping[str, Sequence[float]],
    cache: Path,
    workers: Crew,
) -> tuple[Study, list[dict[str, Any]]]:
    """Learn a policy with each combination of settings, and choose the best by validation.

    Args:
        study: what is asked of each training.
        values: as `settings_to_try`.
        cache: below which a sweep keeps what it has done.
        workers: how many processes, or workers of Ray, each of which learns a policy.

    Returns:
        The study with the settings that got there most often, the first of several, and the rows
        in the order of the combinations: the settings tried, `success` on the validation's
        episodes, `steps`.

    Raises:
        ValueError: as `settings_to_try`.
    """
    tried = settings_to_try(study, values)
    rows: list[dict[str, Any]] = [{} for _ in tried]
    with open_pool(workers, prepare, writes=(cache,)) as pool:
        running = {
            pool.submit(swept_row, study, cache, settings): number
            for number, settings in enumerate(tried)
        }
        for done in as_completed(running):
            number = running[done]
            settings = {name: asdict(tried[number])[name] for name in values}
            rows[number] = settings | done.result()
            print(f"{settings}: {rows[number]['success']}")
    best = max(range(len(tried)), key=lambda number: (rows[number]["success"], -number))
    return replace(study, settings=replace(tried[best], seed=study.settings.seed)), rows


def swept_row(study: Study, cache: Path, settings: PpoSettings) -> dict[str, Any]:
    """Learn with settings and return how often the policy gets there on validation's episodes."""
    place = policy_folder(kept_folder(replace(study, settings=settings), cache), settings.seed)
    progress = train(settings, place, steps=study.steps, seconds=study.seconds, enough=study.enough)
    seeds = range(VALIDATION, VALIDATION + study.episodes)
    episodes = played_episodes(
        place / f"validation-{study.episodes}.json", settings, place, AS_LEARNT, seeds
    )
    return {"success": success(episodes), "steps": progress.steps}
