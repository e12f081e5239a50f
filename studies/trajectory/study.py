# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Paths that a policy follows by touch over ROS topics, on several sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

import matplotlib
from matplotlib.figure import Figure

from dotsim_ros.control.loop.judge import limits_shown
from dotsim_ros.control.loop.recording import LoopRecording
from dotsim_ros.control.loop.report import draw_path
from dotsim_ros.control.policy.network import read_policy
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.files import cache_directory, whole_file
from dotsim_ros.nodes.common.transport import stay_local
from dotsim_ros.nodes.loop.closed_loop import POLICY, ClosedLoop, LoopSetup, policy_name
from dotsim_ros.nodes.tactile_policy.files import policy_folder
from studies.trajectory.trials import (
    SETTINGS,
    Setting,
    SettingName,
    TrialPlan,
    run_trials,
    setting_of,
    trajectory_figures,
)

GRID_PANEL_INCHES = (3.1, 2.3)
DOTS_PER_INCH = 110

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
        run = run_trials(plan, loop, loop.limits, kept)
    name = "closed_loop" if clock == "simulated" else "closed_loop_realtime"
    write_grid(images / f"{name}.png", run.recordings)
    return trajectory_figures(plan, run) | {
        "plan": {"trials": trials, "seconds": seconds, "paths": list(paths)},
        "limits": limits_shown(loop.limits),
        "clock": clock,
    }


class TrialLoop:
    """A closed loop that changes sensor and path as it is asked to; a context manager.

    Args:
        policy: folder of the policy.
        clock: of the loop, see `ClosedLoop`.

    Attributes:
        limits: that the policy's node keeps.
    """

    def __init__(self, policy: Path, *, clock: str) -> None:
        self._policy = policy_name(policy)
        self._clock = clock
        self.limits = LoopSetup(self._policy).limits()
        self._loop: ClosedLoop | None = None
        self._setting: Setting | None = None
        self._path = ""

    def __enter__(self) -> TrialLoop:
        return self

    def __exit__(self, *_exception: object) -> None:
        self._end()

    def __call__(
        self, setting: Setting, path: str, start_m: FloatArray, seconds: float
    ) -> LoopRecording:
        """Return what the loop does; see `studies.trajectory.trials.Loop`."""
        try:
            if self._loop is None or setting != self._setting:
                self._end()
                parameters = {"image_noise_levels": setting.noise_levels}
                if setting.grid_spacing_m is not None:
                    parameters["grid_spacing_m"] = setting.grid_spacing_m
                self._loop = ClosedLoop(
                    LoopSetup(self._policy, sensor=setting.sensor, sensor_parameters=parameters),
                    clock=self._clock,
                )
                self._loop.start(path)
                self._setting, self._path = setting, path
            if path != self._path:
                self._loop.start(path, order=(POLICY,))
                self._path = path
            return self._loop.trial(start_m, seconds)
        except OSError:
            # What does not answer is not asked again.
            self._end()
            raise

    def _end(self) -> None:
        if self._loop is not None:
            with suppress(OSError):
                self._loop.close()
        self._loop, self._setting, self._path = None, None, ""


def write_grid(file: Path, recordings: Mapping[tuple[str, str], Sequence[LoopRecording]]) -> None:
    """Write an image of all paths in all settings, whole or not at all.

    Args:
        file: PNG.
        recordings: by setting and path.
    """
    settings = [name for name in SETTINGS if any(key[0] == name for key in recordings)]
    paths = list(dict.fromkeys(path for _, path in recordings))
    width, height = GRID_PANEL_INCHES
    with matplotlib.rc_context({"font.family": "DejaVu Sans", "font.size": 8.0}):
        figure = Figure(figsize=(width * len(paths), height * len(settings)), layout="constrained")
        panels = figure.subplots(len(settings), len(paths), squeeze=False)
        for row, setting in enumerate(settings):
            for column, path in enumerate(paths):
                axes = panels[row, column]
                draw_path(axes, path, recordings.get((setting, path), ()))
                axes.set_title(f"{path.replace('_', ' ')}, {setting}", fontsize=8.5)
        with whole_file(file) as part:
            figure.savefig(part, dpi=DOTS_PER_INCH)
