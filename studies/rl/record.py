# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A box turned by touch, learnt by reinforcement."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from dotsim_ros.control.environments.reinforcement import PpoSettings
from dotsim_ros.io.files import cache_directory
from dotsim_ros.io.worker_pool.pool import crew
from studies.rl.pictures import write_curve, write_rollout
from studies.rl.study import Study, kept_folder, policy_folder, run_study
from studies.rl.sweep import run_sweep

ROLLOUT_EPISODES = 4


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
    sweep = None
    if tried:
        study, sweep = run_sweep(study, tried, kept, workers=team, tell=print)
    folder = kept_folder(study, kept)
    figures = run_study(study, folder, workers=team, tell=print)
    if sweep is not None:
        figures["sweep"] = sweep
    write_curve(images / "rl_curve.png", figures["learnt"])
    write_rollout(
        images / "rl_rollout.gif",
        study.settings,
        policy_folder(folder, 0),
        study.judged_on()[:ROLLOUT_EPISODES],
    )
    return figures
