# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Data sets and bags: refused, or read as they were written."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random

import numpy as np
import yaml

from dotsim_ros.data.data_set import INDEX, read_data_set
from dotsim_ros.data.data_set_writer import write_data_set
from dotsim_ros.data.reading import PressReader
from dotsim_ros.data.trajectory import (
    ImageChannel,
    PoseChannel,
    SkinChannel,
    Trajectory,
    WrenchChannel,
    read_trajectory,
)
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.skin_mesh import dome_skin
from fuzz.mutate import flipped_bit, spoilt_bytes, spoilt_text, spoilt_tree
from fuzz.target import Finding, Target, answer

FRAME_COUNT = 6
SKIN = dome_skin(0.01575, 4e-3)


@dataclass(frozen=True)
class _Written:
    """A data set as it was written: its files by their paths, and the press."""

    files: dict[str, bytes]
    trajectory: Trajectory


def _trajectory() -> Trajectory:
    numbers = np.random.default_rng(1)
    stamp_ns = (1e9 + 4e7 * np.arange(FRAME_COUNT)).astype(np.int64)
    depth_m = 2e-4 * np.arange(FRAME_COUNT)
    position = np.stack([0 * depth_m, 0 * depth_m, 0.01575 - depth_m], 1)
    turn = np.tile([0.0, 0.0, 0.0, 1.0], (FRAME_COUNT, 1))
    force = np.stack([0 * depth_m, 0 * depth_m, 2e3 * depth_m], 1)
    skin = numbers.normal(0.0, 5e-3, (FRAME_COUNT, 40, 3)).astype(np.float32)
    image = numbers.integers(0, 255, (FRAME_COUNT, 12, 16, 3)).astype(np.uint8)
    return Trajectory(
        pose=PoseChannel(stamp_ns, position, turn),
        wrench=WrenchChannel(stamp_ns, force, 0.0 * force),
        skin=SkinChannel(stamp_ns, skin),
        image=ImageChannel(stamp_ns, image),
        name="press",
    )


def _written(folder: Path) -> _Written:
    trajectory = _trajectory()
    root = folder / "set"
    write_data_set(root, [(trajectory, sphere(2e-3))])
    files = {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file()
    }
    return _Written(files, trajectory)


def _lay_out(files: dict[str, bytes], folder: Path) -> None:
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def _mcap(files: dict[str, bytes]) -> str:
    return next(name for name in files if name.endswith(".mcap"))


def _attempt_bag(written: _Written, random: Random, folder: Path) -> None:
    """Spoil the mcap, or the metadata next to it."""
    names = [_mcap(written.files), Path(_mcap(written.files)).parent.joinpath("metadata.yaml")]
    name = str(names[0] if random.random() < 0.8 else names[1])
    _lay_out(written.files, folder)
    (folder / name).write_bytes(spoilt_bytes(written.files[name], random))
    _read(written, folder)


def _attempt_bit(written: _Written, random: Random, folder: Path) -> None:
    """Flip one bit of the mcap: what is read then is what was written."""
    _lay_out(written.files, folder)
    name = _mcap(written.files)
    (folder / name).write_bytes(flipped_bit(written.files[name], random))
    read = _read(written, folder)
    if read is not None:
        _compare(read, written.trajectory)


def _read(written: _Written, folder: Path) -> Trajectory | None:
    bag = (folder / _mcap(written.files)).parent
    names = ["press", bag.name]
    trajectory = answer(partial(read_trajectory, bag), names)
    data_set = read_data_set(folder)
    answer(partial(PressReader(data_set, SKIN, False).read, data_set.entries[0]), names)
    return trajectory


def _compare(read: Trajectory, written: Trajectory) -> None:
    for channel in ("pose", "wrench", "skin", "image"):
        ours, theirs = getattr(written, channel), getattr(read, channel)
        if theirs is None:
            raise Finding(f"the channel {channel} is missing without a word")
        for field in ours.__dataclass_fields__:
            one, other = getattr(ours, field), getattr(theirs, field)
            if one is not None and not np.array_equal(one, other):
                raise Finding(f"{channel}.{field} differs from what was written")


def _attempt_index(written: _Written, random: Random, folder: Path) -> None:
    text = written.files[INDEX].decode()
    tree = spoilt_tree(yaml.safe_load(text), random)
    _lay_out(written.files, folder)
    spoilt = spoilt_text(text, random) if random.random() < 0.5 else yaml.safe_dump(tree)
    (folder / INDEX).write_text(spoilt)
    data_set = answer(lambda: read_data_set(folder), [INDEX])
    if data_set is None:
        return
    for entry in data_set.entries:
        answer(partial(PressReader(data_set, SKIN, False).read, entry), [entry.name])


TARGETS = (
    Target("bag", _written, _attempt_bag),
    Target("bag_bit", _written, _attempt_bit),
    Target("data_set", _written, _attempt_index),
)
