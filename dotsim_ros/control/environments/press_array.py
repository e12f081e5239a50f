# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The task of `PressEnvironment` in many worlds at once, on `TactileArray`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from dotsim_ros.control.environments.ball import (
    BALL_RADIUS_M,
    FRAME_S,
    LARGEST_SPEED_M_S,
    ROUNDING,
    PressEnvironment,
    check_force,
    frame_count,
)
from dotsim_ros.control.environments.observation import depth_space
from dotsim_ros.control.policy.paths import contact_with
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.io.arrays import BoolArray, FloatArray
from dotsim_ros.specification import SensorSpecification, given_sensor
from dotsim_ros.tactile_array import ArrayFrame, TactileArray

_Step = tuple[NDArray[np.float32], FloatArray, BoolArray, BoolArray, dict[str, Any]]


class PressArray(
    gymnasium.vector.VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]
):
    """Balls that press until the gel answers with a force, and keep it.

    Action, reward and end of an episode are those of `PressEnvironment`, and the observation is its
    `depth`: (B, height, width, 4) range in m and normal, zero where no skin is seen. A world whose
    episode has ended begins another at the next step, whatever its action.

    Args:
        count: worlds.
        force_n: to press to.
        image_size_px: width and height.
        duration_s: of an episode at most.
        sensor: a name below `params/sensors`, a YAML file, or a specification; its gel is solved as
            it says.
        device: torch's name of the device.

    Raises:
        ValueError: a force or duration out of range, or as `TactileArray`.
    """

    metadata = {"autoreset_mode": gymnasium.vector.AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        count: int,
        *,
        force_n: float = 1.0,
        image_size_px: tuple[int, int] = (64, 64),
        duration_s: float = 4.0,
        sensor: str | Path | SensorSpecification = "densetact2",
        device: str = "cpu",
    ) -> None:
        check_force(force_n)
        self._largest_count = frame_count(duration_s)
        specification = given_sensor(sensor)
        ball = load_indenter({"kind": "sphere", "radius_m": BALL_RADIUS_M})
        self.array = TactileArray(
            specification, count, ball, image_size=image_size_px, device=device
        )
        self.num_envs, self.target_n = count, force_n
        self._contact = contact_with(specification.gel, BALL_RADIUS_M)
        self.single_observation_space = depth_space(image_size_px)
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, count)
        self.action_space = batch_space(self.single_action_space, count)
        self._quaternion = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
        self._random: list[np.random.Generator] = []
        self._has_ended = np.zeros(count, dtype=bool)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode in every world; world k has the seed plus k, or the k-th of a list."""
        count = self.num_envs
        if seed is not None or not self._random:
            seeds: list[int | None] = [None] * count
            if isinstance(seed, list):
                seeds = seed
            elif seed is not None:
                seeds = [seed + k for k in range(count)]
            self._random = [gymnasium.utils.seeding.np_random(one)[0] for one in seeds]
        self.array.reset()
        self._position_m, self._missed_n = np.zeros((count, 3)), np.zeros(count)
        self._count, self._held = np.zeros(count, dtype=int), np.zeros(count, dtype=int)
        self._begin(np.ones(count, dtype=bool))
        return self._seen(self._moved()), self._info()

    def step(self, actions: NDArray[np.float32]) -> _Step:
        """Move every ball for one frame.

        Raises:
            ValueError: not three numbers from -1 to 1 for each; nothing has moved.
            gymnasium.error.ResetNeeded: `reset` was not called.
        """
        given = np.asarray(actions, dtype=np.float64)
        # Written so that a number that is not one is refused.
        if given.shape != (self.num_envs, 3) or not np.all(np.abs(given) <= 1.0 + ROUNDING):
            raise ValueError(
                f"actions are of the shape {given.shape}, expected ({self.num_envs}, 3) finite "
                "numbers from -1 to 1; no ball has moved"
            )
        if not self._random:
            raise gymnasium.error.ResetNeeded("call reset before step")
        begins = self._has_ended
        before_m = self._position_m
        self._position_m = before_m + np.clip(given, -1.0, 1.0) * LARGEST_SPEED_M_S * FRAME_S
        self._count = self._count + 1
        self._begin(begins)
        frame = self._moved()
        is_valid = frame.is_valid.cpu().numpy()
        missed_n = np.abs(self._force_n - self.target_n)
        is_close = missed_n < PressEnvironment.TOLERANCE * self.target_n
        reward = (self._missed_n - missed_n) / self.target_n
        # A press that the gel does not take ends the episode, with the ball where it was.
        refused = ~is_valid & ~begins
        self._position_m = np.where(refused[:, None], before_m, self._position_m)
        self._held = np.where(is_close & ~begins & ~refused, self._held + 1, 0)
        self._missed_n = np.where(begins, self.target_n, missed_n)
        terminated = self._held >= PressEnvironment.HELD_COUNT
        reward = np.where(begins, 0.0, np.where(refused, -1.0, reward + terminated))
        truncated = refused | (self._count >= self._largest_count)
        self._has_ended = terminated | truncated
        return self._seen(frame), reward, terminated, truncated, self._info()

    def _begin(self, worlds: BoolArray) -> None:
        """Put the balls of some worlds (B,) where an episode begins."""
        for k in np.flatnonzero(worlds):
            tilt = self._random[k].uniform(-0.3, 0.3, 2)
            self._position_m[k] = self._contact.position_m(tilt, -0.5e-3)
        self._count[worlds], self._held[worlds] = 0, 0
        self._missed_n[worlds] = self.target_n
        self._has_ended = np.zeros(self.num_envs, dtype=bool)

    def _moved(self) -> ArrayFrame:
        frame = self.array.step(self._position_m, self._quaternion)
        self._force_n = frame.force_n.norm(dim=1).cpu().numpy().astype(np.float64)
        return frame

    def _seen(self, frame: ArrayFrame) -> NDArray[np.float32]:
        seen = torch.cat([frame.depth_m[..., None], frame.normal], dim=-1)
        result: NDArray[np.float32] = seen.nan_to_num(nan=0.0).clamp(-1.0, 1.0).cpu().numpy()
        return result

    def _info(self) -> dict[str, Any]:
        every = np.ones(self.num_envs, dtype=bool)
        return {
            "force_n": self._force_n,
            "_force_n": every,
            "is_success": self._held >= PressEnvironment.HELD_COUNT,
            "_is_success": every,
        }
