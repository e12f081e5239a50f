# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A task of your own as a Gymnasium environment: find the dome's middle by tapping, with a rule.

python examples/your_own_task.py
"""

from pathlib import Path

import gymnasium
import numpy as np

from dotsim_ros import Pose, TactileSensor


class FindMiddle(gymnasium.Env):
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,))  # of 0.5 mm along x and y
    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,))  # force on the ball, N

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        file = Path(__file__).with_name("coarse_sensor.yaml")
        self.sensor = TactileSensor.load(file, indenter="sphere_4mm")
        self.place_m = self.np_random.uniform(-2e-3, 2e-3, 2)
        return self.step(np.zeros(2))[0], {}

    def step(self, action):
        self.place_m = self.place_m + 0.5e-3 * np.clip(action, -1.0, 1.0)
        self.sensor.reset()  # lifted between two taps
        x, y = self.place_m
        force_n = self.sensor.press(Pose.above_apex(1e-3, x_m=x, y_m=y)).wrench.force_n
        slant = float(np.hypot(*force_n[:2]) / force_n[2])
        return force_n, -slant, slant < 0.02, False, {}


if __name__ == "__main__":
    (force_n, _), there = (world := FindMiddle()).reset(seed=0), False
    while not there:
        force_n, reward, there, _, _ = world.step(-10.0 * force_n[:2] / force_n[2])
        print(f"reward {reward:.3f}, {1e3 * np.hypot(*world.place_m):.2f} mm from the middle")
