# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Figures of models side by side, as Markdown and as JSON."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Column:
    """A figure of a row.

    Attributes:
        key: in the row.
        title: with its unit, and an arrow to where it is better.
        digits: after the point.
        scale: factor on the figure before it is printed.
    """

    key: str
    title: str
    digits: int = 3
    scale: float = 1.0


GEOMETRY_COLUMNS = (
    Column("chamfer_mm", "L2 CD mm ↓"),
    Column("significant_chamfer_mm", "Sig. L2 CD mm ↓"),
    Column("emd_mm", "EMD mm ↓"),
    Column("f_score", "F-score @1mm % ↑", 2, 100.0),
    Column("skin_rms_mm", "skin RMS mm ↓"),
    Column("contact_rms_mm", "contact RMS mm ↓"),
    Column("vertex_rms_mm", "vertex RMS mm ↓"),
    Column("normal_force_error", "normal force % ↓", 1, 100.0),
    Column("tangential_force_error", "tangential force % ↓", 1, 100.0),
    Column("shear_force_error", "shear % ↓", 1, 100.0),
    Column("frames", "frames", 0),
)

RUNTIME_COLUMNS = (
    Column("spacing_mm", "spacing mm", 2),
    Column("effort", "tolerance / substeps"),
    Column("frames_per_cpu_second", "frames/CPU s ↑", 2),
    Column("frames_per_second", "frames/s ↑", 2),
    Column("skin_rms_mm", "skin RMS mm ↓"),
    Column("contact_rms_mm", "contact RMS mm ↓"),
    Column("normal_force_error", "normal force % ↓", 1, 100.0),
)


def markdown_table(
    names: Sequence[str],
    rows: Iterable[tuple[Sequence[str], Mapping[str, Any]]],
    columns: Sequence[Column],
) -> str:
    """Return a Markdown table.

    Args:
        names: titles of the columns that name a row.
        rows: the names of each row, and its figures; one that is absent or None is a dash.
        columns: which figures.

    Raises:
        ValueError: a row with another number of names.
    """
    titles = [*names, *(column.title for column in columns)]
    lines = [_line(titles), _line([*["---"] * len(names), *["---:"] * len(columns)])]
    for row_names, figures in rows:
        if len(row_names) != len(names):
            raise ValueError(f"row {list(row_names)} has {len(row_names)} names, not {len(names)}")
        cells = [_cell(figures.get(column.key), column) for column in columns]
        lines.append(_line([*row_names, *cells]))
    return "\n".join(lines) + "\n"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(value: Any, column: Column) -> str:
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    return f"{value * column.scale:.{column.digits}f}"


def entry_list(entries: Mapping[str, Any]) -> str:
    """Return names and what they stand for as a Markdown list, with a line's end."""
    return "\n".join(f"- {name}: {value}" for name, value in entries.items()) + "\n"
