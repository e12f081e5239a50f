# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Find a gel's stiffness and friction by gradient descent through the simulation.

You learn how a loss of simulated forces gets derivatives: `dotsim_ros.differentiable.press_each`
returns tensors of torch, and `loss.backward()` goes back through all frames of all trajectories,
friction's history included. Here the "measured" forces come from a gel with constants that the
descent does not know.

python examples/calibrate_by_gradient.py [STEPS]
"""

import sys
from dataclasses import replace

import numpy as np
import torch

from dotsim_ros import Pose, load_indenter, load_sensor
from dotsim_ros.differentiable import press_each

TRUE = {"youngs_modulus_pa": 2.2e5, "friction": 0.55}
# Along x and down from the face, mm.
PRESS_AND_SLIDE = ((0.0, 0.2), (0.0, -0.4), (0.3, -0.4), (0.8, -0.4))
PRESS_TWICE = ((0.0, 0.2), (0.0, -0.3), (0.0, -0.6), (-0.3, -0.6))


def main(steps: int) -> None:
    sensor = load_sensor("flat_pad")
    # An unrefined gel is solved in a fraction of the time.
    sensor = replace(sensor, solver=replace(sensor.solver, refined=False))
    ball = load_indenter("sphere_4mm")
    top_m = sensor.gel.pad_size_m[2]
    paths = [
        [Pose(np.array([1e-3 * x, 0.0, top_m + 1e-3 * z])) for x, z in path]
        for path in (PRESS_AND_SLIDE, PRESS_TWICE)
    ]
    balls = [ball] * len(paths)
    measured_n = press_each(sensor, balls, paths, **TRUE).force_n

    logarithms = {
        "youngs_modulus_pa": torch.tensor(np.log(sensor.material.youngs_modulus_pa)),
        "friction": torch.tensor(np.log(sensor.contact.friction_coefficient)),
    }
    for logarithm in logarithms.values():
        logarithm.requires_grad_()
    descent = torch.optim.Adam(logarithms.values(), lr=0.05)
    slower = torch.optim.lr_scheduler.ExponentialLR(descent, 0.95)
    for step in range(steps):
        values = {name: logarithm.exp() for name, logarithm in logarithms.items()}
        off_n = press_each(sensor, balls, paths, **values).force_n - measured_n
        loss = (off_n**2).mean()
        descent.zero_grad()
        loss.backward()
        descent.step()
        slower.step()
        now = ", ".join(f"{name} {value.item():.4g}" for name, value in values.items())
        print(f"step {step}: forces off by {1e3 * loss.sqrt().item():.1f} mN at {now}", flush=True)
    print("true:", ", ".join(f"{name} {value:.4g}" for name, value in TRUE.items()))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
