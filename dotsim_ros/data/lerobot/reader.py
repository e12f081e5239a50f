# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads data sets in the layout LeRobotDataset v3.0, of this package or of LeRobot itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dotsim_ros.data.lerobot.writer import INFO, SEEN, VERSION, check_installed
from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.documents import is_number, read_json, value_text

KINDS = frozenset(
    {*SEEN, "string", "bool", "float16", "float32", "float64"}
    | {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
)


def _is_feature(value: Any) -> bool:
    if not isinstance(value, dict) or str(value.get("dtype")) not in KINDS:
        return False
    shape = value.get("shape")
    return isinstance(shape, list) and all(type(n) is int and n > 0 for n in shape)


ENTRIES: tuple[tuple[str, Callable[[Any], bool], str], ...] = (
    (
        "features",
        lambda value: isinstance(value, dict) and all(map(_is_feature, value.values())),
        "a dtype and a shape of each",
    ),
    ("fps", lambda value: is_number(value) and 0.0 < value < 1e6, "a number above 0"),
    ("total_episodes", lambda value: type(value) is int and value >= 0, "a whole number"),
)
"""Entries of `meta/info.json` that are read: what is right, and its words."""
LONGEST_NAME = 255
"""Characters of a file's path within the data set."""


@dataclass(frozen=True)
class Episode:
    """An episode of a data set.

    Attributes:
        index: its number.
        tasks: what is done, in words.
        arrays: (F, ...) of each feature by key, but images.
        row: what the data set says of it.
    """

    index: int
    tasks: tuple[str, ...]
    arrays: dict[str, np.ndarray[Any, Any]]
    row: dict[str, Any]


class LeRobotReader:
    """A data set to read.

    Args:
        folder: of the data set.

    Attributes:
        features: by key; `dtype` and `shape` of each.
        fps: frames a second.
        episode_count: how many episodes there are.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is of another version, or a package is missing.
    """

    def __init__(self, folder: str | Path) -> None:
        check_installed()
        self.folder = Path(folder)
        path = self.folder / INFO
        if not path.is_file():
            raise FileNotFoundError(f"no data set of LeRobot at {folder}: it has no {INFO}")
        info = read_json(path)
        version = info.get("codebase_version") if isinstance(info, dict) else None
        if version != VERSION:
            raise ValueError(
                f"{path} is of the version {value_text(version)}, expected {VERSION}; LeRobot "
                "converts older ones"
            )
        for key, is_right, expected in ENTRIES:
            if not is_right(info.get(key)):
                raise ValueError(
                    f"{path}: {key} is {value_text(info.get(key))}, expected {expected}"
                )
        self._info: dict[str, Any] = info
        self.features: dict[str, dict[str, Any]] = info["features"]
        self.fps = float(info["fps"])
        self.episode_count = int(info["total_episodes"])

    def image_keys(self) -> list[str]:
        """Return the keys of images and videos."""
        return [key for key, feature in self.features.items() if feature["dtype"] in SEEN]

    def episodes(self) -> Iterator[Episode]:
        """Yield the episodes in their order.

        Raises:
            ValueError: a file is missing or is none that can be read.
        """
        needed = ["episode_index", "tasks", "length", "data/chunk_index", "data/file_index"]
        for key in self.image_keys():
            if self.features[key]["dtype"] == "video":
                ends = ("chunk_index", "file_index", "from_timestamp")
                needed += [f"videos/{key}/{end}" for end in ends]
        rows = [
            row
            for path in sorted(self.folder.glob("meta/episodes/*/*.parquet"))
            for row in self._table(path, needed).to_pylist()
            if row["episode_index"] < self.episode_count
        ]
        if len(rows) != self.episode_count:
            raise ValueError(
                f"{self.folder} describes {len(rows)} episodes, expected {self.episode_count}"
            )
        for row in sorted(rows, key=lambda row: int(row["episode_index"])):
            table = self._rows(row, [key for key in self.features if key not in self.image_keys()])
            arrays = {
                key: np.array(table[key].to_pylist(), dtype=_kind(self.features[key]["dtype"]))
                for key in table.column_names
            }
            yield Episode(int(row["episode_index"]), tuple(row["tasks"]), arrays, row)

    def images(self, episode: Episode, key: str) -> Iterator[ImageArray]:
        """Yield the images (H, W, 3) uint8, red, green, blue, of an episode.

        Raises:
            ValueError: one is missing or broken.
        """
        if self.features[key]["dtype"] == "video":
            yield from self._film(episode, key)
            return
        for number, file in enumerate(self._rows(episode.row, [key])[key].to_pylist()):
            pixels = cv2.imdecode(np.frombuffer(file["bytes"], np.uint8), cv2.IMREAD_COLOR)
            if pixels is None:
                raise ValueError(
                    f"{self.folder}, {key}: image {number} of episode {episode.index} is broken"
                )
            yield np.asarray(pixels[..., ::-1], dtype=np.uint8)

    def _film(self, episode: Episode, key: str) -> Iterator[ImageArray]:
        import av

        row = episode.row
        path = self._path(
            "video_path",
            video_key=key,
            chunk_index=row[f"videos/{key}/chunk_index"],
            file_index=row[f"videos/{key}/file_index"],
        )
        first = round(row[f"videos/{key}/from_timestamp"] * self.fps)
        count = 0
        try:
            with av.open(str(path)) as container:
                for number, frame in enumerate(container.decode(video=0)):
                    if first <= number < first + row["length"]:
                        count += 1
                        yield np.asarray(frame.to_ndarray(format="rgb24"), dtype=np.uint8)
        except (OSError, av.FFmpegError) as error:
            raise ValueError(f"{path} cannot be read as a video ({error})") from error
        if count != row["length"]:
            raise ValueError(f"{path} has {count} images, expected {row['length']}")

    def _rows(self, row: dict[str, Any], keys: list[str]) -> Any:
        """Return columns of an episode's frames."""
        path = self._path(
            "data_path", chunk_index=row["data/chunk_index"], file_index=row["data/file_index"]
        )
        import pyarrow.compute as compute

        table = self._table(path, list(dict.fromkeys([*keys, "episode_index", "frame_index"])))
        table = table.filter(compute.equal(table["episode_index"], row["episode_index"]))
        if len(table) != row["length"]:
            raise ValueError(f"{path} has {len(table)} frames, expected {row['length']}")
        return table.sort_by("frame_index").select(keys)

    def _table(self, path: Path, columns: list[str]) -> Any:
        import pyarrow as pa
        import pyarrow.parquet as parquet

        try:
            table = parquet.ParquetFile(path)
            missing = [name for name in columns if name not in table.schema_arrow.names]
            if missing:
                raise ValueError(f"{path} lacks the column {value_text(missing[0])}")
            return table.read(columns=columns)
        except (OSError, pa.ArrowException) as error:
            reason = str(error).partition("\n")[0]
            raise ValueError(f"{path} cannot be read as a table ({reason})") from error

    def _path(self, entry: str, **numbers: Any) -> Path:
        """Return the path of a file that `meta/info.json` has the form of."""
        form = self._info.get(entry)
        try:
            name = form.format(**numbers) if isinstance(form, str) else ""
        except (ValueError, LookupError, AttributeError):
            name = ""
        is_name = 0 < len(name) <= LONGEST_NAME and name.isprintable()
        if not is_name or ".." in Path(name).parts or name.startswith("/"):
            raise ValueError(
                f"{self.folder / INFO}: {entry} is {value_text(form)}, expected the form of a path "
                "in the data set"
            )
        return self.folder / name


def _kind(dtype: str) -> Any:
    return object if dtype == "string" else dtype
