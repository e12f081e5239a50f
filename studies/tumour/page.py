# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The table of tumour detection, and what its figures mean."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from studies.table import Column, markdown_table
from studies.tumour.images import MOTION_PX, WIDTH_PX
from studies.tumour.pictures import STRENGTH

COLUMNS = (
    Column("accuracy", "accuracy % ↑", 1, 100.0),
    Column("accuracy_std", "± between classifiers", 1, 100.0),
    Column("balanced_accuracy", "mean of the classes % ↑", 1, 100.0),
    Column("published", "paper %", 1, 100.0),
    Column("simulated", "on simulated presses %", 1, 100.0),
    Column("same_presses", "on the judged ones, simulated %", 1, 100.0),
    Column("presses", "presses", 0),
    Column("wrong_presses", "presses told wrong", 0),
    Column("images", "images", 0),
)
SHIFT_COLUMNS = (
    Column("accuracy", "accuracy % ↑", 1, 100.0),
    Column("accuracy_std", "± between classifiers", 1, 100.0),
    Column("presses", "presses", 0),
    Column("images", "images", 0),
)
PUBLISHED: Mapping[str, Mapping[str, float]] = {
    "skin_1": {"ours": 0.8056, "rigid": 0.3889},
    "skin_2": {"ours": 0.9231, "rigid": 0.4615},
    "skin_3": {"ours": 0.9655, "rigid": 0.4483},
}
"""The paper's table of tumour classification: its own method, and Tacto beside our rigid row."""
ROWS = {
    "ours": "ours: gel and skin deform",
    "rigid": "rigid: the insert's shape cut out of the gel, as Tacto",
    "load": "load: a threshold on how far the image moved",
    "chance": "chance",
}


def tumour_page(figures: Mapping[str, Any], picture: str) -> str:
    """Return the page, with a link to the picture of presses."""
    study, origin = figures["study"], figures["provenance"]
    plan = study["plan"]
    skins = study["skins"]
    low, high = (1e3 * value for value in plan["deepest_m"])
    least, most = (1e3 * value for value in plan["height_m"])
    parts = [
        "# A tumour below a soft skin: learnt in simulation, judged on another solver's presses",
        "",
        "A soft skin of even top covers a rigid insert that is convex (a tumour) or concave "
        f"(none), {least:g} to {most:g} mm high or deep. The sensor presses onto it, {low:g} to "
        f"{high:g} mm deep at the end, up to {1e3 * plan['aside_m']:g} mm beside the insert's "
        f"middle and tilted by up to {math.degrees(plan['tilt_rad']):.0f} degrees, all drawn alike "
        "for both classes. Gel and skin both deform.",
        "",
        "Classifiers see how the image moved against the idle image, and how its brightness "
        "changed. They learn from our own gel and skin alone, one set for each skin, and are "
        "judged on a stand-in for reality: CalculiX with both bodies deformable, on meshes of its "
        "own, about half of the presses with friction of 0.3 that our skins have not, images with "
        "noise of 1.5 grey levels. Images are ours in both cases: optics are not judged here. "
        "The training was chosen on simulated presses. The independent units are the presses; each "
        f"gives {len(study['judged_shares'])} depths and {study['judged_turns']} turns about the "
        "sensor's axis. The paper's figures are of 36, 13 and 29 real images of its own foams: "
        "they say what it reports, no more.",
        "",
        markdown_table(
            ["skin", "learnt from"],
            [
                ([name, title], _shown(figures, name, row))
                for name in skins
                for row, title in ROWS.items()
            ],
            COLUMNS,
        ),
        "Presses told wrong: by most of their images and classifiers. On simulated presses: our "
        "own, which no classifier learnt from. On the judged ones, simulated: our own solves of "
        "the presses that CalculiX was given; what is lost against them is lost to the difference "
        "between both solvers.",
        "",
        markdown_table(
            ["skin", "thickness mm", "Young's modulus kPa", "Poisson's ratio"],
            [
                (
                    [
                        name,
                        f"{1e3 * s['thickness_m']:g}",
                        f"{1e-3 * s['youngs_modulus_pa']:g}",
                        f"{s['poisson_ratio']:g}",
                    ],
                    {
                        "learnt": figures[name]["learnt_presses"],
                        "images": figures[name]["learnt_images"],
                        "refused": figures[name]["refused_presses"],
                    },
                )
                for name, s in skins.items()
            ],
            (
                Column("learnt", "presses learnt from", 0),
                Column("images", "images learnt from", 0),
                Column("refused", "presses that were not solved", 0),
            ),
        ),
        "How far our presses are from CalculiX's, for those that are judged; markers that move by "
        "more than 0.05 mm:",
        "",
        markdown_table(
            ["skin"],
            [([name], figures[name]["difference"]) for name in skins],
            (
                Column("skin_rms_mm", "markers RMS mm ↓"),
                Column("moved_rms_mm", "their way mm"),
                Column("force_error", "force % ↓", 1, 100.0),
            ),
        ),
        f"![presses onto the skins]({picture})",
        "",
        "From the left, for each skin: a tumour and none, drawn apart, in our gel and skin, then "
        "the same two presses in CalculiX. Above the image; below how it moved along x and "
        f"along y, as classifiers are shown it: {MOTION_PX:g} pixels of {WIDTH_PX} across are "
        f"{STRENGTH:g} grey levels.",
        "",
        "## Shifts after learning",
        "",
        "`other lights`: CalculiX's presses, LEDs dimmer by a quarter and 20 degrees elsewhere, "
        "twice the ambient light, noise of 2.5 grey levels. Other skins: our own gel and skin, "
        "changed after learning, presses of other draws.",
        "",
        markdown_table(
            ["skin", "shift"],
            [
                ([name, shift], row)
                for name in skins
                for shift, row in figures[name]["shifts"].items()
            ],
            SHIFT_COLUMNS,
        ),
        f"Commit {origin['commit']}, {origin['date']}, {origin['machine']}: `{origin['command']}`",
        "",
    ]
    return "\n".join(parts)


def _shown(figures: Mapping[str, Any], skin: str, row: str) -> dict[str, Any]:
    shown = dict(figures[skin][row])
    shown["published"] = PUBLISHED[skin].get(row)
    if "by_press" in shown:
        shown["wrong_presses"] = sum(share < 0.5 for share in shown["by_press"])
    return shown
