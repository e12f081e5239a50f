# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rows of the optics table, kept on disk as soon as they are there.

Fitting a network takes minutes to hours, so an interrupted run resumes where it ended: a row
is found again by the data, the frames of its split, its model, how that is fitted and the code that
does it. Frames and models that are the same give the same row, whatever the split is called.
"""

from __future__ import annotations

import hashlib
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.cache import tell_broken
from dotsim_ros.io.documents import read_arrays, read_json
from dotsim_ros.io.files import whole_file, write_json
from dotsim_ros.io.provenance import provenance, source_hash
from dotsim_ros.optics.network.card import TRAINED
from dotsim_ros.twin.footage import OpticalData, OpticalPress
from studies.optics.judge import (
    ImageFrameScores,
    ImageModel,
    restricted,
    score_frames,
    scores_from_json,
)
from studies.optics.models import (
    CLIPPED,
    MADE_BY,
    REFINED,
    FitSettings,
    factory_of,
)
from studies.optics.split import FrameKey, OpticalSplit

_FORMAT = 1


@dataclass(frozen=True)
class TrainingRecord:
    """How far a network was trained.

    Attributes:
        epochs: passes over all frames.
        minutes: of CPU time spent training.
        width_px, height_px: of its images.
    """

    epochs: int
    minutes: float
    width_px: int
    height_px: int


@dataclass(frozen=True)
class Row:
    """What a model got on the judged frames of a split.

    Attributes:
        scores: of every judged frame.
        images: (H, W, 3) predicted, of the frames that sheets show.
        fit_s: how long the fit took, with what else the machine did.
        predict_s: how long predicting and judging took, a frame.
        commit, date: when it was made.
        training: of a network; None for what is no network.
    """

    scores: tuple[ImageFrameScores, ...]
    images: dict[FrameKey, ImageArray]
    fit_s: float
    predict_s: float
    commit: str
    date: str
    training: TrainingRecord | None = None


def by_name(data: OpticalData) -> dict[str, OpticalPress]:
    """Return the presses by name."""
    return {press.name: press for press in data.presses}


@dataclass(frozen=True)
class RowMaker:
    """Makes rows, or finds those made before.

    Attributes:
        data: the measured frames, with the simulated skin.
        clipped: gives the presses with Tacto's clipped skin, when a row needs them.
        refined: gives the same frames by an idle image that the frames of a split to fit on refine.
        cache: folder of the rows.
        settings: how models are fitted.
    """

    data: OpticalData
    clipped: Callable[[], Mapping[str, OpticalPress]]
    refined: Callable[[OpticalSplit], OpticalData]
    cache: Path
    settings: FitSettings = field(default_factory=FitSettings)

    @cached_property
    def presses(self) -> dict[str, OpticalPress]:
        """The presses by name."""
        return by_name(self.data)

    @cached_property
    def _digest(self) -> str:
        digest = hashlib.sha256(self.data.rest.idle.tobytes())
        for press in self.data.presses:
            digest.update(press.name.encode())
            for array in (press.tip_depth_m, press.measured, press.depth_m, press.warped):
                digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def _path(self, model: str, split: OpticalSplit, shown: Sequence[FrameKey]) -> Path:
        fitted: list[Any] = [source_hash(*MADE_BY)]
        if model in TRAINED:
            fitted += [self.settings.epochs_of(model), self.settings.width_of(model)]
        parts = [_FORMAT, self._digest, split.train, split.test, list(shown)]
        key = repr((*parts, model, self.settings.seed, fitted)).encode()
        return self.cache / f"{model}-{hashlib.sha256(key).hexdigest()[:24]}.json"

    def make(self, model: str, split: OpticalSplit, shown: Sequence[FrameKey]) -> Row:
        """Return the row of a model on a split.

        Args:
            model: one of `models.NAMES`.
            split: frames to fit on and to judge on.
            shown: judged frames whose images are wanted.

        Raises:
            ValueError: the model could not be fitted.
        """
        path = self._path(model, split, shown)
        known = _load(path)
        where = f"{split.level}, {split.way}, {model}"
        if known is not None:
            print(f"{where}: made before, on {known.date}")
            return known
        print(f"{where}: fitting on {len(split.train)} frames")
        data = self.refined(split) if model in REFINED else self.data
        presses = self.clipped() if model in CLIPPED else by_name(data)
        # The disc that is judged is the same for all.
        rest, camera = replace(data.rest, lit=self.data.rest.lit), data.camera
        state = path.with_suffix(".state")
        make = factory_of(model, self.settings, state=state)
        start = time.perf_counter()
        fitted = make(restricted(presses, split.train), rest, camera)
        fit_s = time.perf_counter() - start
        print(f"{where}: judging {len(split.test)} frames")
        start = time.perf_counter()
        scores, images = score_frames(fitted, presses, split.test, rest, keep=shown)
        predict_s = (time.perf_counter() - start) / len(scores)
        origin = provenance()
        row = Row(
            tuple(scores),
            images,
            fit_s,
            predict_s,
            origin["commit"],
            origin["date"],
            _training_of(fitted),
        )
        _store(path, row)
        # What a training leaves to go on from is as large as its network, and done with.
        shutil.rmtree(state, ignore_errors=True)
        return row


def _training_of(model: ImageModel) -> TrainingRecord | None:
    """Return how the training of a model went that reports it, as networks do."""
    course: Any = getattr(model, "trained", None)
    if course is None:
        return None
    size: Any = getattr(model, "size", None)
    return TrainingRecord(course.epochs, course.spent_s / 60.0, *size)


def _store(path: Path, row: Row) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path.with_suffix(".npz")) as temporary:
        np.savez_compressed(
            temporary,
            press=np.array([name for name, _ in row.images], dtype=np.str_),
            frame=np.array([frame for _, frame in row.images], dtype=np.int64),
            image=np.array(list(row.images.values()), dtype=np.uint8),
        )
    write_json(
        path,
        {
            "scores": [asdict(score) for score in row.scores],
            "fit_s": row.fit_s,
            "predict_s": row.predict_s,
            "commit": row.commit,
            "date": row.date,
            "training": None if row.training is None else asdict(row.training),
        },
    )


def _load(path: Path) -> Row | None:
    try:
        values = read_json(path)
        arrays = read_arrays(path.with_suffix(".npz"))
        keys = zip(arrays["press"].tolist(), arrays["frame"].tolist(), strict=True)
        images = dict(zip(keys, arrays["image"], strict=True))
        scores = tuple(scores_from_json(values.pop("scores")))
        training = values.pop("training", None)
        record = None if training is None else TrainingRecord(**training)
        return Row(scores=scores, images=images, training=record, **values)
    except FileNotFoundError:
        return None
    # What is broken or of another version is recreated.
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        tell_broken(path, error)
        return None
