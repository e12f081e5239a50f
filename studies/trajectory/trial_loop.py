# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Trials of a policy on one sensor after the other; starts only what must be started again."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from dotsim_ros.control.loop.recording import LoopRecording
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.nodes.loop.closed_loop import POLICY, ClosedLoop, LoopSetup, policy_name
from studies.trajectory.trials import Setting


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
