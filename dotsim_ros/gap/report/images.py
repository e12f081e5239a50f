# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The sections of a gap's report on the images."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dotsim_ros.effects.effect import Effect
from dotsim_ros.gap.findings import OpticalFindings, TileGap, Verdict
from dotsim_ros.gap.report.figures import HEAT_COLOURS, gap_bars
from dotsim_ros.gap.report.text import (
    estimate_text,
    percent,
    quantity,
    role_text,
    shown_name,
)
from dotsim_ros.io.page import (
    LARGEST_WIDTH_INCHES,
    Block,
    Bullets,
    Gallery,
    Paragraph,
    ReportImage,
    Section,
    Table,
    image_of,
    page_figure,
)

STAGES = ("before", "recalibrated", "after", "floor")
_MAP_INCHES = 2.7
_MARKER = 330.0
"""Area of a tile's square, square points: tiles of an 8 x 6 grid touch each other."""


def image_sections(f: OpticalFindings, effects: Mapping[str, Effect]) -> tuple[Section, ...]:
    """Return the sections on the images: what was found, where, and the effects that were tried.

    Args:
        f: what was found in the images.
        effects: the library, by name.
    """
    if f.verdict is Verdict.UNUSABLE:
        return (Section("Images", (Paragraph(f.sentence),)),)
    blocks: list[Block] = [Bullets(tuple(_items(f)))]
    images = []
    if f.gap is not None:
        stages = STAGES if f.named else tuple(stage for stage in STAGES if stage != "after")
        images.append(gap_bars(f.gap, stages))
    if f.tiles:
        images.append(tile_map(f.tiles, "before"))
        if f.named:
            images.append(tile_map(f.tiles, "after"))
    if images:
        text = (
            "Colours of the tiles, measured minus simulated; recalibrated: with one gain and one "
            "black level of the camera. The maps show the RMS of colours, sharpness and shift of "
            "each tile in expected deviations, +x to the right and +y down."
        )
        blocks += [Gallery(tuple(images)), Paragraph(text)]
    sections = [Section("Images", tuple(blocks))]
    tried = [c for c in f.candidates if c.is_excited]
    if tried:
        rows = tuple(
            (
                f"{rank}. {c.title} ({c.name}){role_text(f, c.name)}",
                f"{c.score:.3g}",
                _size(c.name, c.size, effects),
                percent(c.explained),
                "; ".join(map(estimate_text, c.estimates)) or "-",
            )
            for rank, c in enumerate(tried, start=1)
        )
        head = ("effect", "score", "predicted size", "explains", "fitted (95 %)")
        text = (
            f"In the order of what they take off the residual. A score counts from "
            f"{f.threshold:.3g}: it weighs the size by noise and by what the twin's own error "
            "imitates. Explains: share of the residual beyond noise."
        )
        sections.append(Section("Images: candidates by rank", (Table(head, rows), Paragraph(text))))
    return tuple(sections)


def tile_map(tiles: tuple[TileGap, ...], stage: str) -> ReportImage:
    """Return the tiles of the image in colours and numbers, at "before" or "after"."""
    values = [getattr(tile, stage) for tile in tiles]
    largest = max(4.0, *(tile.before for tile in tiles))
    with page_figure(LARGEST_WIDTH_INCHES, _MAP_INCHES) as figure:
        axes = figure.add_subplot()
        axes.scatter(
            [tile.x for tile in tiles],
            [tile.y for tile in tiles],
            c=np.clip(values, 0.7, largest),
            s=_MARKER,
            marker="s",
            cmap=HEAT_COLOURS,
            norm="log",
            vmin=0.7,
            vmax=largest,
        )
        for tile, value in zip(tiles, values, strict=True):
            is_dark = np.log(max(value, 0.7) / 0.7) > 0.6 * np.log(largest / 0.7)
            text = f"{value:.1f}" if value < 9.95 else f"{value:.0f}"
            axes.text(
                tile.x,
                tile.y,
                text,
                ha="center",
                va="center",
                color="white" if is_dark else "black",
            )
        axes.set_xlim(0.0, 1.0)
        axes.set_ylim(1.0, 0.0)
        axes.set_axis_off()
        axes.set_title(f"Tiles, {stage}")
        strongest = max(values)
        alt = f"RMS of the tiles of the image, {stage}: {min(values):.2g} to {strongest:.2g}"
        return image_of(figure, name=f"tiles_{stage}", alt=alt)


def _items(f: OpticalFindings) -> list[str]:
    items = [
        f.sentence,
        f"Largest score {f.statistic:.3g} against a threshold of {f.threshold:.3g}; mean square "
        f"of the residual {f.excess:.3g} of what is expected, with up to {f.largest_excess:.3g} "
        "where nothing is missing.",
        f"{f.frame_count} images; thresholds from {f.noise_source}.",
    ]
    if f.share_closed is not None:
        low, high = percent(f.share_closed_low), percent(f.share_closed_high)
        items.append(
            f"Share of the images' gap closed, in expected deviations of all tiles: "
            f"{percent(f.share_closed)} ({low} to {high}), on "
            + (f"{', '.join(f.locked)}." if f.locked else "the trajectories of the search.")
        )
    if f.stability is not None:
        items.append(
            f"{percent(f.stability)} of bootstrap repetitions over trajectories give the same "
            "answer."
        )
    return items


def _size(name: str, size: float, effects: Mapping[str, Effect]) -> str:
    if name not in effects:
        return f"{size:.3g}"
    first = effects[name].parameters[0]
    return f"{shown_name(first.name, first.unit)} {quantity(size, first.unit)}"
