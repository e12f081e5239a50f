# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Behaviour cloning: a network learns the expert's commands; resumable, the same for one seed."""

from __future__ import annotations

import copy
import datetime
import hashlib
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from dotsim_ros.control.policy.demonstration import PLAN, contact_in, read_card
from dotsim_ros.control.policy.examples import (
    DEPTH_UNIT_M,
    TILT_UNIT_RAD,
    Frames,
    PolicyExamples,
    data_hash,
    read_split,
)
from dotsim_ros.control.policy.network import FORMAT, PolicyCard
from dotsim_ros.control.policy.resnet import (
    LINEAR_UNIT_M_S,
    PolicyResNet,
    save_policy,
    without_normalisation,
)
from dotsim_ros.io.arrays import Float32Array
from dotsim_ros.io.files import whole_file, write_json
from dotsim_ros.io.provenance import provenance
from dotsim_ros.learning.checkpoint import read_checkpoint, state_to_resume, take_weights

CHECKPOINT = "training.pt"
REPORT = "training.json"
ROUND = 2000
"""Examples between two checkpoints."""
PLACE_WEIGHT = 0.3
"""Weight of the place's error next to that of the commands: a network that must also estimate the
place of the contact learns the commands sooner."""
_ENTRIES = ("key", "network", "averaged", "optimiser", "step", "spent_s")
"""Of a checkpoint."""
SHRINKAGE = 0.02
"""Share of the fingerprints' mean variance that is added to each cell's, since the variance of
cells that hardly vary is not known better."""
UNUSUAL_FACTOR = 4.0
"""Images farther from the usual than any held-out one by this factor are of another sensor. A twin
of the same design, with another lens, light and noise, is 1.6 times as far; a sensor of another
design 12 times."""


@dataclass(frozen=True)
class PolicyRecipe:
    """How a network is trained.

    Attributes:
        example_count: shown in all, each exposed again.
        learning_rate: of AdamW, the highest of one cycle.
        averaging: share of the running mean of the weights that stays in each step.
    """

    example_count: int = 80_000
    batch: int = 32
    learning_rate: float = 2e-3
    weight_decay: float = 0.02
    averaging: float = 0.99
    side_px: int = 80

    def __post_init__(self) -> None:
        if self.example_count < self.batch or self.batch < 2:
            raise ValueError(
                f"{self.example_count} examples in batches of {self.batch}: expected at least one "
                "batch, of 2 and more"
            )


@dataclass(frozen=True)
class PolicyProgress:
    """How far a training has come, in examples: root mean square errors of the commands and of the
    contact's place since the last report, the time in all runs, and what is left by estimate."""

    done: int
    count: int
    error_m_s: float
    place_error_m: float
    spent_s: float
    left_s: float


class PolicyTraining:
    """One network being trained.

    Args:
        seed: of the first weights and of all that is drawn.
        checkpoint: file of the state; an interrupted run resumes from it.
        start: weights to begin with, in place of random ones, and the file that they are of.

    Raises:
        ValueError: the checkpoint is of another training, or corrupt.
    """

    def __init__(
        self,
        examples: PolicyExamples,
        path_count: int,
        recipe: PolicyRecipe,
        *,
        seed: int,
        key: str,
        checkpoint: Path,
        start: tuple[Any, Path] | None = None,
    ) -> None:
        self._examples, self._recipe, self._checkpoint = examples, recipe, checkpoint
        self._key = hashlib.sha256(repr((key, asdict(recipe), seed)).encode()).hexdigest()
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            network = PolicyResNet(path_count)
        if start is not None:
            take_weights(network, *start)
        self.network = network.to(memory_format=torch.channels_last)
        self._averaged = copy.deepcopy(self.network)
        self._optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=recipe.learning_rate, weight_decay=recipe.weight_decay
        )
        self._seed, self._step, self._spent_s = seed, 0, 0.0
        self._resume()

    @property
    def done(self) -> int:
        """Examples that were shown."""
        return self._step * self._recipe.batch

    def _learning_rate(self) -> float:
        share, rise = min(1.0, self.done / self._recipe.example_count), 0.1
        if share < rise:
            return self._recipe.learning_rate * (0.05 + 0.95 * share / rise)
        return (
            self._recipe.learning_rate * 0.5 * (1 + math.cos(math.pi * (share - rise) / (1 - rise)))
        )

    def _train(self) -> tuple[float, float]:
        """Take a step; return the mean square errors of commands and place, in their units."""
        random = np.random.default_rng([self._seed, self._step])
        numbers = random.integers(len(self._examples.frames), size=self._recipe.batch)
        crop, commands, weight, place = self._examples.batch(numbers, random)
        given = torch.from_numpy(crop).to(memory_format=torch.channels_last)
        wanted = torch.from_numpy(commands).float() / self.network.unit
        share = torch.from_numpy(weight).float()[..., None]
        # Half of the width of single precision's numbers takes half of the time.
        with torch.autocast("cpu", dtype=torch.bfloat16):
            answered, found = self.network.with_place(given)
        wrong = torch.mean(share * torch.square(answered.float() - wanted)) / torch.mean(share)
        astray = torch.mean(torch.square(found.float() - torch.from_numpy(place).float()))
        for group in self._optimiser.param_groups:
            group["lr"] = self._learning_rate()
        self._optimiser.zero_grad()
        (wrong + PLACE_WEIGHT * astray).backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 5.0)
        self._optimiser.step()
        self._step += 1
        self._average()
        return float(wrong.item()), float(astray.item())

    def _average(self) -> None:
        # A running mean over the first steps only, so that it forgets where it began.
        stays = min(self._recipe.averaging, self._step / (self._step + 10.0))
        with torch.no_grad():
            states = (self._averaged.state_dict(), self.network.state_dict())
            for mean, value in zip(states[0].values(), states[1].values(), strict=True):
                if mean.dtype.is_floating_point:
                    mean.lerp_(value, 1.0 - stays)
                else:
                    mean.copy_(value)

    def run(self, progress: Callable[[PolicyProgress], None]) -> PolicyResNet:
        """Train to the end; return the network with averaged weights, in evaluation mode.

        Raises:
            FloatingPointError: the error is no longer finite.
        """
        self.network.train()
        count = self._recipe.example_count
        while self.done < count:
            begun_s = time.monotonic()
            errors: list[tuple[float, float]] = []
            while self.done < count and len(errors) * self._recipe.batch < ROUND:
                errors.append(self._train())
            wrong, astray = np.mean(errors, axis=0)
            if not math.isfinite(wrong + astray):
                raise FloatingPointError(
                    f"the training diverged after {self.done} examples; lower the learning rate"
                )
            self._spent_s += time.monotonic() - begun_s
            self._save()
            # Three of the six numbers are linear; the others are hardly ever wrong.
            error = LINEAR_UNIT_M_S * math.sqrt(6.0 * wrong)
            place = 0.018 * TILT_UNIT_RAD * math.sqrt(astray)
            left = self._spent_s * (count - self.done) / self.done
            progress(PolicyProgress(self.done, count, error, place, self._spent_s, left))
        return copy.deepcopy(self._averaged).eval()

    def _save(self) -> None:
        state = {
            "key": self._key,
            "network": self.network.state_dict(),
            "averaged": self._averaged.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "step": self._step,
            "spent_s": self._spent_s,
        }
        with whole_file(self._checkpoint) as part:
            torch.save(state, part)

    def _resume(self) -> None:
        state = state_to_resume(self._checkpoint, _ENTRIES)
        if state is None:
            return
        if state["key"] != self._key:
            raise ValueError(
                f"{self._checkpoint} belongs to a training with other data, seed or settings; "
                "choose another folder, or remove it to train again"
            )
        take_weights(self.network, state["network"], self._checkpoint)
        take_weights(self._averaged, state["averaged"], self._checkpoint)
        self._optimiser.load_state_dict(state["optimiser"])
        self._step, self._spent_s = int(state["step"]), float(state["spent_s"])


def judge(
    network: PolicyResNet, examples: PolicyExamples, paths: Sequence[str]
) -> dict[str, float]:
    """Return how well a network answers on frames: for each path the mean error of its velocity
    (m/s) where the indenter is within a millimetre of the path, and the median error of the
    contact's place, sideways and in depth (m)."""
    commands, place = [], []
    count = len(examples.frames)
    with torch.inference_mode():
        for numbers in np.array_split(np.arange(count), max(1, count // 32)):
            given = np.stack([examples.input(int(number)) for number in numbers])
            answered, found = network.with_place(torch.from_numpy(given))
            commands.append((answered * network.unit).numpy())
            place.append(found.numpy())
    wanted, weight, true_place = examples.answers(examples.frames.position_m)
    error = np.linalg.norm((np.concatenate(commands) - wanted)[..., :3], axis=-1)
    astray = np.concatenate(place) - true_place
    sideways = 0.018 * TILT_UNIT_RAD * np.linalg.norm(astray[:, :2], axis=1)
    figures = {
        "place_sideways_m": float(np.median(sideways)),
        "place_depth_m": float(np.median(np.abs(DEPTH_UNIT_M * astray[:, 2]))),
    }
    # The weight is 1 / (1 + (d / 1.5 mm)^2): above 0.69 within a millimetre.
    for row, name in enumerate(paths):
        near = weight[:, row] > 0.69
        if near.any():
            figures[f"velocity_error_{name}_m_s"] = float(np.mean(error[near, row]))
    return figures


def usual_images(train: Frames, held_out: Frames) -> tuple[Float32Array, Float32Array, float]:
    """Return mean (F,) and whitening matrix (F, F) of the training images' fingerprints, and the
    distance above which images are taken for another sensor's."""
    mean = train.fingerprint.mean(axis=0, dtype=np.float64)
    covariance = np.cov(train.fingerprint.T.astype(np.float64))
    ridge = SHRINKAGE * float(np.trace(covariance)) / len(mean)
    values, vectors = np.linalg.eigh(covariance + ridge * np.eye(len(mean)))
    root = (vectors / np.sqrt(values)) @ vectors.T
    deviation = (held_out.fingerprint - mean) @ root.T
    largest = float(np.sqrt(np.mean(np.square(deviation), axis=1)).max())
    return mean.astype(np.float32), root.astype(np.float32), UNUSUAL_FACTOR * largest


def train_policy(
    folders: Sequence[Path],
    out: Path,
    *,
    record: Path,
    name: str,
    recipe: PolicyRecipe,
    seed: int,
    progress: Callable[[PolicyProgress], None],
    start: Path | None = None,
) -> dict[str, Any]:
    """Train a policy on demonstrations and write it, with a report.

    Args:
        record: folder of the training's state and report.
        progress: called every few thousand examples.
        start: a checkpoint whose weights to begin with; None for random ones.

    Returns:
        What the report holds.

    Raises:
        ValueError: as `read_split`, or the folder of the record holds another training's state.
        FloatingPointError: the training diverged.
    """
    made = read_card(folders[0])
    plan, view = made[PLAN], made["view"]
    paths = tuple(plan["paths"])
    contact = contact_in(folders[0])
    train, held_out = read_split(folders)
    examples = PolicyExamples(train, paths, contact, recipe.side_px)
    training = PolicyTraining(
        examples,
        len(paths),
        recipe,
        seed=seed,
        key=data_hash(folders),
        checkpoint=record / CHECKPOINT,
        start=None if start is None else (read_checkpoint(start, _ENTRIES)["averaged"], start),
    )
    network = training.run(progress)
    figures = judge(network, PolicyExamples(held_out, paths, contact, recipe.side_px), paths)
    mean, root, largest = usual_images(train, held_out)
    origin = provenance()
    card = PolicyCard(
        version=FORMAT,
        name=name,
        sensor=plan["sensor"],
        indenter=plan["indenter"],
        paths=paths,
        rate_hz=made["rate_hz"],
        image_height=view["image_shape"][0],
        image_width=view["image_shape"][1],
        share=view["share"],
        side_px=recipe.side_px,
        largest_distance=largest,
        data={
            "folders": [folder.resolve().name for folder in folders],
            "train_images": len(train),
            "held_out_images": len(held_out),
            "begun_with": "" if start is None else f"{start.parent.name}/{start.name}",
            "seed": seed,
            "recipe": asdict(recipe),
        },
        metrics=figures,
        commit=origin["commit"],
        date=datetime.date.today().isoformat(),
        command=" ".join([Path(sys.argv[0]).name, *sys.argv[1:]]),
    )
    card = save_policy(out, without_normalisation(network), card, usual_mean=mean, usual_root=root)
    report = {"card": asdict(card), "origin": origin}
    write_json(record / REPORT, report)
    return report
