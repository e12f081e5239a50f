# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Press to a force by touch: demonstrations as a LeRobotDataset, on which ACT is trained.

A controller that knows the force presses in `DenseTactPress-v0`; LeRobot records what the sensor
sees and what was done, loads it again and trains a small ACT on the CPU. Writes the data set and
error.png below OUT.

    python train_act.py --out out/act --episodes 5 --steps 100
"""

from __future__ import annotations

import argparse
from pathlib import Path

import gymnasium
import matplotlib
import numpy as np
import torch
from lerobot.configs.types import FeatureType
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.utils import dataset_to_policy_features
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors

import dotsim_ros.control.environments  # noqa: F401 registers them

matplotlib.use("Agg")
import matplotlib.pyplot as plt

FPS = 25
SIDE_PX = 64
CHUNK = 8
BATCH = 8
FORCE_N = 1.0
IMAGE, STATE, ACTION = "observation.images.finger", "observation.state", "action"
AXES = ["x", "y", "z"]
FEATURES = {
    IMAGE: {
        "dtype": "image",
        "shape": (SIDE_PX, SIDE_PX, 3),
        "names": ["height", "width", "channels"],
    },
    STATE: {"dtype": "float32", "shape": (3,), "names": AXES},
    ACTION: {"dtype": "float32", "shape": (3,), "names": AXES},
}


def record(folder: Path, episode_count: int) -> LeRobotDataset:
    """Write demonstrations of the press, and return them as LeRobot loads them."""
    data_set = LeRobotDataset.create(
        "dotsim/press", FPS, FEATURES, root=folder, robot_type="ball", use_videos=False
    )
    environment = gymnasium.make(
        "DenseTactPress-v0", image_size_px=(SIDE_PX, SIDE_PX), force_n=FORCE_N, duration_s=2.0
    )
    ball = environment.unwrapped
    for episode in range(episode_count):
        image, information = environment.reset(seed=episode)
        is_over = False
        while not is_over:
            inwards = -ball.position_m / np.linalg.norm(ball.position_m)
            speed = np.clip(0.6 * (FORCE_N - information["force_n"]), -0.3, 0.3)
            action = (speed * inwards).astype(np.float32)
            data_set.add_frame(
                {
                    IMAGE: image,
                    STATE: ball.position_m.astype(np.float32),
                    ACTION: action,
                    "task": f"press to {FORCE_N:g} N",
                }
            )
            image, _, ended, late, information = environment.step(action)
            is_over = ended or late
        data_set.save_episode()
        print(f"episode {episode}: {information['force_n']:.2f} N", flush=True)
    data_set.finalize()
    later = {ACTION: [index / FPS for index in range(CHUNK)]}
    return LeRobotDataset("dotsim/press", root=folder, delta_timestamps=later)


def train(data_set: LeRobotDataset, step_count: int) -> list[float]:
    """Train a small ACT, and return the mean error of its normalised actions at each step."""
    torch.manual_seed(0)
    features = dataset_to_policy_features(data_set.meta.features)
    outputs = {key: each for key, each in features.items() if each.type is FeatureType.ACTION}
    config = ACTConfig(
        input_features={key: each for key, each in features.items() if key not in outputs},
        output_features=outputs,
        chunk_size=CHUNK,
        n_action_steps=CHUNK,
        pretrained_backbone_weights=None,
        dim_model=64,
        n_heads=4,
        dim_feedforward=128,
        n_encoder_layers=1,
        n_vae_encoder_layers=1,
        device="cpu",
    )
    policy = ACTPolicy(config)
    prepare, _ = make_pre_post_processors(config, dataset_stats=data_set.meta.stats)
    optimizer = torch.optim.AdamW(policy.parameters(), lr=3e-4)
    policy.train()
    errors: list[float] = []
    while len(errors) < step_count:
        for batch in torch.utils.data.DataLoader(data_set, BATCH, shuffle=True, drop_last=True):
            loss, parts = policy.forward(prepare(batch))
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            # Without the divergence of its latent, which falls first and says little.
            errors.append(parts["l1_loss"])
            if len(errors) == step_count:
                break
    return errors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/act"))
    parser.add_argument("--episodes", type=int, default=5)
    parser.add_argument("--steps", type=int, default=100)
    options = parser.parse_args()
    data_set = record(options.out / "press", options.episodes)
    print(f"{data_set.num_episodes} episodes, {data_set.num_frames} frames", flush=True)
    errors = train(data_set, options.steps)
    tenth = max(1, options.steps // 10)
    first, last = np.mean(errors[:tenth]), np.mean(errors[-tenth:])
    print(f"error of the first {tenth} steps {first:.2f}, of the last {last:.2f}")
    plt.figure(figsize=(5, 3))
    plt.plot(errors)
    plt.xlabel("step")
    plt.ylabel("L1 error of normalised actions")
    plt.tight_layout()
    plt.savefig(options.out / "error.png", dpi=120)


if __name__ == "__main__":
    main()
