# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tries settings of the training against each other, on episodes that nothing is judged on."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from dotsim_ros.control.environments.reinforcement import PpoSettings, train
from dotsim_ros.io.worker_pool.pool import Crew, open_pool
from studies.rl.study import (
    FIRST_EPISODE,
    Study,
    kept_folder,
    played_episodes,
    policy_folder,
    prepare,
    success,
)
from studies.rl.worlds import AS_LEARNT

SEED = 1_000
"""Of the policies of a sweep, which no study learns again."""
VALIDATION = 2 * FIRST_EPISODE
"""Seed of the first episode that settings are chosen by; policies are judged on others."""
NUMBERS = ("learning_rate", "discount", "entropy_share")
COUNTS = ("rollout", "epochs", "mini_batches")
TRIED = (*NUMBERS, *COUNTS)


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
        tried.append(replace(study.settings, seed=SEED, **changes))
    return tried


def run_sweep(
    study: Study,
    values: Mapping[str, Sequence[float]],
    cache: Path,
    *,
    workers: Crew,
    tell: Callable[[str], None],
) -> tuple[Study, list[dict[str, Any]]]:
    """Learn a policy with each combination of settings, and choose the best by validation.

    Args:
        study: what is asked of each training.
        values: as `settings_to_try`.
        cache: below which a sweep keeps what it has done.
        workers: how many processes, or workers of Ray, each of which learns a policy.
        tell: called with a line about each row.

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
            tell(f"{settings}: {rows[number]['success']}")
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
