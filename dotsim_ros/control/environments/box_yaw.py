# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Turn a box on a table to a yaw angle by touch: the paper's task of reinforcement learning.

Paper, section IV-D: the sensor presses on the box from above, nine planar moves, one second at 24
frames/s, a target of 10 degrees and success below 2. A pin through its centre keeps the box where
it is: a gel that only moves in the plane carries a free box along without turning it, since the box
is pressed onto the table right below the contact.

The sensor comes down across one of two opposite edges of the box, drawn by lot. Which way turns the
box to its target depends on the edge, and only touch tells which it is: no single move, and no
sequence of moves chosen beforehand, serves more than half of the episodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.control.environments.coupling import MujocoCoupling
from dotsim_ros.control.environments.observation import TouchView
from dotsim_ros.gel.implicit.gel import PressTooDeepError
from dotsim_ros.gel.make import GelFrame
from dotsim_ros.sensor import GelFailureError
from dotsim_ros.specification import SensorSpecification, SolverSpecification

FRAME_RATE_HZ = 24.0
STEPS_A_FRAME = 20
"""Of MuJoCo: with half as many, one episode in twenty had a box thrown around by the gel, six times
as many as with these; twice as many change nothing."""
LOWERING_STEPS = 3
"""In which the sensor comes down, as a robot would."""
PAD_STEPS_A_FRAME, PAD_LOWERING_STEPS = 400, 12
"""The same for a pad, which is some twenty times as stiff."""
LARGEST_PROGRESS = 1.0
"""Of the reward in a frame, as a share of the way to the target."""
MOVES = np.array(
    [(0, 0), (-1, 0), (1, 0), (0, 1), (0, -1), (-1, 1), (1, 1), (-1, -1), (1, -1)], dtype=float
)
"""Stay, left, right, up, down, and the four between them."""
WORLD = """
<mujoco>
  <option timestep="{step_s}" integrator="implicitfast" cone="elliptic"/>
  <worldbody>
    <geom name="table" type="plane" size="0.2 0.2 0.01" friction="{friction} 0.001 0.0001"/>
    <body name="box" pos="0 0 {half_height}">
      <freejoint name="box"/>
      <geom name="box" type="box" size="{half_width} {half_width} {half_height}" mass="{mass}"
            friction="{friction} 0.001 0.0001"/>
    </body>
    <body name="sensor" mocap="true" quat="0 1 0 0"/>
  </worldbody>
  <equality><connect body1="box" body2="world" anchor="0 0 0"/></equality>
</mujoco>
"""


@dataclass(frozen=True)
class BoxYawTask:
    """What is asked, and of what.

    Attributes:
        target_rad, tolerance_rad: the yaw to reach, and how close counts as there.
        speed_m_s: of a move along one axis.
        half_width_m, half_height_m, mass_kg: of the box.
        friction: of box and table.
        inside_m: how far inside the edge the sensor comes down.
        spread_m: largest distance along the edge from its middle, to either side.
        depth_m: least and largest of the press.
        start_rad: largest yaw at the start, to either side.
        idle_penalty: for staying while the box is not there.
        lost_rad: an error of the yaw at which an episode is given up.
    """

    target_rad: float = float(np.deg2rad(10.0))
    tolerance_rad: float = float(np.deg2rad(2.0))
    duration_s: float = 1.0
    speed_m_s: float = 0.012
    half_width_m: float = 0.015
    half_height_m: float = 0.008
    mass_kg: float = 0.05
    friction: float = 0.2
    inside_m: float = 0.002
    spread_m: float = 0.003
    depth_m: tuple[float, float] = (0.8e-3, 1.2e-3)
    start_rad: float = float(np.deg2rad(3.0))
    idle_penalty: float = 0.05
    lost_rad: float = float(np.deg2rad(30.0))


class BoxYawEnvironment(gymnasium.Env[NDArray[Any], np.int64]):
    """`DenseTactBoxYaw-v0`.

    Args:
        observation, image_size_px, sensor, solver: as for `TouchView`.
        render_mode: "rgb_array" for the tactile image, or None.

    `info` has the yaw in degrees and whether it is there. An episode that cannot be won any more,
    since the box was pushed through the gel, is not touched any more or was turned too far, is
    truncated and `info["reason"]` says why.

    Raises:
        ValueError: as `TouchView`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": int(FRAME_RATE_HZ)}  # noqa: RUF012

    def __init__(
        self,
        *,
        observation: str = "image",
        image_size_px: tuple[int, int] = (64, 64),
        task: BoxYawTask | None = None,
        sensor: str | Path | SensorSpecification = "densetact2",
        solver: SolverSpecification | None = None,
        render_mode: str | None = None,
    ) -> None:
        self._view = TouchView(sensor, solver, observation, image_size_px)
        self.sensor, self.observation_space = self._view.sensor, self._view.space
        self.render_mode = render_mode
        self.task = BoxYawTask() if task is None else task
        is_dome = self.sensor.specification.gel.shape == "dome"
        self._lowering_steps = LOWERING_STEPS if is_dome else PAD_LOWERING_STEPS
        step_s = 1.0 / FRAME_RATE_HZ / (STEPS_A_FRAME if is_dome else PAD_STEPS_A_FRAME)
        text = WORLD.format(
            step_s=step_s,
            friction=self.task.friction,
            half_width=self.task.half_width_m,
            half_height=self.task.half_height_m,
            mass=self.task.mass_kg,
        )
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)
        self.action_space = gymnasium.spaces.Discrete(len(MOVES))
        self._coupling: MujocoCoupling | None = None
        self._gel: GelFrame | None = None
        self._count = 0

    @property
    def yaw_rad(self) -> float:
        """Yaw of the box, rad."""
        w, x, y, z = self.data.qpos[3:7]
        return float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))

    def _error_rad(self) -> float:
        return abs(self.yaw_rad - self.task.target_rad)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        super().reset(seed=seed)
        task, random = self.task, self.np_random
        mujoco.mj_resetData(self.model, self.data)
        yaw = float(random.uniform(-task.start_rad, task.start_rad))
        self.data.qpos[3:7] = (np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw))
        side = float(random.choice([-1.0, 1.0]))
        along_m = float(random.uniform(-task.spread_m, task.spread_m))
        depth_m = float(random.uniform(*task.depth_m))
        # The sensor hangs from its base, apex down.
        height_m = 2.0 * task.half_height_m + float(self.sensor.skin.apex_m[2])
        across_m = side * (task.half_width_m - task.inside_m)
        turned = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        self.data.mocap_pos[0, :2] = turned @ (across_m, along_m)
        self.data.mocap_pos[0, 2] = height_m + 0.1e-3
        if self._coupling is None:
            self._coupling = MujocoCoupling(
                self.model,
                self.data,
                self.sensor,
                sensor_body="sensor",
                pressed_geom="box",
                coupling_s=1.0 / FRAME_RATE_HZ,
                move_m=0.8e-3,
            )
        else:
            self._coupling.reset()
        for height in np.linspace(height_m, height_m - depth_m, self._lowering_steps):
            self.data.mocap_pos[0, 2] = height
            self._gel = self._coupling.step()
        self._count = 0
        return self._seen(), self._info("")

    def step(self, action: np.int64) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        """Move for one frame.

        Raises:
            ValueError: no such action; nothing has moved.
            gymnasium.error.ResetNeeded: `reset` was not called.
        """
        if not self.action_space.contains(action):
            raise ValueError(
                f"action is {action!r}, expected a whole number from 0 to {len(MOVES) - 1}; the "
                "world has not moved"
            )
        if self._coupling is None:
            raise gymnasium.error.ResetNeeded("call reset before step")
        before, reason = self._error_rad(), ""
        self.data.mocap_pos[0, :2] += MOVES[int(action)] * self.task.speed_m_s / FRAME_RATE_HZ
        try:
            self._gel = self._coupling.step()
        except (PressTooDeepError, GelFailureError) as failure:
            reason = str(failure)
        self._count += 1
        left = self._error_rad()
        if not reason:
            reason = self._lost(left)
        there = not reason and left < self.task.tolerance_rad
        progress = (before - left) / self.task.target_rad
        reward = float(np.clip(progress, -LARGEST_PROGRESS, LARGEST_PROGRESS)) + float(there)
        if action == 0 and not there:
            reward -= self.task.idle_penalty
        late = self._count >= round(self.task.duration_s * FRAME_RATE_HZ)
        return self._seen(), float(reward), there, bool(reason) or late, self._info(reason)

    def _lost(self, error_rad: float) -> str:
        """Return why the episode cannot be won any more, or nothing."""
        assert self._gel is not None
        if not self._gel.wrench.force_n.any():
            return "the sensor has left the box"
        if error_rad > self.task.lost_rad:
            return f"the box is {np.rad2deg(error_rad):.0f} degrees from its target"
        return ""

    def render(self) -> NDArray[Any] | None:
        """Return the tactile image (H, W, 3) where the mode is "rgb_array"."""
        if self.render_mode is None or self._gel is None or self._coupling is None:
            return None
        return self._view.see(self._gel, "image")

    def _seen(self) -> NDArray[Any]:
        assert self._gel is not None
        return self._view.see(self._gel)

    def _info(self, reason: str) -> dict[str, Any]:
        info: dict[str, Any] = {
            "yaw_deg": float(np.rad2deg(self.yaw_rad)),
            "is_success": bool(self._error_rad() < self.task.tolerance_rad),
        }
        return info | ({"reason": reason} if reason else {})
