# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How policies learn, and how one plays: a curve and a moving picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from dotsim_ros.control.environments.box_yaw import FRAME_RATE_HZ, BoxYawEnvironment
from dotsim_ros.control.environments.reinforcement import PpoSettings, learnt_moves, make_world
from dotsim_ros.io.files import whole_file

SIZE_PX = 240
SPAN_M = 0.05
"""What the view from above shows across."""
CONTACT_M = 0.005
SLOWER = 4
"""Times that the picture plays slower than the world."""
HELD_FRAMES = 4
GREY, BLUE, ORANGE = (150, 150, 150), (66, 103, 178), (224, 122, 47)


def write_curve(file: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Draw the share of successes of each training against its steps."""
    figure = Figure(figsize=(6.0, 3.2), layout="constrained")
    axes = figure.subplots()
    for row in rows:
        steps, share, _ = np.array(row["curve"]).T
        axes.plot(steps, 100.0 * share, label=row["name"])
    axes.axhline(90.0, color="0.6", linestyle=":")
    axes.set_xlabel("steps of the world")
    axes.set_ylabel("successes of the last 50 episodes, %")
    axes.set_ylim(0.0, 102.0)
    axes.legend(loc="lower right", frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    with whole_file(file) as part:
        figure.savefig(part, dpi=120)


def write_rollout(
    file: Path, settings: PpoSettings, folder: Path, episode_seeds: Sequence[int]
) -> None:
    """Draw episodes of a learnt policy as a GIF: the box from above, next to the tactile image."""
    made = make_world(settings, render_mode="rgb_array")
    world = made.unwrapped
    assert isinstance(world, BoxYawEnvironment)
    move = learnt_moves(settings, folder, made)
    frames = []
    for seed in episode_seeds:
        seen, _ = made.reset(seed=seed)
        over = False
        frames.append(frame_of(world))
        while not over:
            seen, _, there, late, _ = made.step(move(seen))
            frames.append(frame_of(world))
            over = there or late
        frames += [frames[-1]] * HELD_FRAMES
    made.close()
    images = [Image.fromarray(frame) for frame in frames]
    with whole_file(file) as part:
        images[0].save(
            part,
            save_all=True,
            append_images=images[1:],
            duration=round(1000.0 * SLOWER / FRAME_RATE_HZ),
            loop=0,
        )


def frame_of(world: BoxYawEnvironment) -> NDArray[np.uint8]:
    """Return the view from above next to the tactile image, (SIZE_PX, 2 SIZE_PX, 3)."""
    above = np.full((SIZE_PX, SIZE_PX, 3), 255, dtype=np.uint8)
    half_m = world.task.half_width_m
    for yaw, colour, width in ((world.task.target_rad, GREY, 1), (world.yaw_rad, BLUE, 3)):
        corners = half_m * np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        cv2.polylines(above, [_pixels(corners @ turn.T)], True, colour, width, cv2.LINE_AA)
    place = _pixels(world.data.mocap_pos[0, :2])
    radius = round(CONTACT_M / SPAN_M * SIZE_PX)
    cv2.circle(above, place.tolist(), radius, ORANGE, 3, cv2.LINE_AA)
    seen = world.render()
    assert seen is not None
    image = cv2.resize(seen, (SIZE_PX, SIZE_PX), interpolation=cv2.INTER_NEAREST)
    return np.hstack([above, image])


def _pixels(place_m: NDArray[Any]) -> NDArray[np.int32]:
    flipped = np.asarray(place_m) * (1.0, -1.0)
    return np.round((flipped / SPAN_M + 0.5) * SIZE_PX).astype(np.int32)
