# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A ball that is moved over the sensor: press to a force, or follow a path by touch.

The action is the ball's velocity in the sensor's frame, three numbers from -1 to 1 of the largest
speed. The ball does not turn.
"""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.control.environments.observation import TouchView
from dotsim_ros.control.policy.paths import contact_with, reference_path
from dotsim_ros.gel.implicit.gel import PressTooDeepError
from dotsim_ros.gel.make import GelFrame
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.sensor import GelFailureError
from dotsim_ros.specification import SensorSpecification, SolverSpecification

FRAME_S = 0.04
LARGEST_SPEED_M_S = 0.008
BALL_RADIUS_M = 0.004
ROUNDING = 1e-6
"""By which an action may be larger than 1."""


def frame_count(duration_s: float) -> int:
    """Return the frames of an episode.

    Raises:
        ValueError: the duration is not finite, or less than a frame.
    """
    if not FRAME_S <= duration_s < np.inf:
        raise ValueError(f"duration_s is {duration_s}, expected at least {FRAME_S} s, a frame")
    return round(duration_s / FRAME_S)


def check_force(force_n: float) -> None:
    """Raise ValueError where no ball presses to a force."""
    if not 0.0 < force_n < 10.0:
        raise ValueError(f"force_n is {force_n}, expected more than 0 and less than 10 N")


class BallEnvironment(gymnasium.Env[NDArray[Any], NDArray[np.float32]]):
    """What pressing and following have in common.

    Args:
        observation, image_size_px, sensor, solver: as for `TouchView`.
        render_mode: "rgb_array" for the tactile image, or None.

    Raises:
        ValueError: an observation or size that there is not, or an episode without a frame.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 25}  # noqa: RUF012

    def __init__(
        self,
        *,
        observation: str = "image",
        image_size_px: tuple[int, int] = (64, 64),
        duration_s: float = 4.0,
        sensor: str | Path | SensorSpecification = "densetact2",
        solver: SolverSpecification | None = None,
        render_mode: str | None = None,
    ) -> None:
        self._view = TouchView(
            sensor,
            solver,
            observation,
            image_size_px,
            indenter={"kind": "sphere", "radius_m": BALL_RADIUS_M},
        )
        self.sensor, self.observation_space = self._view.sensor, self._view.space
        self.render_mode = render_mode
        self.contact = contact_with(self.sensor.specification.gel, BALL_RADIUS_M)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)
        self._largest_count = frame_count(duration_s)
        self._count = 0
        self.position_m = np.zeros(3)
        self.gel: GelFrame | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        super().reset(seed=seed)
        self.sensor.reset()
        self._count = 0
        self.position_m = self._start()
        self.gel = self.sensor.press(Pose(self.position_m), FRAME_S)
        return self._seen(), self._info()

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        """Move for one frame.

        Raises:
            ValueError: not three numbers from -1 to 1; nothing has moved.
            gymnasium.error.ResetNeeded: `reset` was not called.
        """
        try:
            given = np.asarray(action, dtype=np.float64)
        except (TypeError, ValueError):
            given = np.full(3, np.nan)
        # Written so that a number that is not one is refused.
        if given.shape != (3,) or not np.all(np.abs(given) <= 1.0 + ROUNDING):
            raise ValueError(
                f"action is {action!r}, expected three finite numbers from -1 to 1; the ball has "
                "not moved. gymnasium.wrappers.ClipAction cuts what a policy asks for"
            )
        if self.gel is None:
            raise gymnasium.error.ResetNeeded("call reset before step")
        before = self.position_m
        self.position_m = before + np.clip(given, -1.0, 1.0) * LARGEST_SPEED_M_S * FRAME_S
        self._count += 1
        late = self._count >= self._largest_count
        try:
            self.gel = self.sensor.press(Pose(self.position_m), FRAME_S)
        except (PressTooDeepError, GelFailureError) as error:
            self.position_m = before
            return self._seen(), -1.0, False, True, self._info() | {"reason": str(error)}
        reward, ended = self._judged(before)
        return self._seen(), reward, ended, late, self._info()

    def render(self) -> NDArray[Any] | None:
        """Return the tactile image (H, W, 3) where the mode is "rgb_array"."""
        if self.render_mode is None or self.gel is None:
            return None
        return self._view.see(self.gel, "image")

    def _seen(self) -> NDArray[Any]:
        assert self.gel is not None
        return self._view.see(self.gel)

    def force_n(self) -> float:
        """Return the size of the gel's force."""
        assert self.gel is not None
        return float(np.linalg.norm(self.gel.wrench.force_n))

    @abstractmethod
    def _start(self) -> FloatArray:
        """Return where the ball is at first (3,)."""

    @abstractmethod
    def _judged(self, before_m: FloatArray) -> tuple[float, bool]:
        """Return the reward of the move from a place (3,), and whether the episode ends."""

    @abstractmethod
    def _info(self) -> dict[str, Any]:
        """Return what is told next to the observation."""


class PressEnvironment(BallEnvironment):
    """`DenseTactPress-v0`: press until the gel answers with a force, and keep it.

    The reward is how much closer the force came, as a share of what is asked, and 1 at the end. An
    episode ends once the force was within a tenth of what is asked for `HELD_COUNT` frames.
    """

    HELD_COUNT = 6
    TOLERANCE = 0.1

    def __init__(self, *, force_n: float = 1.0, **others: Any) -> None:
        check_force(force_n)
        super().__init__(**others)
        self.target_n = force_n
        self._held = 0
        self._missed_n = force_n

    def _start(self) -> FloatArray:
        self._held, self._missed_n = 0, self.target_n
        tilt = self.np_random.uniform(-0.3, 0.3, 2)
        return self.contact.position_m(tilt, -0.5e-3)

    def _judged(self, before_m: FloatArray) -> tuple[float, bool]:
        missed_n = abs(self.force_n() - self.target_n)
        reward = (self._missed_n - missed_n) / self.target_n
        self._missed_n = missed_n
        is_close = missed_n < self.TOLERANCE * self.target_n
        self._held = self._held + 1 if is_close else 0
        ended = self._held >= self.HELD_COUNT
        return reward + (1.0 if ended else 0.0), ended

    def _info(self) -> dict[str, Any]:
        return {"force_n": self.force_n(), "is_success": self._held >= self.HELD_COUNT}


class FollowEnvironment(BallEnvironment):
    """`DenseTactFollow-v0`: go along a path on the skin, which touch alone tells.

    The reward is how far the ball came along, in frames of the path's own speed, less its distance
    from the path in millimetres. An episode ends at `FARTHEST_M` from it.

    Args:
        path: one of `paths.PATHS`.

    Raises:
        ValueError: as `BallEnvironment`, no such path, or one that is too deep for the gel.
    """

    FARTHEST_M = 3.0e-3
    START_M = 0.3e-3

    def __init__(self, *, path: str = "figure_eight", **others: Any) -> None:
        super().__init__(**others)
        self.path = reference_path(path, self.contact)
        try:
            for place_m in self.path.position_m[::20]:
                self.sensor.check_depth(Pose(place_m - [0.0, 0.0, self.START_M]))
        except PressTooDeepError as error:
            raise ValueError(
                f"path {path!r} is too deep for the gel of {self.sensor.specification.name!r}: "
                f"{error}"
            ) from error
        self._laps = 0.0

    def _start(self) -> FloatArray:
        self._laps = 0.0
        arc_m = float(self.np_random.uniform(0.0, self.path.length_m))
        return self.path.at(arc_m)[0] + self.np_random.uniform(-self.START_M, self.START_M, 3)

    def _distance_m(self) -> float:
        return float(self.path.nearest(self.position_m)[0])

    def _judged(self, before_m: FloatArray) -> tuple[float, bool]:
        laps = self.path.laps(np.stack([before_m, self.position_m]))
        self._laps += laps
        distance_m = self._distance_m()
        advance = laps * self.path.lap_s / FRAME_S
        return float(advance - 1e3 * distance_m), distance_m > self.FARTHEST_M

    def _info(self) -> dict[str, Any]:
        return {"distance_m": self._distance_m(), "laps": self._laps}
