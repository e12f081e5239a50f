# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes a bag of what can be read of one that is damaged or was not finished."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from dotsim_ros.data.bag import PARTIAL, BagFile, BagReader
from dotsim_ros.data.mcap.reader import Tolerance


@dataclass(frozen=True)
class Repaired:
    """What became of a bag: the new one, the messages of each topic in it, what was wrong with the
    old."""

    bag: Path
    counts: Mapping[str, int]
    damage: tuple[str, ...]


def repaired_path(path: str | Path) -> Path:
    """Return where the bag goes that is made of another: its name without `.partial`, or with
    `_repaired`."""
    path = Path(path).absolute()
    name = path.name.removesuffix(".mcap") if path.is_file() else path.name
    stem = name.removesuffix(PARTIAL)
    return path.with_name(stem if stem != name else f"{name}_repaired")


def repair_bag(path: str | Path, out: str | Path | None = None) -> Repaired:
    """Write a bag, with an index and metadata.yaml, of all that can be read of another.

    The other is left as it is. Chunks whose checksum does not match are left out. Without `out`
    the bag goes to `repaired_path`.

    Raises:
        FileNotFoundError: nothing is there.
        ValueError: no message can be read.
        OSError: the new bag cannot be written, or there is something at `out`.
    """
    out = repaired_path(path) if out is None else Path(out)
    counts: Counter[str] = Counter()
    with BagReader(path, Tolerance.DAMAGED) as reader:
        channels = reader.channels()
        if reader.topics() and not channels:
            raise ValueError(
                f"{path} is a bag in sqlite3 or compressed as a whole; only mcap bags are repaired"
            )
        if not reader.topics():
            damage = "; ".join(reader.damage)
            raise ValueError(
                f"{path}: no message can be read{f' ({damage})' if damage else ''}; nothing written"
            )
        with BagFile(out) as bag:
            for channel, schema in channels.values():
                bag.add_channel(channel, schema)
            for message in reader.messages(*channels):
                bag.write_serialized(message.topic, message.log_time_ns, message.serialized)
                counts[message.topic] += 1
            if not counts:
                raise ValueError(
                    f"{path}: no message can be read ({'; '.join(reader.damage)}); nothing written"
                )
        return Repaired(bag.path, counts, reader.damage)
