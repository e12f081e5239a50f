# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes data sets in the layout LeRobotDataset v3.0, as PyPI's `lerobot` reads them.

with LeRobotWriter(folder, {"observation.state": {"dtype": "float32", "shape": (7,)}}, 25) as set:
    set.add_episode({"observation.state": positions}, "press")

Episodes are written in groups: a parquet file of their frames, an MP4 file for each video, and a
parquet file about the episodes. A group is counted by `meta/info.json`, the last file written. So a
reader finds only whole groups, at whatever moment the writer is ended, and a writer that opens the
folder again goes on behind the last one.
https://huggingface.co/docs/lerobot/lerobot-dataset-v3
"""

from __future__ import annotations

import importlib
import json
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from dotsim_ros.data.lerobot.statistics import (
    Statistics,
    image_statistics,
    merged,
    statistics_of,
)
from dotsim_ros.data.lerobot.video import VideoFile
from dotsim_ros.io.documents import read_json, value_text
from dotsim_ros.io.extras import extra_needed
from dotsim_ros.io.files import encoded_image, no_room_named, whole_file, write_json

VERSION = "v3.0"
INFO, STATISTICS, TASKS = "meta/info.json", "meta/stats.json", "meta/tasks.parquet"
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA, EPISODES = f"data/{FILE}.parquet", f"meta/episodes/{FILE}.parquet"
SEEN = ("video", "image")
VIDEO = f"videos/{{video_key}}/{FILE}.mp4"
FILES_A_CHUNK = 1000
SAMPLED_IMAGES = 4
"""Of an episode's images, so many at most are in its statistics, ..."""
SAMPLED_SIDE_PX = 60
"""...at so many pixels of a side at least."""

INDEX_FEATURES: dict[str, dict[str, Any]] = {
    "timestamp": {"dtype": "float32", "shape": (1,), "names": None},
    **{
        name: {"dtype": "int64", "shape": (1,), "names": None}
        for name in ("frame_index", "episode_index", "index", "task_index")
    },
}
"""What the writer adds to every frame: seconds within its episode; numbers of the frame in its
episode, of the episode, of the frame in the data set, and of the task."""

Feature = Mapping[str, Any]
"""`dtype`: of numpy, "video" or "image" (PNG, exact) for images (H, W, 3), or "string"; `shape`;
`names` of the entries of a shape, None for none."""


def check_installed() -> None:
    """Refuse to write where the packages that it takes are not there.

    Raises:
        ValueError: one is not installed.
    """
    with extra_needed("the format of LeRobot", "dataset"):
        for name in ("pyarrow", "av"):
            importlib.import_module(name)


class LeRobotWriter:
    """A data set that grows by one episode at a time; one that is there already is continued.

    Args:
        folder: of the data set.
        features: of every frame, by key; those of `INDEX_FEATURES` are added.
        fps: frames a second.
        robot_type: what was recorded.

    Attributes:
        episode_count, frame_count: in the data set, with those that wait to be written.

    Raises:
        ValueError: the folder holds a data set of another version, rate or features, or a package
            is missing.
    """

    def __init__(
        self,
        folder: str | Path,
        features: Mapping[str, Feature],
        fps: float,
        *,
        robot_type: str = "dotsim_ros",
    ) -> None:
        check_installed()
        self.folder, self.fps = Path(folder), fps
        self.features: dict[str, dict[str, Any]] = {
            key: {
                "dtype": str(feature["dtype"]),
                "shape": [int(length) for length in feature["shape"]],
                "names": feature.get("names"),
            }
            for key, feature in {**features, **INDEX_FEATURES}.items()
        }
        wrong = [key for key in self.features if "/" in key]
        if wrong:
            raise ValueError(f"the feature {value_text(wrong[0])} has a '/', expected dots")
        self._info: dict[str, Any] = {
            "codebase_version": VERSION,
            "robot_type": robot_type,
            "total_episodes": 0,
            "total_frames": 0,
            "total_tasks": 0,
            "chunks_size": FILES_A_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": int(fps) if fps == int(fps) else fps,
            "splits": {},
            "data_path": DATA,
            "video_path": VIDEO if self._videos() else None,
            "features": self.features,
        }
        self._tasks: list[str] = []
        self._statistics: dict[str, Statistics] = {}
        self._file_count = 0
        if (self.folder / INFO).is_file():
            self._continue()
        self.episode_count: int = self._info["total_episodes"]
        self.frame_count: int = self._info["total_frames"]
        self._open_group()

    def __enter__(self) -> LeRobotWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            self._drop_group()

    def _videos(self) -> list[str]:
        return [key for key, feature in self.features.items() if feature["dtype"] == "video"]

    def _seen(self) -> list[str]:
        return [key for key, feature in self.features.items() if feature["dtype"] in SEEN]

    def _continue(self) -> None:
        """Take what is there.

        Raises:
            ValueError: it is of another version, rate or features.
        """
        path = self.folder / INFO
        there = read_json(path)
        version = there.get("codebase_version") if isinstance(there, dict) else None
        if version != VERSION:
            raise ValueError(
                f"{path} is of the version {value_text(version)}, expected {VERSION}; give another "
                "folder"
            )
        described = {
            key: {name: value for name, value in feature.items() if name != "info"}
            for key, feature in there["features"].items()
        }
        if described != self.features or there["fps"] != self._info["fps"]:
            raise ValueError(
                f"{self.folder} holds a data set of other features or another rate; give another "
                "folder"
            )
        import pyarrow.parquet as parquet

        self._info, self.features = there, there["features"]
        # Files of a group that was not counted are written again.
        for path in sorted(self.folder.glob("meta/episodes/*/*.parquet")):
            rows = [
                row
                for row in parquet.read_table(path).to_pylist()
                if row["episode_index"] < there["total_episodes"]
            ]
            self._file_count += bool(rows)
            for row in rows:
                for task in row["tasks"]:
                    self._task_index(task)
                self._count(_nested(row))

    def _task_index(self, task: str) -> int:
        if task not in self._tasks:
            self._tasks.append(task)
        return self._tasks.index(task)

    def _count(self, found: Mapping[str, Statistics]) -> None:
        for key, one in found.items():
            self._statistics[key] = merged(self._statistics.get(key), one)

    def _open_group(self) -> None:
        self._rows: dict[str, list[Any]] = {
            key: [] for key, feature in self.features.items() if feature["dtype"] != "video"
        }
        self._episodes: list[dict[str, Any]] = []
        self._encoders: dict[str, VideoFile] = {}
        self._part: tempfile.TemporaryDirectory[str] | None = None

    def _drop_group(self) -> None:
        for encoder in self._encoders.values():
            with suppress(Exception):
                encoder.close()
        if self._part is not None:
            self._part.cleanup()
        self.episode_count -= len(self._episodes)
        self.frame_count -= sum(episode["length"] for episode in self._episodes)
        self._open_group()

    def add_episode(
        self, frames: Mapping[str, Sequence[Any] | np.ndarray | Iterable[Any]], task: str
    ) -> None:
        """Append an episode to the group that `flush` writes.

        Args:
            frames: (F, ...) of each feature by key; of a video or image also any iterable of F
                images (H, W, 3) uint8, red, green, blue, which is read once.
            task: what is done, in words.

        Raises:
            ValueError: a feature is missing, unknown, or of another shape; nothing is appended.
            OSError: no room; the group is given up.
        """
        given = dict(frames)
        expected = self.features.keys() - INDEX_FEATURES.keys()
        if given.keys() != expected:
            raise ValueError(
                f"an episode has {value_text(sorted(given))}, expected "
                f"{value_text(sorted(expected))}"
            )
        arrays = {
            key: self._array(key, values)
            for key, values in given.items()
            if self.features[key]["dtype"] not in SEEN
        }
        lengths = {len(values) for values in arrays.values()} or {
            len(given[key])  # type: ignore[arg-type]
            for key in self._seen()
        }
        if len(lengths) != 1 or 0 in lengths:
            raise ValueError(
                f"the features of an episode have {sorted(lengths)} frames, expected as many of "
                "each, and at least one"
            )
        count = lengths.pop()
        number = np.arange(count)
        arrays |= {
            "timestamp": (number / self.fps).astype(np.float32),
            "frame_index": number,
            "episode_index": np.full(count, self.episode_count),
            "index": self.frame_count + number,
            "task_index": np.full(count, self._task_index(task)),
        }
        files: dict[str, list[bytes]] = {key: [] for key in self._seen()}
        with no_room_named(self.folder):
            try:
                found = {
                    key: self._stored(key, given[key], count, files[key]) for key in self._seen()
                }
            except BaseException:
                self._drop_group()
                raise
        found |= {
            key: statistics_of(values)
            for key, values in arrays.items()
            if self.features[key]["dtype"] != "string"
        }
        arrays |= {key: np.array(files[key], dtype=object) for key in files if files[key]}
        before = sum(episode["length"] for episode in self._episodes)
        chunk, file = divmod(self._file_count, FILES_A_CHUNK)
        place = {"chunk_index": chunk, "file_index": file}
        self._episodes.append(
            {
                "episode_index": self.episode_count,
                "tasks": [task],
                "length": count,
                "dataset_from_index": self.frame_count,
                "dataset_to_index": self.frame_count + count,
                **{f"data/{name}": value for name, value in place.items()},
                **{f"meta/episodes/{name}": value for name, value in place.items()},
                **{
                    f"videos/{key}/{name}": value
                    for key in self._videos()
                    for name, value in {
                        **place,
                        "from_timestamp": before / self.fps,
                        "to_timestamp": (before + count) / self.fps,
                    }.items()
                },
                **{
                    f"stats/{key}/{name}": value.tolist()
                    for key, one in found.items()
                    for name, value in one.items()
                },
            }
        )
        for key, values in arrays.items():
            self._rows[key].append(values)
        self.episode_count += 1
        self.frame_count += count

    def _array(self, key: str, values: Any) -> np.ndarray[Any, Any]:
        feature = self.features[key]
        shape = tuple(feature["shape"])
        kind = object if feature["dtype"] == "string" else feature["dtype"]
        array = np.asarray(values, dtype=kind)
        expected = (len(array), *(() if shape == (1,) else shape))
        if array.shape == (len(array), 1):
            array = array.reshape(expected)
        if array.shape != expected:
            raise ValueError(f"{key} has the shape {array.shape}, expected {expected}")
        return array

    def _encoder(self, key: str) -> VideoFile:
        """Return the video of the group."""
        height, width, _ = self.features[key]["shape"]
        if self._part is None:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._part = tempfile.TemporaryDirectory(prefix=".part.", dir=self.folder)
        if key not in self._encoders:
            path = Path(self._part.name) / f"{key}.mp4"
            self._encoders[key] = VideoFile(path, (width, height), self.fps)
        return self._encoders[key]

    def _stored(self, key: str, images: Any, count: int, files: list[bytes]) -> Statistics:
        """Append images to a video of the group, or as PNG to `files`; return their statistics."""
        height, width, _ = self.features[key]["shape"]
        is_video = self.features[key]["dtype"] == "video"
        add = (
            self._encoder(key).add
            if is_video
            else lambda image: files.append(encoded_image("frame.png", image))
        )
        step = max(1, min(height, width) // SAMPLED_SIDE_PX)
        wanted = set(np.linspace(0, count - 1, min(count, SAMPLED_IMAGES)).astype(int).tolist())
        sampled, seen = [], 0
        for image in images:
            if np.shape(image) != (height, width, 3):
                raise ValueError(
                    f"an image of {key} has the shape {np.shape(image)}, expected "
                    f"{(height, width, 3)}"
                )
            pixels = np.ascontiguousarray(image, dtype=np.uint8)
            add(pixels)
            if seen in wanted:
                sampled.append(pixels[::step, ::step].copy())
            seen += 1
        if seen != count:
            raise ValueError(f"{key} has {seen} images for {count} frames, expected as many")
        return image_statistics(np.stack(sampled))

    def flush(self) -> None:
        """Write the group, whole or not at all, and begin the next one.

        Raises:
            OSError: it could not be written; the groups before are as they were.
        """
        if not self._episodes:
            return
        try:
            with no_room_named(self.folder):
                self._write_group()
        except BaseException:
            self._drop_group()
            raise

    def close(self) -> None:
        """Write what waits to be written."""
        self.flush()

    def _write_group(self) -> None:
        chunk, file = divmod(self._file_count, FILES_A_CHUNK)
        place = {"chunk_index": chunk, "file_index": file}
        videos = list(self._encoders.items())
        for key, encoder in videos:
            encoder.close()
            self.features[key].setdefault("info", encoder.information(self._info["fps"]))
        self._encoders = {}
        for key, _ in videos:
            assert self._part is not None
            path = self.folder / VIDEO.format(video_key=key, **place)
            path.parent.mkdir(parents=True, exist_ok=True)
            os.replace(Path(self._part.name) / f"{key}.mp4", path)
        # The frames last: all that they refer to is there then.
        _write_table(self.folder / EPISODES.format(**place), _table_of_records(self._episodes))
        _write_table(self.folder / TASKS, _table_of_tasks(self._tasks))
        _write_table(self.folder / DATA.format(**place), self._table_of_frames())
        for episode in self._episodes:
            self._count(_nested(episode))
        write_json(
            self.folder / STATISTICS,
            {
                key: {name: values.tolist() for name, values in one.items()}
                for key, one in self._statistics.items()
            },
        )
        self._info |= {
            "total_episodes": self.episode_count,
            "total_frames": self.frame_count,
            "total_tasks": len(self._tasks),
            "splits": {"train": f"0:{self.episode_count}"},
            "features": self.features,
        }
        write_json(self.folder / INFO, self._info)
        self._file_count += 1
        if self._part is not None:
            self._part.cleanup()
        self._open_group()

    def _table_of_frames(self) -> Any:
        import pyarrow as pa

        columns = {}
        for key, parts in self._rows.items():
            values = np.concatenate(parts)
            if self.features[key]["dtype"] == "string":
                columns[key] = pa.array(values.tolist(), pa.string())
                continue
            if self.features[key]["dtype"] == "image":
                kind = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
                files = [
                    {"bytes": png, "path": f"frame-{number:06d}.png"}
                    for number, png in enumerate(values.tolist())
                ]
                columns[key] = pa.array(files, kind)
                continue
            column = pa.array(values.reshape(-1))
            # The innermost list has a fixed length where there is one list only, as in LeRobot.
            for length in values.shape[:0:-1]:
                if values.ndim == 2:
                    column = pa.FixedSizeListArray.from_arrays(column, length)
                else:
                    ends = np.arange(0, len(column) + 1, length, dtype=np.int32)
                    column = pa.ListArray.from_arrays(pa.array(ends), column)
            columns[key] = column
        return pa.table(columns)


def _nested(row: Mapping[str, Any]) -> dict[str, Statistics]:
    """Return the statistics of features that a row about an episode holds."""
    found: dict[str, Statistics] = {}
    for column, values in row.items():
        if column.startswith("stats/"):
            _, key, name = column.split("/")
            found.setdefault(key, {})[name] = np.asarray(values)
    return found


def _table_of_records(records: list[dict[str, Any]]) -> Any:
    import pyarrow as pa

    return pa.Table.from_pylist(records)


def _table_of_tasks(tasks: list[str]) -> Any:
    """Return tasks with their numbers; the words are the index of pandas's table."""
    import pyarrow as pa

    index = "__index_level_0__"
    kinds = (("task_index", "int64"), (None, "unicode"))
    about = {
        "index_columns": [index],
        "column_indexes": [],
        "columns": [
            {
                "name": name,
                "field_name": name or index,
                "pandas_type": kind,
                "numpy_type": "int64" if name else "object",
                "metadata": None,
            }
            for name, kind in kinds
        ],
        "pandas_version": "2.0.0",
    }
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), index: tasks})
    return table.replace_schema_metadata({"pandas": json.dumps(about)})


def _write_table(path: Path, table: Any) -> None:
    import pyarrow.parquet as parquet

    with whole_file(path) as part:
        # Measured numbers hardly repeat: a dictionary of them costs time and room.
        parquet.write_table(table, part, compression="zstd", use_dictionary=False)
