# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A slip detector on the skin's motion and the force of two frames. Entry: `SlipDetector`.

No sensor's units enter: forces are divided by the normal force, ways by the radius of the touched
patch. The object's pose is needed for the label alone.
"""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from dotsim_ros.geometry.indenter import Indenter, load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.learning.touches.formats import key_of

FEATURE_COUNT = 9
LEAST_FORCE_N = 0.1
"""Of a frame that is judged."""
TOUCHES_M = 5e-5
"""Skin so near to the object touches it."""
MOVED_M = 1e-4
FOLLOWS = 0.5
SKIN_NOISE_M, FORCE_NOISE_N = 4e-5, 0.015
"""Standard deviations that are added to simulated touches."""
SKIN, WRENCH, POSE = (key_of(name, 0, 1) for name in ("skin", "wrench", "pose"))


@dataclass(frozen=True)
class SkinTouch:
    """A touch as a detector sees it.

    Attributes:
        rest_m: (V, 3) the skin at rest, base frame.
        moved_m: (F, V, 3) its displacement.
        force_n: (F, 3) on the sensor.
        poses: of the indenter, for the label.
        indenter: that touches.
    """

    rest_m: FloatArray
    moved_m: FloatArray
    force_n: FloatArray
    poses: Sequence[Pose]
    indenter: Indenter

    def judged(self) -> Any:
        """Return (F - 1,) whether a frame presses hard enough."""
        return np.linalg.norm(self.force_n[1:], axis=1) > LEAST_FORCE_N

    def slips(self) -> Any:
        """Return (F - 1,) whether a frame slips: the object moved along the skin by more than
        0.1 mm since the frame before, and the skin that touches it in both followed less than half.
        """
        outward = _unit(self.rest_m)
        found = []
        for k in range(1, len(self.poses)):
            now, last = self.poses[k], self.poses[k - 1]
            skin_m = self.rest_m + self.moved_m[k - 1], self.rest_m + self.moved_m[k]
            on = self.indenter.distance_from(skin_m[0], last) < TOUCHES_M
            on &= self.indenter.distance_from(skin_m[1], now) < TOUCHES_M
            turn = now.rotation() @ last.rotation().T
            led = now.position_m + (skin_m[0][on] - last.position_m) @ turn.T - skin_m[0][on]
            led -= (led * outward[on]).sum(axis=1, keepdims=True) * outward[on]
            square = float((led**2).sum())
            is_led = on.sum() > 3 and square > on.sum() * MOVED_M**2
            followed = float(((skin_m[1] - skin_m[0])[on] * led).sum())
            found.append(bool(is_led and followed < FOLLOWS * square))
        return np.array(found)

    def features(self) -> FloatArray:
        """Return (F - 1, 9) of each frame and the one before, without the object's pose."""
        outward = _unit(self.rest_m)
        rows: list[list[Any]] = []
        last: tuple[Any, ...] = ()
        for moved, force in zip(self.moved_m, self.force_n, strict=True):
            depth = -(moved * outward).sum(axis=1)
            weight = np.maximum(depth - 0.5 * np.quantile(depth, 0.995), 0.0)
            weight /= max(weight.sum(), 1e-12)
            centre = weight @ self.rest_m
            normal = _unit(centre[None])[0]
            radius = float(np.sqrt(weight @ ((self.rest_m - centre) ** 2).sum(axis=1))) + 1e-4
            skin, shear = (_across(each, normal) for each in (weight @ moved, force))
            pressed = float(force @ normal)
            if last:
                way: FloatArray = shear / (np.linalg.norm(shear) + 1e-9)
                sheared, skin_way = shear - last[3], skin - last[1]
                patch_way = _across(centre - last[0], normal)
                forces = (_length(shear), sheared @ way, _length(sheared), pressed - last[2])
                ways: list[Any] = [_length(skin)]
                ways += [
                    size for each in (skin_way, patch_way) for size in (each @ way, _length(each))
                ]
                scale = max(pressed, 0.05)
                rows.append([*(n / scale for n in forces), *(w / radius for w in ways)])
            last = centre, skin, pressed, shear
        return np.clip(np.array(rows), -5.0, 5.0)


class SlipDetector:
    """A small network that says whether frames slip.

    Args:
        features: (N, 9) of the frames that it learns from.
        slips: (N,) whether they do.
        seed: of its first weights.
    """

    def __init__(self, features: FloatArray, slips: Any, seed: int = 0) -> None:
        self._mean, self._scale = features.mean(axis=0), features.std(axis=0) + 1e-6
        torch.manual_seed(seed)
        width = 32
        self._network = torch.nn.Sequential(
            torch.nn.Linear(FEATURE_COUNT, width),
            torch.nn.Tanh(),
            torch.nn.Linear(width, width),
            torch.nn.Tanh(),
            torch.nn.Linear(width, 1),
        )
        # Slips are rare: each weighs as much more.
        weight = torch.tensor((~slips).sum() / max(slips.sum(), 1))
        loss = torch.nn.BCEWithLogitsLoss(pos_weight=weight)
        descent = torch.optim.AdamW(self._network.parameters(), 3e-3, weight_decay=1e-2)
        given, wanted = self._scaled(features), torch.tensor(slips, dtype=torch.float32)
        for _ in range(600):
            descent.zero_grad()
            loss(self._network(given)[:, 0], wanted).backward()
            descent.step()

    def __call__(self, features: FloatArray) -> Any:
        """Return (N,) whether frames slip."""
        with torch.no_grad():
            return (self._network(self._scaled(features))[:, 0] > 0.0).numpy()

    def _scaled(self, features: FloatArray) -> torch.Tensor:
        return torch.tensor((features - self._mean) / self._scale, dtype=torch.float32)


def labelled_frames(touches: Sequence[SkinTouch]) -> tuple[FloatArray, Any]:
    """Return features (N, 9) and slips (N,) of all frames that press hard enough."""
    judged = [touch.judged() for touch in touches]
    return (
        np.concatenate([t.features()[frames] for t, frames in zip(touches, judged, strict=True)]),
        np.concatenate([t.slips()[frames] for t, frames in zip(touches, judged, strict=True)]),
    )


def touches_in(folder: Path, rest_m: FloatArray, seed: int = 0) -> Iterator[SkinTouch]:
    """Yield the touches of a data set in the format webdataset, with the noise of a measurement.

    Args:
        folder: of the data set, with skin, wrench and pose.
        rest_m: (V, 3) the skin of its sensor at rest.
        seed: of the noise.
    """
    random = np.random.default_rng(seed)
    for path in sorted(folder.glob("*.tar")):
        frames: dict[str, list[Any]] = {}
        names: dict[str, str] = {}
        with tarfile.open(path) as archive:
            for member in archive:
                touch, file = member.name.partition("_")[0], archive.extractfile(member)
                content = file.read() if file else b""
                if member.name.endswith(".json"):
                    names[touch] = json.loads(content)["task"].split()[1]
                elif member.name.endswith(".npz"):
                    frames.setdefault(touch, []).append(dict(np.load(io.BytesIO(content))))
        for touch, given in frames.items():
            moved_m, force_n = (
                np.stack([frame[key].astype(float) for frame in given]) for key in (SKIN, WRENCH)
            )
            force_n = force_n[:, :3]
            yield SkinTouch(
                rest_m,
                moved_m + SKIN_NOISE_M * random.standard_normal(moved_m.shape),
                force_n + FORCE_NOISE_N * random.standard_normal(force_n.shape),
                [Pose(frame[POSE][:3], frame[POSE][3:]) for frame in given],
                load_indenter(names[touch]),
            )


def _length(vector: FloatArray) -> float:
    return float(np.linalg.norm(vector))


def _across(vector: FloatArray, normal: FloatArray) -> FloatArray:
    return vector - (vector @ normal) * normal


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)
