# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What learners give: plans of touches, and data sets in LeRobot's layout that become bags."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import yaml

from dotsim_ros.data.lerobot.bags import IMAGE, STATE, WRENCH, lerobot_to_bags
from dotsim_ros.data.lerobot.writer import INFO, LeRobotWriter
from dotsim_ros.io.files import parameter_path
from dotsim_ros.learning.touches.plan import TouchPlan, read_plan
from fuzz.mutate import spoilt_bytes, spoilt_text, spoilt_tree
from fuzz.target import Finding, Target, answer

PLAN = "plan.yaml"
FRAME_COUNT, SIDE_PX = 5, 32


def _plan(folder: Path) -> str:
    return parameter_path("touches/default.yaml").read_text()


def _attempt_plan(text: str, random: Random, folder: Path) -> None:
    path = folder / PLAN
    if random.random() < 0.5:
        path.write_text(spoilt_text(text, random))
    else:
        path.write_text(yaml.safe_dump(spoilt_tree(yaml.safe_load(text), random)))
    plan = answer(lambda: read_plan(path), [PLAN, "sensor", "indenter"])
    if plan is not None and not isinstance(plan, TouchPlan):
        raise Finding(f"it gave {plan!r}")


def _data_set(folder: Path) -> dict[str, bytes]:
    """Return the files of a data set of two episodes by their paths."""
    numbers = np.random.default_rng(1)
    shape = (SIDE_PX, SIDE_PX, 3)
    features: dict[str, dict[str, Any]] = {
        IMAGE: {"dtype": "video", "shape": shape, "names": ["height", "width", "channels"]},
        STATE: {"dtype": "float32", "shape": (2,), "names": ["joint1", "joint2"]},
        WRENCH: {"dtype": "float32", "shape": (6,), "names": None},
    }
    root = folder / "set"
    with LeRobotWriter(root, features, 25) as writer:
        for _ in range(2):
            episode: dict[str, Any] = {
                IMAGE: numbers.integers(0, 256, (FRAME_COUNT, *shape)).astype(np.uint8),
                STATE: numbers.normal(size=(FRAME_COUNT, 2)),
                WRENCH: numbers.normal(size=(FRAME_COUNT, 6)),
            }
            writer.add_episode(episode, "press")
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file()
    }


def _attempt_data_set(files: dict[str, bytes], random: Random, folder: Path) -> None:
    root = folder / "set"
    for name, content in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(content)
    if random.random() < 0.5:
        tree = spoilt_tree(json.loads(files[INFO]), random)
        (root / INFO).write_text(json.dumps(tree))
    else:
        name = random.choice(sorted(files))
        (root / name).write_bytes(spoilt_bytes(files[name], random))
    answer(lambda: lerobot_to_bags(root, folder / "bags", lambda words: None), ["set"])


TARGETS = (
    Target("touch_plan", _plan, _attempt_plan),
    Target("lerobot", _data_set, _attempt_data_set),
)
