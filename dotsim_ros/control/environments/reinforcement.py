# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Proximal policy optimisation of the environments' tasks, with a network that sees by touch.

PPO is skrl's (Serrano-Munoz et al., "skrl: Modular and Flexible Library for Reinforcement
Learning", 2023), as in the paper, section IV-D: a ResNet-18 shared by policy and value. Its batch
normalisation is replaced by that of groups (Wu and He, "Group Normalization", 2018), since a policy
acts on one image at a time and learns on many. Each pixel is taken from its own mean, in its
channel's standard deviations, since a touch changes an image by little; both are found before
learning and kept: those of a running estimate change for as long as it learns, and policies got
worse again after they had found the way.
"""

from __future__ import annotations

import copy
import json
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import CategoricalMixin, DeterministicMixin, Model
from skrl.resources.preprocessors.torch import RunningStandardScaler
from torch import nn
from torchvision.models import resnet18

import dotsim_ros.control.environments
from dotsim_ros.io.files import whole_file

FORMAT = 3
"""Of a checkpoint; another one is refused."""
GROUPS = 8
CHECKPOINT = "policy.pt"
EPISODES = 50
"""That the curve of a training is a mean of."""
RANDOM_MOVES = 96
"""Before learning, for the mean and the deviation of what is seen."""
LARGEST_SEEN = 20.0
"""Standard deviations that are told apart."""
ADAM_EPSILON = 1e-5
"""A policy that mostly gets there has next to no gradient, which Adam with its usual 1e-8 turns
into steps as large as ever; the usual value with PPO."""
VALUE_SHARE = 0.5
"""Of the value's loss: it must not alone shape what policy and value share."""


@dataclass(frozen=True)
class PpoSettings:
    """What is learnt, and how.

    Attributes:
        world_count: worlds side by side, each in a process where there are several.
        rollout: steps of each world between two updates.
        learning_rate, discount, entropy_share: of PPO. Three times that rate finds the way as
            fast and loses it again, since the policy then moves by more than the few episodes
            between two updates tell. What a move does to the box is felt at once: a long memory
            only adds to their noise.
    """

    environment: str = "DenseTactBoxYaw-v0"
    options: dict[str, Any] = field(
        default_factory=lambda: {"observation": "depth", "image_size_px": [32, 32]}
    )
    world_count: int = 1
    rollout: int = 384
    epochs: int = 6
    mini_batches: int = 6
    learning_rate: float = 1e-4
    discount: float = 0.9
    entropy_share: float = 0.01
    seed: int = 0


@dataclass
class Progress:
    """What a training has done.

    Attributes:
        steps: of all worlds together.
        curve: (steps, share of successes among the last episodes, mean return of these).
        is_enough: whether it ended because the share was large enough.
        best_share: the largest share of a full `EPISODES`; the policy of then is the one kept.
    """

    steps: int = 0
    seconds: float = 0.0
    curve: list[tuple[int, float, float]] = field(default_factory=list)
    is_enough: bool = False
    best_share: float = -1.0


class SeenScaler(nn.Module):
    """Scales what is seen by a mean of each pixel and a deviation of each channel."""

    def __init__(self, size: Any, *, device: str) -> None:
        super().__init__()
        self._channels = size.shape[-1]
        count = int(np.prod(size.shape))
        self.register_buffer("mean", torch.zeros(count, device=device))
        self.register_buffer("deviation", torch.ones(count, device=device))

    def learn(self, seen: torch.Tensor) -> None:
        """Take mean and deviation from what was seen (N, pixels of all channels)."""
        self.mean = seen.mean(dim=0)
        from_mean = (seen - self.mean).reshape(-1, self._channels)
        deviation = from_mean.square().mean(dim=0).sqrt()
        # A channel that never changes says nothing in any unit.
        deviation = torch.where(deviation > 0.0, deviation, torch.ones_like(deviation))
        self.deviation = deviation.repeat(len(self.mean) // self._channels)

    def forward(self, seen: torch.Tensor | None, **_options: Any) -> torch.Tensor | None:
        """Return what is seen (N, pixels of all channels), scaled."""
        if seen is None:
            return None
        scaled = (seen - self.mean) / self.deviation
        return scaled.clamp(-LARGEST_SEEN, LARGEST_SEEN)


class TouchNetwork(CategoricalMixin, DeterministicMixin, Model):
    """Policy and value on one ResNet-18."""

    def __init__(self, observation_space: Any, action_space: Any) -> None:
        Model.__init__(
            self, observation_space=observation_space, action_space=action_space, device="cpu"
        )
        CategoricalMixin.__init__(self)
        DeterministicMixin.__init__(self)
        self._shape = observation_space.shape
        self.trunk = resnet18(weights=None, norm_layer=lambda count: nn.GroupNorm(GROUPS, count))
        self.trunk.conv1 = nn.Conv2d(self._shape[-1], 64, 7, stride=2, padding=3, bias=False)
        features = self.trunk.fc.in_features
        self.trunk.fc = nn.Identity()
        self.policy_head = nn.Linear(features, int(action_space.n))
        self.value_head = nn.Linear(features, 1)
        # All moves are as likely at first.
        nn.init.zeros_(self.policy_head.weight)
        nn.init.zeros_(self.policy_head.bias)
        self._features: torch.Tensor | None = None

    def act(self, inputs: dict[str, Any], *, role: str = "") -> Any:
        if role == "policy":
            return CategoricalMixin.act(self, inputs, role=role)
        return DeterministicMixin.act(self, inputs, role=role)

    def compute(
        self, inputs: dict[str, Any], role: str = ""
    ) -> tuple[torch.Tensor, dict[str, Any]]:
        if role == "policy" or self._features is None:
            image = inputs["observations"].view(-1, *self._shape).float()
            self._features = self.trunk(image.permute(0, 3, 1, 2))
        if role == "policy":
            return self.policy_head(self._features), {}
        # PPO asks for both of one batch, the value second.
        features, self._features = self._features, None
        return self.value_head(features), {}


def _agent(settings: PpoSettings, space: Any, actions: Any) -> PPO:
    network = TouchNetwork(space, actions)
    config = PPO_CFG(
        rollouts=settings.rollout,
        learning_epochs=settings.epochs,
        mini_batches=settings.mini_batches,
        learning_rate=settings.learning_rate,
        discount_factor=settings.discount,
        gae_lambda=settings.discount,
        entropy_loss_scale=settings.entropy_share,
        value_loss_scale=VALUE_SHARE,
        # The value is to learn which edge is touched before the policy has settled on a move that
        # serves one of them alone; held near its old values, it learns slowly.
        value_clip=0.0,
        observation_preprocessor=SeenScaler,
        observation_preprocessor_kwargs={"size": space, "device": "cpu"},
        value_preprocessor=RunningStandardScaler,
        value_preprocessor_kwargs={"size": 1, "device": "cpu"},
    )
    config.experiment.write_interval = config.experiment.checkpoint_interval = 0
    agent = PPO(
        models={"policy": network, "value": network},
        memory=RandomMemory(
            memory_size=settings.rollout, num_envs=settings.world_count, device="cpu"
        ),
        observation_space=space,
        action_space=actions,
        device="cpu",
        cfg=config,
    )
    agent.init()
    for group in agent.optimizer.param_groups:
        group["eps"] = ADAM_EPSILON
    return agent


def train(
    settings: PpoSettings,
    folder: Path,
    *,
    steps: int,
    seconds: float = float("inf"),
    enough: float = 1.0,
    tell: Callable[[str], None] = lambda _line: None,
) -> Progress:
    """Learn until so many steps are done or so much time is spent, and return the progress.

    It goes on from `folder`, where a checkpoint is left after every update: a training that was
    killed loses at most one. The worlds begin again then. Policies may get worse again, so the one
    that got there most often while learning is kept as well, and is the one that is judged.

    Args:
        seconds: of the training, those spent before included.
        enough: share of the last `EPISODES` episodes that got there after which it ends.
        tell: called with a line about each update.

    Raises:
        ValueError: the folder's checkpoint is of other settings or of another version.
    """
    torch.manual_seed(settings.seed)
    worlds = make_worlds(settings)
    try:
        environment = wrap_env(worlds, wrapper="gymnasium", verbose=False)
        agent = _agent(settings, environment.observation_space, environment.action_space)
        progress, best = Progress(), None
        if (folder / CHECKPOINT).is_file():
            progress, best = _load(folder, settings, agent)
        else:
            agent._observation_preprocessor.learn(_seen_at_random(environment, settings))
        agent.enable_training_mode(True)
        torch.manual_seed(settings.seed + progress.steps)
        environment._seed = settings.seed + progress.steps
        observations, _ = environment.reset()
        episodes: deque[tuple[bool, float]] = deque(maxlen=EPISODES)
        returns = np.zeros(settings.world_count)
        begun_s = time.monotonic() - progress.seconds
        while (
            progress.steps < steps
            and time.monotonic() - begun_s < seconds
            and not progress.is_enough
        ):
            for _ in range(settings.rollout):
                with torch.no_grad():
                    actions, _ = agent.act(observations, None, timestep=0, timesteps=0)
                    following, rewards, ended, late, info = environment.step(actions)
                returns += rewards.numpy().ravel()
                agent.record_transition(
                    observations=observations,
                    states=None,
                    actions=actions,
                    rewards=rewards,
                    next_observations=following,
                    next_states=None,
                    # The second is part of the task, so nothing is worth anything after it. What
                    # follows here is the next episode's first observation: valued in its stead, it
                    # would make being late as good as getting there.
                    terminated=ended | late,
                    truncated=late,
                    infos=info,
                    timestep=0,
                    timesteps=0,
                )
                for world in np.flatnonzero((ended | late).numpy().ravel()):
                    episodes.append((bool(ended[world]), float(returns[world])))
                    returns[world] = 0.0
                observations = following
                agent.post_interaction(timestep=0, timesteps=0)
            progress.steps += settings.rollout * settings.world_count
            progress.seconds = time.monotonic() - begun_s
            share, mean = np.mean(episodes, axis=0) if episodes else (0.0, 0.0)
            progress.curve.append((progress.steps, float(share), float(mean)))
            is_full = len(episodes) == EPISODES
            progress.is_enough = is_full and bool(share > enough)
            if best is None or (is_full and share > progress.best_share):
                progress.best_share = float(share) if is_full else progress.best_share
                best = copy.deepcopy(agent.policy.state_dict())
            _save(folder, settings, agent, progress, best)
            tell(
                f"{progress.steps} steps, {progress.seconds:.0f} s: {100 * share:.0f} % of the "
                f"last {len(episodes)} episodes there, return {mean:.2f}"
            )
    finally:
        worlds.close()
    return progress


def _seen_at_random(environment: Any, settings: PpoSettings) -> torch.Tensor:
    """Return what random moves show (N, pixels of all channels)."""
    environment._seed = settings.seed
    observations, _ = environment.reset()
    moves = np.random.default_rng(settings.seed)
    shown = [observations]
    for _ in range(RANDOM_MOVES // settings.world_count):
        drawn = moves.integers(environment.action_space.n, size=(settings.world_count, 1))
        with torch.no_grad():
            observations, *_ = environment.step(torch.from_numpy(drawn))
        shown.append(observations)
    return torch.cat(shown).float()


def make_worlds(settings: PpoSettings) -> gymnasium.vector.VectorEnv:
    """Return the worlds of a training, which begin again by themselves."""
    assert dotsim_ros.control.environments.NAMES
    return gymnasium.make_vec(
        settings.environment,
        num_envs=settings.world_count,
        vectorization_mode="async" if settings.world_count > 1 else "sync",
        vector_kwargs={"autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP},
        **_given(settings.options),
    )


@dataclass(frozen=True)
class Episode:
    """How an episode from a seed went: whether it got there, and its length."""

    seed: int
    is_success: bool
    frames: int


def learnt_moves(
    settings: PpoSettings, folder: Path, world: gymnasium.Env[Any, Any]
) -> Callable[[Any], np.int64]:
    """Return the most likely move of a learnt policy, a function of an observation of `world`.

    Raises:
        FileNotFoundError: no checkpoint in the folder.
        ValueError: it is of other settings or of another version.
    """
    if not (folder / CHECKPOINT).is_file():
        raise FileNotFoundError(f"{folder} holds no {CHECKPOINT}; train there first")
    agent = _agent(settings, world.observation_space, world.action_space)
    _, best = _load(folder, settings, agent)
    agent.policy.load_state_dict(best)
    agent.enable_training_mode(False)
    network = agent.policy
    network.eval()

    def move(seen: Any) -> np.int64:
        with torch.no_grad():
            pixels = torch.as_tensor(seen.reshape(1, -1), dtype=torch.float32)
            inputs = {"observations": agent._observation_preprocessor(pixels)}
            logits, _ = network.compute(inputs, "policy")
        return np.int64(int(logits.argmax()))

    return move


def run_episodes(
    world: gymnasium.Env[Any, Any], move: Callable[[Any], np.int64], seeds: Iterable[int]
) -> list[Episode]:
    """Return how an episode from each seed goes with moves chosen from what is seen."""
    episodes = []
    for seed in seeds:
        seen, _ = world.reset(seed=int(seed))
        frames, there, late = 0, False, False
        while not (there or late):
            seen, _, there, late, _ = world.step(move(seen))
            frames += 1
        episodes.append(Episode(int(seed), bool(there), frames))
    return episodes


def success_share(
    settings: PpoSettings, folder: Path, seeds: Sequence[int], **changes: Any
) -> float:
    """Return the share of episodes in which the most likely moves of a learnt policy get there.

    Args:
        changes: of the environment's options.

    Raises:
        FileNotFoundError: no checkpoint there.
        ValueError: it is of other settings or of another version.
    """
    world = make_world(settings, **changes)
    try:
        episodes = run_episodes(world, learnt_moves(settings, folder, world), seeds)
    finally:
        world.close()
    return float(np.mean([episode.is_success for episode in episodes]))


def make_world(settings: PpoSettings, **changes: Any) -> gymnasium.Env[Any, Any]:
    """Return one world of a training, with other options where given."""
    assert dotsim_ros.control.environments.NAMES
    return gymnasium.make(settings.environment, **{**_given(settings.options), **changes})


def _given(options: dict[str, Any]) -> dict[str, Any]:
    """Return options as an environment takes them: JSON knows no tuples."""
    return {k: tuple(v) if isinstance(v, list) else v for k, v in options.items()}


def _save(
    folder: Path,
    settings: PpoSettings,
    agent: PPO,
    progress: Progress,
    best: dict[str, torch.Tensor],
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        "format": FORMAT,
        "settings": json.dumps(asdict(settings), sort_keys=True),
        "progress": json.dumps(asdict(progress)),
        "network": agent.policy.state_dict(),
        "best": best,
        "scalers": [scaler.state_dict() for scaler in _scalers(agent)],
        "optimizer": agent.optimizer.state_dict(),
    }
    with whole_file(folder / CHECKPOINT) as part:
        torch.save(content, part)


def _scalers(agent: PPO) -> tuple[SeenScaler, RunningStandardScaler]:
    return agent._observation_preprocessor, agent._value_preprocessor


def _load(
    folder: Path, settings: PpoSettings, agent: PPO
) -> tuple[Progress, dict[str, torch.Tensor]]:
    path = folder / CHECKPOINT
    try:
        content = torch.load(path, weights_only=True)
    # What torch raises on a broken file is not bounded, and its words advise to run code of it.
    except Exception as error:
        raise ValueError(
            f"{path} cannot be read ({type(error).__name__}); remove it to begin again"
        ) from error
    found = content.get("format") if isinstance(content, dict) else None
    if found != FORMAT:
        raise ValueError(
            f"{path} is a checkpoint of format {found}, expected {FORMAT}: it is of another "
            "version; train in another folder"
        )
    expected = json.dumps(asdict(settings), sort_keys=True)
    if content["settings"] != expected:
        raise ValueError(
            f"{path} was learnt with other settings, {content['settings']}, expected {expected}; "
            "give the same, or train in another folder"
        )
    agent.policy.load_state_dict(content["network"])
    for scaler, state in zip(_scalers(agent), content["scalers"], strict=True):
        scaler.load_state_dict(state)
    agent.optimizer.load_state_dict(content["optimizer"])
    stored = json.loads(content["progress"])
    progress = Progress(**{**stored, "curve": [tuple(row) for row in stored["curve"]]})
    return progress, content["best"]
