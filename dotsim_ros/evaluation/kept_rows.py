# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rows of a table that were made before, beside new ones.

Models take from minutes to hours to fit, and their rows do not depend on each other: one model can
be added to a table without fitting the others anew, where both judge the same presses alike.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dotsim_ros.documents import read_json

ORIGIN = ("commit", "date", "machine", "sensor", "command")
"""What each row keeps of the provenance of the run that made it."""
_SAME = ("definitions", "left_out_presses")
_JOINED = ("splits", "judged_frames")
_LEFT_OUT = ("indenter_left_out", "indenter_left_out_all")
_LEFT_OUT_ORIGIN = "origin_indenter_left_out"
_GEOMETRY_KEYS = ("provenance", "floor", *_SAME, *_JOINED)
_OPTICS_KEYS = ("provenance", "splits", "definitions", "ceiling", "failures")


def read_geometry(path: Path) -> dict[str, Any]:
    """Return the figures of a geometry table; errors as `_read`."""
    return _read(path, _GEOMETRY_KEYS)


def read_optics(path: Path) -> dict[str, Any]:
    """Return the figures of an optics table; errors as `_read`."""
    return _read(path, _OPTICS_KEYS)


def _read(path: Path, keys: Sequence[str]) -> dict[str, Any]:
    """Return the figures of a table.

    Raises:
        FileNotFoundError: there is none yet.
        ValueError: it is none, or of another kind.
    """
    if not path.is_file():
        raise FileNotFoundError(
            f"{path} is not there, so no rows can be kept; leave --keep out the first time"
        )
    figures = read_json(path)
    if not isinstance(figures, dict) or not set(keys) <= set(figures):
        raise ValueError(
            f"{path} holds no such table (it needs {', '.join(keys)}); remove it, or leave --keep "
            "out"
        )
    return figures


def with_origin(
    figures: Mapping[str, Any], models: Iterable[str], origin: Mapping[str, str]
) -> dict[str, Any]:
    """Return figures in which each model's row says where it comes from.

    Args:
        figures: of `evaluate_geometry`.
        models: names of the rows.
        origin: the provenance of the run.
    """
    kept = {key: origin[key] for key in ORIGIN}
    return dict(figures) | {name: {**figures[name], "origin": kept} for name in models}


def with_kept_rows(
    figures: Mapping[str, Any], before: Mapping[str, Any], models: Iterable[str]
) -> dict[str, Any]:
    """Return new figures and, beside them, the rows of other models that were made before.

    A model in both is the new one's; where that was not judged on indenters left out, what the
    earlier run found there stays, and says where it comes from. The floor is the new one's where
    both have it: it is no model's, and the same draws give the same.

    Args:
        figures: of `evaluate_geometry`, with its provenance, rows by `with_origin`.
        before: the same of an earlier run.
        models: names of all models there are.

    Raises:
        ValueError: as `check_judged_alike`.
    """
    check_judged_alike(figures, before)
    names = [name for name in models if name in before and name not in figures]
    missing = [name for name in names if "origin" not in before[name]]
    before = with_origin(before, missing, before["provenance"])
    again = [name for name in models if name in before and name in figures]
    return {
        **{name: before[name] for name in names},
        **figures,
        **{name: _with_left_out(figures[name], before[name], before) for name in again},
        "floor": {**before["floor"], **figures["floor"]},
        **{key: {**before[key], **figures[key]} for key in _JOINED},
    }


def _with_left_out(
    row: Mapping[str, Any], old: Mapping[str, Any], before: Mapping[str, Any]
) -> dict[str, Any]:
    """Return a model's new figures with those of indenters left out that only the old ones have."""
    kept = {key: old[key] for key in _LEFT_OUT if key in old and key not in row}
    if not kept:
        return dict(row)
    origin = old.get(_LEFT_OUT_ORIGIN, old.get("origin", before["provenance"]))
    failures = [failure for failure in old["failures"] if failure["split"] != "held_out"]
    return {
        **row,
        **kept,
        "failures": [*row["failures"], *failures],
        _LEFT_OUT_ORIGIN: {key: origin[key] for key in ORIGIN},
    }


def with_kept_image_rows(
    figures: Mapping[str, Any], before: Mapping[str, Any], models: Sequence[str]
) -> dict[str, Any]:
    """Return new figures of images and, beside them, the rows that were made before.

    A row of a level, a way and a model in both is the new one's.

    Args:
        figures: of `evaluate_optics`, with its provenance.
        before: the same of an earlier run.
        models: names of all models there are, in the order of the rows.

    Raises:
        ValueError: as `check_judged_alike`.
    """
    check_judged_alike(figures, before)
    joined = dict(figures)
    joined["splits"] = {**before["splits"], **figures["splits"]}
    joined["failures"] = list(figures["failures"])
    for name in joined["splits"]:
        level, way = name.split(".")
        old = before.get(level, {}).get(way, {})
        sensor = before["provenance"]["sensor"]
        rows = {model: {"sensor": sensor, **row} for model, row in old.items()}
        rows |= figures.get(level, {}).get(way, {})
        ordered = {model: rows[model] for model in models if model in rows}
        joined[level] = {**joined.get(level, {}), way: ordered}
        joined["failures"] += [
            failure
            for failure in before["failures"]
            if (failure["split"], failure["way"]) == (level, way) and failure["model"] not in rows
        ]
    return joined


def check_judged_alike(figures: Mapping[str, Any], before: Mapping[str, Any]) -> None:
    """Refuse rows that were judged on other presses, frames or draws.

    Args:
        figures: with provenance, or as much of them as is known.
        before: of an earlier run.

    Raises:
        ValueError: the runs differ; the message says in what.
    """
    different = [
        f"{key} {before['provenance'][key]}, now {figures['provenance'][key]}"
        for key in ("data", "seed")
        if figures["provenance"][key] != before["provenance"][key]
    ]
    different += [key for key in _SAME if key in figures and figures[key] != before[key]]
    different += [
        f"{key} of {name}"
        for key in _JOINED
        for name, value in figures.get(key, {}).items()
        if name in before[key] and _plain(value) != before[key][name]
    ]
    if different:
        raise ValueError(
            f"the rows to keep were judged otherwise ({'; '.join(different)}); leave --keep out "
            "and judge all models anew"
        )


def _plain(value: Any) -> Any:
    """Return a value as a JSON file gives it back."""
    return json.loads(json.dumps(value))
