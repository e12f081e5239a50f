# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Images of a gap's report, each narrow enough for a phone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.colors import LogNorm
from numpy.typing import ArrayLike

from dotsim_ros.data.recording import Phase
from dotsim_ros.gap.findings import (
    ALL,
    Findings,
    OpticalFindings,
    ResidualPlace,
    TileGap,
    UserGap,
    Verdict,
    WorstFrame,
)
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.page import LARGEST_WIDTH_INCHES, ReportImage, image_of, page_figure
from dotsim_ros.io.printable import figure_label
from dotsim_ros.view.panels import SKIN_COLOURS
from dotsim_ros.view.skin_map import SkinMap

STAGE_COLOURS = {
    "before": "#8b96a3",
    "recalibrated": "#7fb2e5",
    "after": "#1763b6",
    "floor": "#3d9a5f",
}
NAMED_COLOUR, ALTERNATIVE_COLOUR, OTHER_COLOUR = "#1763b6", "#d98a1f", "#b9c2cc"
MISFIT_COLOURS = "viridis"
HEAT_COLOURS = "YlOrRd"
MOST_CANDIDATES = 12
MOST_ROWS = 30
_PANEL_INCHES, _BAR_INCHES = 0.32, 0.19
_MAP_PX = 320
_MAP_INCHES = (1.75, 2.3)
_LONGEST_LABEL = 22
_TILES_INCHES = 2.7
_MARKER = 330.0
"""Area of a tile's square, square points: tiles of an 8 x 6 grid touch each other."""
_SHOWN_UNITS = {
    "m": (1e3, "mm"),
    "m/N": (1e3, "mm/N"),
    "s": (1.0, "s"),
    "Pa": (1e-3, "kPa"),
    "rad": (180.0 / np.pi, "degrees"),
}


def shown(value: float, unit: str) -> float:
    """Return a value of an SI unit in the unit that `shown_unit` names."""
    return float(value * _SHOWN_UNITS.get(unit, (1.0, unit))[0])


def shown_unit(unit: str) -> str:
    """Return the unit in which a report shows values of an SI unit."""
    return _SHOWN_UNITS.get(unit, (1.0, unit))[1]


def quantity(value: float, unit: str) -> str:
    """Return a value with its unit."""
    return f"{shown(value, unit):.3g} {shown_unit(unit)}".rstrip()


GAP_TITLES = {
    "image": "Image: PSNR, dB (more is better)",
    "force": "Force: RMS error, N (less is better)",
    "skin": "Skin: RMS error, mm (less is better)",
}


def user_gap_image(gaps: Sequence[UserGap]) -> list[ReportImage]:
    """Return image, force and skin at each stage in one picture; nothing without any of them."""
    if not gaps:
        return []
    stages = [
        {stage: v for stage in STAGE_COLOURS if (v := getattr(gap, stage)) is not None}
        for gap in gaps
    ]
    counts = [len(one) for one in stages]
    height = sum(_PANEL_INCHES + _BAR_INCHES * count for count in counts)
    with page_figure(LARGEST_WIDTH_INCHES, height) as figure:
        panels = figure.subplots(
            len(gaps), 1, squeeze=False, gridspec_kw={"height_ratios": [1 + n for n in counts]}
        )
        for axes, gap, values in zip(panels[:, 0], gaps, stages, strict=True):
            colours = [STAGE_COLOURS[stage] for stage in values]
            bars = axes.barh(list(values), list(values.values()), color=colours)
            axes.bar_label(bars, [f"{value:.3g}" for value in values.values()], padding=3)
            axes.invert_yaxis()
            axes.set_xlim(0.0, 1.2 * max(*values.values(), 1e-12))
            axes.set_title(GAP_TITLES[gap.channel], loc="left")
            axes.tick_params(left=False)
            axes.set_xticks([])
            axes.spines["bottom"].set_visible(False)
        alt = "; ".join(
            f"{gap.channel}, {gap.unit}: "
            + ", ".join(f"{stage} {value:.3g}" for stage, value in values.items())
            for gap, values in zip(gaps, stages, strict=True)
        )
        return [image_of(figure, name="user_gaps", alt=alt)]


class PlaceTable(NamedTuple):
    """Residuals by two things at once: labels of R rows and C columns, and (R, C) the RMS before
    and after in expected deviations, NaN where nothing was measured."""

    rows: list[str]
    columns: list[str]
    before: FloatArray
    after: FloatArray


def by_phase(places: Sequence[ResidualPlace]) -> PlaceTable:
    """Return residuals of each region of each channel, by what the indenter does."""
    summed = [place for place in places if place.trajectory == ALL]
    return _table([(_where(p), p.phase, p) for p in summed], [phase.value for phase in Phase])


def by_trajectory(places: Sequence[ResidualPlace]) -> PlaceTable:
    """Return residuals of each trajectory, by channel and region."""
    parts = [place for place in places if place.trajectory != ALL]
    return _table([(p.trajectory, _where(p), p) for p in parts])


def _where(place: ResidualPlace) -> str:
    return f"{place.channel}, {place.region}"


def _table(
    cells: Sequence[tuple[str, str, ResidualPlace]], columns: Sequence[str] = ()
) -> PlaceTable:
    """Return the table of places by their row and column; columns that are named come first."""
    rows = list(dict.fromkeys(row for row, _, _ in cells))
    there = dict.fromkeys(column for _, column, _ in cells)
    columns = [*(c for c in columns if c in there), *(c for c in there if c not in columns)]
    square, count = np.zeros((2, len(rows), len(columns))), np.zeros((len(rows), len(columns)))
    for row, column, place in cells:
        at = rows.index(row), columns.index(column)
        square[:, *at] += place.count * np.square([place.before, place.after])
        count[at] += place.count
    rms = np.sqrt(np.divide(square, count, out=np.full_like(square, np.nan), where=count > 0))
    return PlaceTable(rows, columns, *rms)


def place_images(findings: Findings) -> list[ReportImage]:
    """Return where and when the residuals of skin and force are large."""
    phases, trajectories = by_phase(findings.places), by_trajectory(findings.places)
    images = []
    if phases.rows:
        images.append(heatmap(phases, phases.before, name="phases", title="By phase"))
        if findings.named:
            title = "By phase, with the effect"
            images.append(heatmap(phases, phases.after, name="phases_after", title=title))
    if trajectories.rows:
        images.append(
            heatmap(trajectories, trajectories.before, name="trajectories", title="By trajectory")
        )
    return images


def heatmap(table: PlaceTable, values: FloatArray, *, name: str, title: str) -> ReportImage:
    """Return values (R, C) of a table as colours and numbers."""
    rows = table.rows
    if len(rows) > MOST_ROWS:
        title = f"{title}: the {MOST_ROWS} strongest of {len(rows)}"
        peak = np.nan_to_num(table.before, nan=0.0).max(axis=1)
        kept = np.sort(np.argsort(-peak, kind="stable")[:MOST_ROWS])
        rows, values = [rows[k] for k in kept], values[kept]
    labels = [figure_label(row, _LONGEST_LABEL) for row in rows]
    columns = [figure_label(column) for column in table.columns]
    largest = max(4.0, float(np.nanmax(table.before, initial=0.0)))
    # The column labels hang below, as long as they are.
    label_inches = 0.075 * max(map(len, columns))
    with page_figure(LARGEST_WIDTH_INCHES, 0.55 + 0.24 * len(rows) + label_inches) as figure:
        axes = figure.add_subplot()
        colours = matplotlib.colormaps[HEAT_COLOURS].with_extremes(bad="#eef1f4")
        shade = LogNorm(0.7, largest, clip=True)
        axes.imshow(np.ma.masked_invalid(values), cmap=colours, norm=shade, aspect="auto")
        for (i, j), value in np.ndenumerate(values):
            if np.isfinite(value):
                _number(axes, j, i, value, is_dark=shade(value) > 0.6)
        axes.set_xticks(range(len(columns)), columns, rotation=90)
        axes.set_yticks(range(len(rows)), labels)
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        figure.suptitle(figure_label(title, 60))
        i, j = np.unravel_index(int(np.nanargmax(values)), values.shape)
        alt = f"{title}: largest {values[i, j]:.2g} at {rows[i]}, {table.columns[j]}"
        return image_of(figure, name=name, alt=alt)


def tile_images(own: OpticalFindings | None) -> list[ReportImage]:
    """Return the gap of the images by tile; none where they were not searched."""
    if own is None or own.verdict is Verdict.UNUSABLE or not own.tiles:
        return []
    stages = ("before", "after") if own.named else ("before",)
    return [tile_map(own.tiles, stage) for stage in stages]


def tile_map(tiles: tuple[TileGap, ...], stage: str) -> ReportImage:
    """Return the tiles of the image in colours and numbers, at "before" or "after"."""
    values = [getattr(tile, stage) for tile in tiles]
    shade = LogNorm(0.7, max(4.0, *(tile.before for tile in tiles)), clip=True)
    with page_figure(LARGEST_WIDTH_INCHES, _TILES_INCHES) as figure:
        axes = figure.add_subplot()
        axes.scatter(
            [tile.x for tile in tiles],
            [tile.y for tile in tiles],
            c=values,
            s=_MARKER,
            marker="s",
            cmap=HEAT_COLOURS,
            norm=shade,
        )
        for tile, value in zip(tiles, values, strict=True):
            _number(axes, tile.x, tile.y, value, is_dark=shade(value) > 0.6)
        axes.set_xlim(0.0, 1.0)
        axes.set_ylim(1.0, 0.0)
        axes.set_axis_off()
        axes.set_title(f"Tiles, {stage}")
        alt = f"RMS of the tiles of the image, {stage}: {min(values):.2g} to {max(values):.2g}"
        return image_of(figure, name=f"tiles_{stage}", alt=alt)


def _number(axes: Any, x: float, y: float, value: float, *, is_dark: bool) -> None:
    text = f"{value:.1f}" if value < 9.95 else f"{value:.0f}"
    axes.text(x, y, text, ha="center", va="center", color="white" if is_dark else "black")


def ranking(findings: Findings) -> list[ReportImage]:
    """Return scores of the candidates over the threshold; nothing where none was scored."""
    scored = [c for c in findings.candidates if c.is_excited][:MOST_CANDIDATES]
    if not scored:
        return []
    colour = {
        **dict.fromkeys(findings.alternatives, ALTERNATIVE_COLOUR),
        **dict.fromkeys(findings.named, NAMED_COLOUR),
    }
    scores = [candidate.score for candidate in scored]
    with page_figure(LARGEST_WIDTH_INCHES, 0.8 + 0.24 * len(scored)) as figure:
        axes = figure.add_subplot()
        axes.barh(
            range(len(scored)),
            scores,
            color=[colour.get(candidate.name, OTHER_COLOUR) for candidate in scored],
        )
        names = [figure_label(candidate.name, _LONGEST_LABEL) for candidate in scored]
        axes.set_yticks(range(len(scored)), names)
        axes.tick_params(left=False)
        axes.invert_yaxis()
        axes.set_xscale("log")
        ends = [value for value in (*scores, findings.threshold) if value > 0.0] or [1.0]
        axes.set_xlim(max(min(0.5 * min(ends), 1.0), 1e-4 * max(ends)), 2.0 * max(ends))
        if findings.threshold > 0.0:
            axes.axvline(findings.threshold, color="#b3261e", linestyle="--", linewidth=1.2)
            axes.set_title(f"threshold {findings.threshold:.3g}", color="#b3261e", loc="right")
        axes.set_xlabel("score")
        alt = f"Scores against the threshold {findings.threshold:.3g}: " + ", ".join(
            f"{candidate.name} {candidate.score:.3g}" for candidate in scored
        )
        return [image_of(figure, name="ranking", alt=alt)]


def worst_frame(worst: WorstFrame, *, with_after: bool) -> list[ReportImage]:
    """Return the skin of the worst frame seen from above, and where each model misses it; nothing
    without a skin. An image after is made where an effect was added, so that it differs."""
    if not (worst.rest_m and worst.measured_m and worst.before_m):
        return []
    rest, measured = np.array(worst.rest_m), np.array(worst.measured_m)
    skin_map = SkinMap(rest, size_px=_MAP_PX)
    models = {"before": np.array(worst.before_m)}
    if with_after and worst.after_m:
        models["after"] = np.array(worst.after_m)
    motion = {"measured": _distance_mm(measured, rest)}
    motion |= {name: _distance_mm(skin, rest) for name, skin in models.items()}
    miss = {f"misfit_{name}": _distance_mm(skin, measured) for name, skin in models.items()}
    images = []
    for kind, values, colours in (
        ("Motion", motion, SKIN_COLOURS),
        ("Misfit", miss, MISFIT_COLOURS),
    ):
        largest = max(1e-6, *(float(np.nanmax(one)) for one in values.values()))
        for name, one in values.items():
            title = f"{kind}, {name.removeprefix('misfit_')}"
            images.append(_skin(skin_map, one, largest, colours, name, title))
    return images


def _skin(
    skin_map: SkinMap, values_mm: FloatArray, largest_mm: float, colours: str, name: str, title: str
) -> ReportImage:
    with page_figure(*_MAP_INCHES) as figure:
        axes = figure.add_subplot()
        image = axes.imshow(
            skin_map.raster(values_mm),
            vmin=0.0,
            vmax=largest_mm,
            cmap=matplotlib.colormaps[colours],
        )
        axes.set_axis_off()
        axes.set_title(title)
        figure.colorbar(image, ax=axes, orientation="horizontal", label="mm", shrink=0.9)
        alt = (
            f"{title} of the skin seen from above: up to {np.nanmax(values_mm):.3g} mm, RMS "
            f"{np.sqrt(np.nanmean(values_mm**2)):.3g} mm"
        )
        return image_of(figure, name=f"worst_{name}", alt=alt)


def _distance_mm(one_m: ArrayLike, other_m: ArrayLike) -> FloatArray:
    between = np.asarray(one_m, dtype=np.float64) - np.asarray(other_m, dtype=np.float64)
    return np.asarray(1e3 * np.linalg.norm(between, axis=1))
