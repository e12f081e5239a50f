# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The pictures of docs/real_data.md, from the results and the published data.

python -m studies.real.pictures real docs/results docs/images
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dotsim_ros.data.importers.ecoflex_compression import (
    HEIGHT_M,
    CompressionTest,
    read_compression_tests,
)
from dotsim_ros.io.documents import read_json
from dotsim_ros.io.files import whole_file
from studies.real.cylinders import FITTED_SPECIMEN, LAWS, slipping

SHOWN_MIXES = ("EF10_0T", "EF30_0T", "EF50_0T")
SIZE_IN = (6.4, 3.4)
DOTS = 90


def pad_picture(figures: dict[str, Any], path: Path) -> None:
    """Draw measured forces, each predicted from the other depths, and the makers' model."""
    figure = Figure(figsize=SIZE_IN, layout="constrained")
    axes = figure.subplots()
    rows = figures["left_out"]
    depth, measured, predicted, low, high = (
        np.array([row[key] for row in rows])
        for key in ("depth_mm", "measured_n", "predicted_n", "low_n", "high_n")
    )
    axes.errorbar(
        depth,
        100.0 * (predicted / measured - 1.0),
        100.0 * np.stack([predicted - low, high - predicted]) / measured,
        fmt="o",
        capsize=4,
        label="predicted from the other two depths, 95 %",
    )
    axes.plot(
        depth,
        100.0 * (np.array(figures["makers"]["ratio"]) - 1.0),
        "s",
        label="as its makers fitted it",
    )
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.set(xlabel="depth mm", ylabel="off the measured force, %")
    axes.legend()
    with whole_file(path) as part:
        figure.savefig(part, dpi=DOTS)


def cylinder_picture(
    figures: dict[str, Any], tests: tuple[CompressionTest, ...], path: Path
) -> None:
    """Draw measured forces over those of a slipping neo-Hookean cylinder of 2 C10 = 1 kPa, and the
    fitted laws."""
    figure = Figure(figsize=SIZE_IN, layout="constrained")
    axes = figure.subplots()
    share = np.linspace(0.03, 0.6, 58)
    unit = 500.0 * slipping(share).force_n["C10"]
    for number, mix in enumerate(SHOWN_MIXES):
        for test in tests:
            if test.mix == mix and test.force_at(share)[-1] > 0.0:
                fits = test.specimen == FITTED_SPECIMEN
                axes.plot(
                    100.0 * share,
                    test.force_at(share) / unit,
                    color=f"C{number}",
                    linewidth=0.8,
                    linestyle="-" if fits else ":",
                )
        (row,) = (r for r in figures["rows"] if r["mix"] == mix and r["ends"] == "slip")
        ends = slipping(share)
        law = ends.columns(row["law"]) @ [row["constants_pa"][name] for name in LAWS[row["law"]]]
        fitted = (share >= 0.1) & (share <= row["to"])
        axes.plot(100.0 * share[fitted], (law / unit)[fitted], "k--", linewidth=1.2)
        axes.annotate(mix, (61.0, _end_n(tests, mix) / unit[-1]), color=f"C{number}")
    axes.set(
        xlabel=f"compression of {1e3 * HEIGHT_M:.0f} mm, %",
        ylabel="shear modulus if it slipped, kPa",
        xlim=(0.0, 72.0),
        ylim=(0.0, None),
    )
    axes.plot([], [], "-", color="grey", label="specimen fitted on")
    axes.plot([], [], ":", color="grey", label="specimen judged")
    axes.plot([], [], "k--", label="law, plates that slip")
    axes.legend(loc="lower center", ncols=3, fontsize="small")
    with whole_file(path) as part:
        figure.savefig(part, dpi=DOTS)


def _end_n(tests: tuple[CompressionTest, ...], mix: str) -> float:
    """Return the mean force of a mix where its curves end in the picture."""
    return float(np.mean([t.force_at(np.array([0.6]))[0] for t in tests if t.mix == mix]))


def main(real: Path, results: Path, images: Path) -> None:
    """Draw both pictures."""
    pad_picture(read_json(results / "real_force.json"), images / "real_force_pad.png")
    cylinder_picture(
        read_json(results / "real_cylinders.json"),
        read_compression_tests(real / "ecoflex_compression"),
        images / "real_cylinders.png",
    )


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
