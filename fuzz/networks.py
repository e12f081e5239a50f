# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Networks and policies: files of another's making, which must not be believed."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save_file

from dotsim_ros.control.policy.network import load_policy
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.files import parameter_path
from dotsim_ros.optics.network.carded_weights import CARD_KEY, GRAPH, WEIGHTS
from dotsim_ros.optics.network.completion import CompletionNetwork
from dotsim_ros.specification import load_sensor
from fuzz.mutate import spoilt_bytes, spoilt_tree
from fuzz.target import Target, answer

SENSOR = "sensor_a"


@dataclass(frozen=True)
class _Network:
    folder: Path
    card: dict[str, Any]
    weights: dict[str, np.ndarray[Any, Any]]


def _of(folder: Path) -> _Network:
    with safe_open(folder / WEIGHTS, framework="numpy") as content:
        card = json.loads(content.metadata()[CARD_KEY])
        weights = {name: content.get_tensor(name) for name in content.keys()}  # noqa: SIM118
    return _Network(folder, card, weights)


def _completion(_folder: Path) -> tuple[_Network, Camera]:
    camera = Camera.from_specification(load_sensor(SENSOR).camera)
    return _of(parameter_path(f"networks/{SENSOR}")), camera


def _policy(_folder: Path) -> _Network:
    return _of(parameter_path("policies/densetact2_sphere"))


def _spoil(network: _Network, random: Random, folder: Path) -> None:
    """Copy a network of which weights, graph or card are spoilt."""
    for path in network.folder.iterdir():
        os.symlink(path, folder / path.name)
    kind = random.randrange(4)
    if kind == 0:
        _rewrite(folder / GRAPH, spoilt_bytes((network.folder / GRAPH).read_bytes(), random))
    elif kind == 1:
        content = (network.folder / WEIGHTS).read_bytes()
        # Most of it are numbers, whose sum is checked; the head is the interesting part.
        head, rest = content[:4000], content[4000:]
        _rewrite(folder / WEIGHTS, spoilt_bytes(head, random) + rest)
    else:
        weights = dict(network.weights)
        card = spoilt_tree(network.card, random)
        if kind == 3:
            name = random.choice(list(weights))
            card = network.card
            weights[name] = random.choice(
                (
                    np.full_like(weights[name], np.nan),
                    weights[name][:0],
                    weights[name].astype(np.float64),
                    np.zeros(3, np.uint8),
                )
            )
        (folder / WEIGHTS).unlink()
        save_file(weights, folder / WEIGHTS, metadata={CARD_KEY: json.dumps(card)})


def _rewrite(path: Path, content: bytes) -> None:
    path.unlink()
    path.write_bytes(content)


def _attempt_completion(known: tuple[_Network, Camera], random: Random, folder: Path) -> None:
    network, camera = known
    _spoil(network, random, folder)
    load = partial(CompletionNetwork, folder, sensor=SENSOR, camera=camera)
    answer(load, [folder.name])


def _attempt_policy(network: _Network, random: Random, folder: Path) -> None:
    _spoil(network, random, folder)
    answer(partial(load_policy, folder), [folder.name])


TARGETS = (
    Target("completion", _completion, _attempt_completion),
    Target("policy", _policy, _attempt_policy),
)
