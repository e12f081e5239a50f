# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Residuals of places put together into the tables that a report shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dotsim_ros.data.recording import Phase
from dotsim_ros.gap.findings import ResidualPlace
from dotsim_ros.io.arrays import FloatArray

ALL = "all"
MOST_COLUMNS = 8
_FIELDS = ("channel", "trajectory", "phase", "region")


@dataclass(frozen=True)
class PlaceTable:
    """Residuals by two things at once.

    Attributes:
        rows, columns: labels of R rows and C columns.
        before, after: (R, C) RMS in expected deviations; NaN where nothing was measured.
    """

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    before: FloatArray
    after: FloatArray


def by_phase(places: Sequence[ResidualPlace]) -> PlaceTable:
    """Return residuals of each region of each channel, by what the indenter does."""
    where = _wheres(places)
    order = [phase.value for phase in Phase]
    phases = sorted(_named(places, "phase"), key=lambda p: order.index(p) if p in order else 99)
    return _table(
        places,
        {_where_label(*one): _wanted(*one) for one in where},
        {phase: {"phase": phase} for phase in phases},
    )


def by_trajectory(places: Sequence[ResidualPlace]) -> PlaceTable:
    """Return residuals of each trajectory, by channel and region; by channel alone where there are
    more regions than a narrow image can show."""
    where = _wheres(places)
    if len(where) > MOST_COLUMNS:
        where = [(channel, ALL) for channel in dict.fromkeys(channel for channel, _ in where)]
    return _table(
        places,
        {name: {"trajectory": name} for name in _named(places, "trajectory")},
        {_where_label(*one): _wanted(*one) for one in where},
    )


def strongest(table: PlaceTable, count: int) -> PlaceTable:
    """Return the rows whose largest residual before is largest, in their order."""
    peak = np.nan_to_num(table.before, nan=0.0).max(axis=1)
    kept = np.sort(np.argsort(-peak, kind="stable")[:count])
    return PlaceTable(
        tuple(table.rows[k] for k in kept),
        table.columns,
        table.before[kept],
        table.after[kept],
    )


def _named(places: Sequence[ResidualPlace], field: str) -> list[str]:
    return [
        name for name in dict.fromkeys(getattr(place, field) for place in places) if name != ALL
    ]


def _wheres(places: Sequence[ResidualPlace]) -> list[tuple[str, str]]:
    """Return each channel's regions; a channel without any stands for itself."""
    found = []
    for channel in dict.fromkeys(place.channel for place in places if place.channel != ALL):
        regions = _named([place for place in places if place.channel == channel], "region")
        found += [(channel, region) for region in regions or [ALL]]
    return found


def _wanted(channel: str, region: str) -> dict[str, str]:
    return {"channel": channel} if region == ALL else {"channel": channel, "region": region}


def _where_label(channel: str, region: str) -> str:
    return channel if region == ALL else f"{channel}, {region}"


def _table(
    places: Sequence[ResidualPlace],
    rows: dict[str, dict[str, str]],
    columns: dict[str, dict[str, str]],
) -> PlaceTable:
    shape = (len(rows), len(columns))
    before, after = np.full(shape, np.nan), np.full(shape, np.nan)
    for i, row in enumerate(rows.values()):
        for j, column in enumerate(columns.values()):
            before[i, j], after[i, j] = _level(places, {**row, **column})
    return PlaceTable(tuple(rows), tuple(columns), before, after)


def _level(places: Sequence[ResidualPlace], wanted: dict[str, str]) -> tuple[float, float]:
    """Return RMS before and after of all that is wanted: as stated, else summed from parts."""
    whole = dict.fromkeys(_FIELDS, ALL) | wanted
    matching = [p for p in places if all(getattr(p, k) == v for k, v in wanted.items())]
    stated = [p for p in matching if all(getattr(p, k) == v for k, v in whole.items())]
    # A sum that is there next to its parts must not be counted with them.
    free = [name for name in _FIELDS if name not in wanted]
    parts = stated or _finest(matching, free)
    count = sum(place.count for place in parts)
    if not count:
        return float("nan"), float("nan")
    before = sum(place.count * place.before**2 for place in parts) / count
    after = sum(place.count * place.after**2 for place in parts) / count
    return float(np.sqrt(before)), float(np.sqrt(after))


def _finest(places: Sequence[ResidualPlace], free: Sequence[str]) -> list[ResidualPlace]:
    """Return the places that are split by as much as any is."""
    split = [sum(getattr(place, name) != ALL for name in free) for place in places]
    return [place for place, count in zip(places, split, strict=True) if count == max(split)]
