# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads data sets in the layout LeRobotDataset v3.0, of this package or of LeRobot itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dotsim_ros.data.lerobot.writer import INFO, SEEN, VERSION, check_installed
from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.documents import read_json, value_text


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
        rows = [
            row
            for path in sorted(self.folder.glob("meta/episodes/*/*.parquet"))
            for row in self._table(path).to_pylist()
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
        path = self.folder / self._info["video_path"].format(
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
        path = self.folder / self._info["data_path"].format(
            chunk_index=row["data/chunk_index"], file_index=row["data/file_index"]
        )
        import pyarrow.compute as compute

        table = self._table(path, list(dict.fromkeys([*keys, "episode_index", "frame_index"])))
        table = table.filter(compute.equal(table["episode_index"], row["episode_index"]))
        if len(table) != row["length"]:
            raise ValueError(f"{path} has {len(table)} frames, expected {row['length']}")
        return table.sort_by("frame_index").select(keys)

    def _table(self, path: Path, columns: list[str] | None = None) -> Any:
        import pyarrow as pa
        import pyarrow.parquet as parquet

        try:
            return parquet.ParquetFile(path).read(columns=columns)
        except (OSError, pa.ArrowException) as error:
            reason = str(error).partition("\n")[0]
            raise ValueError(f"{path} cannot be read as a table ({reason})") from error


def _kind(dtype: str) -> Any:
    return object if dtype == "string" else dtype
