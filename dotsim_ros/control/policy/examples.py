# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Demonstrations as examples for a network, turned, mirrored and exposed again each time."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.control.policy.demonstration import (
    CONTACT,
    CONTENT,
    PLAN,
    Episode,
    read_card,
    read_episode,
)
from dotsim_ros.control.policy.images import PolicyInput
from dotsim_ros.control.policy.paths import DomeContact, Expert, reference_path
from dotsim_ros.io.arrays import Float32Array, FloatArray, ImageArray

HELD_OUT_EVERY = 7
"""One of so many episodes is held out; odd, since every other episode follows no path."""
NEAR_M = 1.5e-3
"""Distance from a path at which an example counts half for it."""
LEAST_WEIGHT = 0.05
TILT_UNIT_RAD = 0.25
DEPTH_UNIT_M = 1.0e-3
SYMMETRY_COUNT = 8


@dataclass(frozen=True)
class Frames:
    """Images of some episodes, one after the other: crops (N, side, side, 3) and idle crops
    (I, side, side, 3) uint8, which of the idle ones (N,) goes with each, places of the indenter
    (N, 3) and fingerprints (N, 96)."""

    crop: NDArray[np.uint8]
    idle: NDArray[np.uint8]
    idle_of: NDArray[np.int64]
    position_m: FloatArray
    fingerprint: Float32Array

    def __len__(self) -> int:
        return len(self.position_m)


def frames_of(episodes: Sequence[Episode]) -> Frames:
    """Return the images of episodes."""
    look_count = [len(episode.idle) for episode in episodes]
    first = np.concatenate([[0], np.cumsum(look_count)])
    idle_of = [
        np.repeat(np.arange(number, number + looks), episode.crop.shape[1])
        for number, looks, episode in zip(first, look_count, episodes, strict=False)
    ]
    return Frames(
        np.concatenate([e.crop.reshape(-1, *e.crop.shape[2:]) for e in episodes]),
        np.concatenate([e.idle for e in episodes]),
        np.concatenate(idle_of),
        np.concatenate([np.tile(e.position_m, (len(e.idle), 1)) for e in episodes]),
        np.concatenate([e.fingerprint.reshape(-1, e.fingerprint.shape[-1]) for e in episodes]),
    )


def episode_files(folders: Sequence[Path]) -> list[Path]:
    """Return the episodes' files of some folders.

    Raises:
        ValueError: a folder holds none, or those of other paths, another sensor or indenter than
            the first.
    """
    files: list[Path] = []
    first = None
    for folder in folders:
        card = read_card(folder)
        plan = card[PLAN]
        known = (plan["paths"], plan["sensor"], plan["indenter"], card[CONTENT])
        first = first or known
        found = sorted(folder.glob("episode_*.npz"))
        if not found or known != first:
            raise ValueError(
                f"{folder} holds {len(found)} episodes of {plan['paths']} on {plan['sensor']!r}; "
                "expected some, of the same paths, sensor and indenter in every folder, with the "
                "same content"
            )
        files += found
    return files


def data_hash(folders: Sequence[Path]) -> str:
    """Return a key of sets of demonstrations: their plans, contacts and episodes."""
    digest = hashlib.sha256()
    for folder in folders:
        card = read_card(folder)
        digest.update(json.dumps([card[PLAN], card[CONTACT]], sort_keys=True).encode())
    for path in episode_files(folders):
        # Of one size whatever they show: the arrays are not compressed.
        with path.open("rb") as file:
            digest.update(f"{path.name} ".encode() + hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()


def read_split(folders: Sequence[Path]) -> tuple[Frames, Frames]:
    """Return the frames to train on and those of the episodes that are held out.

    Raises:
        ValueError: as `episode_files`, or there are fewer than two episodes.
    """
    files = episode_files(folders)
    if len(files) < 2:
        raise ValueError(f"there is {len(files)} episode, expected at least 2: one is held out")
    every = min(HELD_OUT_EVERY, len(files))
    held_out = [file for number, file in enumerate(files) if number % every == every - 1]
    train = [file for file in files if file not in held_out]
    return (
        frames_of([read_episode(file) for file in train]),
        frames_of([read_episode(file) for file in held_out]),
    )


def moved_crop(crop: ImageArray, symmetry: int) -> ImageArray:
    """Return the crop turned by a quarter as often as `symmetry % 4`, then, for 4 and more,
    mirrored from left to right."""
    turned = np.rot90(crop, symmetry % 4)
    return np.ascontiguousarray(turned[:, ::-1] if symmetry >= 4 else turned)


def moved_position(position_m: FloatArray, symmetry: int) -> FloatArray:
    """Return a place (3,) where a crop turned and mirrored likewise shows it.

    The camera looks along +z with x to the right and y down, as the base frame's axes lie.
    """
    x, y, z = position_m
    for _ in range(symmetry % 4):
        # rot90 turns the right-hand side up: x right, y down become y right, -x down.
        x, y = y, -x
    return np.array([-x if symmetry >= 4 else x, y, z])


class PolicyExamples:
    """Batches of inputs of a network whose crops are `side_px` wide, and what it should answer."""

    def __init__(
        self, frames: Frames, paths: Sequence[str], contact: DomeContact, side_px: int
    ) -> None:
        self.frames, self._contact, self._side_px = frames, contact, side_px
        self._experts = [Expert(reference_path(name, contact)) for name in paths]

    def answers(self, position_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return commands (N, P, 6), their weights (N, P) and the places (N, 3) in units of order
        one, for places of the indenter (N, 3)."""
        commands = np.stack([expert.command(position_m) for expert in self._experts], axis=1)
        distance = np.stack(
            [expert.path.nearest(position_m)[0] for expert in self._experts], axis=1
        )
        weight = np.maximum(1.0 / (1.0 + np.square(distance / NEAR_M)), LEAST_WEIGHT)
        tilt, depth = self._contact.tilt_and_depth(position_m)
        place = np.concatenate([tilt / TILT_UNIT_RAD, depth[:, None] / DEPTH_UNIT_M], axis=1)
        return commands, weight, place

    def input(
        self, number: int, symmetry: int = 0, random: np.random.Generator | None = None
    ) -> Float32Array:
        """Return the network's input of an image, turned by a symmetry of `moved_crop`; where
        something draws, with another brightness, colour, blur and noise."""
        size = (self._side_px, self._side_px)
        crop = moved_crop(self.frames.crop[number], symmetry)
        idle = moved_crop(self.frames.idle[self.frames.idle_of[number]], symmetry)
        crop = np.asarray(cv2.resize(crop, size, interpolation=cv2.INTER_AREA), np.uint8)
        idle = np.asarray(cv2.resize(idle, size, interpolation=cv2.INTER_AREA), np.uint8)
        if random is not None:
            crop, idle = exposed(crop, idle, random)
        return PolicyInput(idle)(crop)

    def batch(
        self, numbers: NDArray[np.int64], random: np.random.Generator
    ) -> tuple[Float32Array, FloatArray, FloatArray, FloatArray]:
        """Return inputs (N, C, side, side) of images, and their answers."""
        symmetry = random.integers(SYMMETRY_COUNT, size=len(numbers))
        drawn = list(zip(numbers.tolist(), symmetry.tolist(), strict=True))
        inputs = [self.input(number, kind, random) for number, kind in drawn]
        places = [moved_position(self.frames.position_m[number], kind) for number, kind in drawn]
        return np.stack(inputs), *self.answers(np.array(places))


def exposed(
    crop: ImageArray, idle: ImageArray, random: np.random.Generator
) -> tuple[ImageArray, ImageArray]:
    """Return a crop and its idle crop under other lights, with noise in the first."""
    gain = random.uniform(0.75, 1.2) * random.uniform(0.9, 1.1, 3)
    drift = 1.0 + 0.01 * random.standard_normal()
    both = np.concatenate([crop * (gain * drift), idle * gain], axis=2).astype(np.float32)
    if random.uniform() < 0.3:
        both = np.asarray(cv2.GaussianBlur(both, (0, 0), random.uniform(0.3, 0.7)), np.float32)
    noise = random.standard_normal(crop.shape, dtype=np.float32)
    both[..., :3] += np.float32(random.uniform(0.0, 1.0)) * noise
    levels = np.clip(np.rint(both), 0.0, 255.0).astype(np.uint8)
    return levels[..., :3], levels[..., 3:]
