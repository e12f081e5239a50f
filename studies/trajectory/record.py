# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Paths that a policy follows by touch over ROS topics, on several sensors."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from dotsim_ros.control.loop.judge import limits_shown
from dotsim_ros.control.policy.network import read_policy
from dotsim_ros.io.files import cache_directory
from dotsim_ros.nodes.common.transport import stay_local
from dotsim_ros.nodes.tactile_policy.files import policy_folder
from studies.trajectory.pictures import write_grid
from studies.trajectory.trial_loop import TrialLoop
from studies.trajectory.trials import (
    SETTINGS,
    SettingName,
    TrialPlan,
    run_trials,
    setting_of,
    trajectory_figures,
)

PathName = Literal["line", "arc", "figure_eight", "press"]


def trajectory(
    *,
    policy: str = "densetact2_sphere",
    trials: int = 10,
    paths: tuple[PathName, ...] = ("line", "arc", "figure_eight", "press"),
    settings: tuple[SettingName, ...] = SETTINGS,
    seconds: float = 12.0,
    seed: int = 0,
    clock: Literal["simulated", "realtime"] = "simulated",
    images: Path = Path("docs/images"),
    cache: Path | None = None,
) -> dict[str, Any]:
    """Paths that a policy follows by touch alone, over ROS topics.

    Args:
        policy: folder or name of the policy.
        trials: of each path on each sensor.
        paths: which.
        settings: sensors, which.
        seconds: duration of a trial with its approach.
        seed: of the starts.
        clock: how time passes.
        images: folder of the image.
        cache: folder of the trials run before (the user's cache).

    Raises:
        OSError: a trial could not be run; ValueError: as `TrialPlan`.
    """
    stay_local()
    folder = policy_folder(policy)
    card, _ = read_policy(folder)
    kept = cache or cache_directory() / "trajectory"
    plan = TrialPlan(
        tuple(setting_of(name, kept, trained_on=card.sensor) for name in settings),
        paths,
        trial_count=trials,
        seconds=seconds,
        seed=seed,
        policy=card.weights_sha256,
        clock=clock,
    )
    with TrialLoop(folder, clock=clock) as loop:
        run = run_trials(plan, loop, loop.limits, kept, progress=print)
    name = "closed_loop" if clock == "simulated" else "closed_loop_realtime"
    write_grid(images / f"{name}.png", run.recordings)
    return trajectory_figures(plan, run) | {
        "plan": {"trials": trials, "seconds": seconds, "paths": list(paths)},
        "limits": limits_shown(loop.limits),
        "clock": clock,
    }
