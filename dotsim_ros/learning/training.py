# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The training loop: one for every network, resumable after a kill, deterministic by its seed."""

from __future__ import annotations

import copy
import hashlib
import math
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Event

import torch
from torch import Tensor, nn

from dotsim_ros.io.files import whole_file
from dotsim_ros.learning.checkpoint import state_to_resume, take_weights
from dotsim_ros.learning.examples import ImageExamples
from dotsim_ros.learning.recipe import TrainingRecipe
from dotsim_ros.optics.network.card import BASES
from dotsim_ros.optics.network.input import CARRIED

CHECKPOINT = "training.pt"
CHECKPOINT_INTERVAL_S = 20.0
"""Time between two checkpoints: the published network's takes half a gigabyte."""


@dataclass(frozen=True)
class TrainingProgress:
    """How far a training has come.

    Attributes:
        epoch: epochs that are done.
        epochs: epochs that will be done.
        psnr_db: of the last epoch's mean square error in training.
        spent_s: CPU time spent, in all runs.
        left_s: estimated CPU time left.
    """

    epoch: int
    epochs: int
    psnr_db: float
    spent_s: float
    left_s: float


@dataclass(frozen=True)
class Trained:
    """A trained network.

    Attributes:
        network: with the averaged weights, in evaluation mode.
        epochs: done.
        spent_s: CPU time spent, in all runs.
        psnr_db: (epochs,) of each epoch's mean square error in training.
    """

    network: nn.Module
    epochs: int
    spent_s: float
    psnr_db: list[float]


def base_image(kind: str, rest: Tensor, image: Tensor) -> Tensor:
    """Return what the network's output is added to, to be broadcast to (N, 3, f h, f w)."""
    match BASES[kind]:
        case "warped":
            return image
        case "idle":
            return rest[:, CARRIED]
        case _:
            return torch.zeros_like(rest[:, CARRIED])


def batches(order: Tensor, size: int) -> list[Tensor]:
    """Return the numbers (F,) in parts of a size; one left over joins the part before, since batch
    normalisation of a single frame's mean colour is not defined."""
    parts = list(order.split(size))
    if len(parts) > 1 and len(parts[-1]) == 1:
        parts[-2:] = [torch.cat(parts[-2:])]
    return parts


def psnr_db(mean_square: float) -> float:
    """Return the peak signal-to-noise ratio of an error whose unit is the peak."""
    return -10.0 * math.log10(max(mean_square, 1e-12))


def _fingerprint(kind: str, recipe: TrainingRecipe, examples: ImageExamples, seed: int) -> str:
    digest = hashlib.sha256(repr((kind, asdict(recipe), seed)).encode())
    for tensor in (examples.frame, examples.rest, examples.image, examples.measured):
        digest.update(repr(tuple(tensor.shape)).encode())
        digest.update(tensor.numpy().tobytes())
    return digest.hexdigest()


_ENTRIES = (
    "fingerprint",
    "network",
    "averaged",
    "optimiser",
    "order",
    "psnr_db",
    "spent_s",
    "step",
)
"""Of a checkpoint."""


class NetworkTraining:
    """One network being trained.

    Args:
        kind: of the network.
        network: untrained.
        examples: what it is trained on.
        recipe: how.
        seed: of the order of the frames.
        device: where.
        directory: of the checkpoint; None for none.
        checkpoint_interval_s: least time between two checkpoints; they are made after an epoch.

    Raises:
        ValueError: the folder holds the checkpoint of another training. A corrupt one is set aside.
    """

    def __init__(
        self,
        kind: str,
        network: nn.Module,
        examples: ImageExamples,
        recipe: TrainingRecipe,
        *,
        seed: int = 0,
        device: torch.device | None = None,
        directory: Path | None = None,
        checkpoint_interval_s: float = CHECKPOINT_INTERVAL_S,
    ) -> None:
        self._checkpoint_interval_s = checkpoint_interval_s
        device = device or torch.device("cpu")
        self.kind, self.recipe = kind, recipe
        self._checkpoint = None if directory is None else directory / CHECKPOINT
        self._fingerprint = _fingerprint(kind, recipe, examples, seed)
        self._examples = examples.to(device)
        self.network = network.to(device)
        self._averaged = copy.deepcopy(self.network)
        optimiser = torch.optim.AdamW if recipe.decoupled else torch.optim.Adam
        self._optimiser = optimiser(
            self.network.parameters(), lr=recipe.learning_rate, weight_decay=recipe.weight_decay
        )
        self._order = torch.Generator().manual_seed(seed)
        self._steps_an_epoch = len(batches(torch.arange(len(examples.frame)), recipe.batch))
        self._psnr_db: list[float] = []
        self._spent_s, self._step = 0.0, 0
        if self._checkpoint is not None:
            self._resume(self._checkpoint)

    @property
    def epoch(self) -> int:
        """Epochs that are done."""
        return len(self._psnr_db)

    def _learning_rate(self) -> float:
        if not self.recipe.one_cycle:
            return self.recipe.learning_rate
        share, rise = self._step / (self.recipe.epochs * self._steps_an_epoch), 0.1
        if share < rise:
            return self.recipe.learning_rate * (0.05 + 0.95 * share / rise)
        falling = (share - rise) / (1.0 - rise)
        return self.recipe.learning_rate * 0.5 * (1.0 + math.cos(math.pi * falling))

    def _train_on(self, index: Tensor) -> float:
        frame, image = self._examples.frame[index], self._examples.image[index]
        rest = self._examples.rest
        predicted = base_image(self.kind, rest, image) + self.network(frame, rest, image)
        loss = torch.mean(torch.square(predicted - self._examples.measured[index]))
        for group in self._optimiser.param_groups:
            group["lr"] = self._learning_rate()
        self._optimiser.zero_grad()
        loss.backward()
        self._optimiser.step()
        self._step += 1
        # A running mean over the first steps only, so that it forgets where it began.
        stays = min(self.recipe.averaging, self._step / (self._step + 10.0))
        if not self.recipe.averaging:
            stays = 0.0
        with torch.no_grad():
            for mean, value in zip(
                self._averaged.state_dict().values(),
                self.network.state_dict().values(),
                strict=True,
            ):
                if mean.dtype.is_floating_point:
                    mean.lerp_(value, 1.0 - stays)
                else:
                    mean.copy_(value)
        return float(loss.item()) * len(index)

    def run(self, progress: Callable[[TrainingProgress], None] | None = None) -> Trained:
        """Train to the end of the epochs, in a thread of its own.

        Weights that a network no longer uses decay into numbers below the smallest normal float,
        with which an Intel core computes some twenty times as slowly. That thread, and those that
        PyTorch starts from it, take them for zero; what else runs in this process does not.

        Args:
            progress: called after every epoch, in that thread.

        Raises:
            FloatingPointError: the error is no longer finite.
        """
        is_abandoned = Event()
        with ThreadPoolExecutor(1, "training", torch.set_flush_denormal, (True,)) as own:
            training = own.submit(self._run, progress, is_abandoned)
            try:
                return training.result()
            finally:
                # Ctrl-C reaches this thread alone.
                is_abandoned.set()

    def _run(
        self, progress: Callable[[TrainingProgress], None] | None, is_abandoned: Event
    ) -> Trained:
        count = len(self._examples.frame)
        saved_s = time.monotonic()
        self.network.train()
        while self.epoch < self.recipe.epochs:
            begun_s, total = time.process_time(), 0.0
            order = torch.randperm(count, generator=self._order)
            for index in batches(order, self.recipe.batch):
                if is_abandoned.is_set():
                    raise CancelledError
                total += self._train_on(index)
            self._spent_s += time.process_time() - begun_s
            if not math.isfinite(total):
                raise FloatingPointError(
                    f"training of {self.kind!r} diverged in epoch {self.epoch + 1}; look for "
                    "frames with values that are not finite"
                )
            self._psnr_db.append(psnr_db(total / count))
            ended = self.epoch == self.recipe.epochs
            if ended or time.monotonic() - saved_s >= self._checkpoint_interval_s:
                self._save()
                saved_s = time.monotonic()
            if progress is not None:
                progress(self._progress())
        network = copy.deepcopy(self._averaged).cpu().eval()
        return Trained(network, self.epoch, self._spent_s, list(self._psnr_db))

    def _progress(self) -> TrainingProgress:
        left_s = self._spent_s * (self.recipe.epochs - self.epoch) / max(self.epoch, 1)
        return TrainingProgress(
            self.epoch, self.recipe.epochs, self._psnr_db[-1], self._spent_s, left_s
        )

    def _save(self) -> None:
        if self._checkpoint is None:
            return
        state = {
            "fingerprint": self._fingerprint,
            "network": self.network.state_dict(),
            "averaged": self._averaged.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "order": self._order.get_state(),
            "psnr_db": self._psnr_db,
            "spent_s": self._spent_s,
            "step": self._step,
        }
        with whole_file(self._checkpoint) as part:
            torch.save(state, part)

    def _resume(self, path: Path) -> None:
        state = state_to_resume(path, _ENTRIES)
        if state is None:
            return
        if state["fingerprint"] != self._fingerprint:
            raise ValueError(
                f"{path} belongs to a training with other data, network, seed or settings; choose "
                "another folder, or remove it to train again"
            )
        take_weights(self.network, state["network"], path)
        take_weights(self._averaged, state["averaged"], path)
        self._optimiser.load_state_dict(state["optimiser"])
        self._order.set_state(state["order"])
        self._psnr_db = list(state["psnr_db"])
        self._spent_s, self._step = float(state["spent_s"]), int(state["step"])
