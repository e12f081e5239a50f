# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The table of indenter classification, and what its figures mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from studies.classification.real_ball import BALL
from studies.optics.names import BOUND
from studies.table import Column, markdown_table

COLUMNS = (
    Column("mean", "accuracy % ↑", 1, 100.0),
    Column("std", "± between seeds", 1, 100.0),
    Column("balanced_mean", "mean of the classes % ↑", 1, 100.0),
    Column("published", "paper %", 1, 100.0),
    Column("simulated", "on simulated touches %", 1, 100.0),
    Column("frames", "frames", 0),
    Column("trajectories", "trajectories", 0),
)
PUBLISHED = {
    "in_domain": {"ours": 0.9048, "difftactile": 0.6588, "tacto": 0.5059},
    "out_of_domain": {"ours": 0.8118, "difftactile": 0.5294, "tacto": 0.5059},
}
"""The paper's table of indenter classification; "ours" is its own method, on another sensor."""
BALL_COLUMNS = (
    Column("called_ball", "real presses called a ball % ↑", 1, 100.0),
    Column("std", "± between seeds", 1, 100.0),
    Column("others_called_ball", "other shapes called a ball % ↓", 1, 100.0),
    Column("simulated", "told right of simulated touches %", 1, 100.0),
    Column("idle", "idle image called a ball %", 0, 100.0),
    Column("presses", "real presses", 0),
)
TITLES = {
    "in_domain": "The first and the third indenter, image models fitted on other presses of them",
    "out_of_domain": "The same two, image models fitted on the other indenters alone",
    "all_six": "All indenters, image models fitted on other presses of them",
}


def classification_page(figures: Mapping[str, Any], picture: str) -> str:
    """Return the page, with a link to the picture of confusion matrices."""
    study = figures["study"]
    plan = study["plan"]
    origin = figures["provenance"]
    parts = [
        "# Which indenter: learnt in simulation, judged on measured images",
        "",
        f"Classifiers learn from simulated images alone: {plan['count']} presses of each indenter "
        "at random places of the sensor's gel, rendered by each image model, every fifth left out. "
        "All indenters are pressed equally deep. They are judged on measured images with contact, "
        f"of trajectories that no image model was fitted on. {study['seeds']} classifiers a row "
        "differ in their weights and the order of the images. What a classifier sees is a window "
        "of the difference to the idle image, around where it is largest, turned at random while "
        "learning; network, training and noise are the same in every row, and were chosen by "
        "simulated touches that were not learnt from, not by measured ones. `bound` learns from "
        "measured images of other trajectories.",
        "",
        f"`{study['data']}` is a synthetic stand-in for a real sensor. The paper's figures are of "
        "its own sensor, indenters and classifier: they say what it reports, no more.",
        "",
    ]
    for name in study["domains"]:
        rows = figures[name]
        parts += [f"## {TITLES[name]}", "", _table(name, rows), ""]
        for model in (m for m in ("ours", BOUND) if m in rows):
            parts += [_confusion(model, rows[model]), ""]
    if "real_ball" in figures:
        parts += _real_ball(figures["real_ball"])
    parts += [
        "## Confusion matrices",
        "",
        f"![which indenter was taken for which]({picture})",
        "",
        f"Commit {origin['commit']}, {origin['date']}, {origin['machine']}: `{origin['command']}`. "
        "Each row in the JSON file says when and at which commit it was made.",
        "",
    ]
    return "\n".join(parts)


def _table(domain: str, rows: Mapping[str, Mapping[str, Any]]) -> str:
    published = PUBLISHED.get(domain, {})
    return markdown_table(
        ["images"],
        [
            (
                [name],
                {**row, "balanced_mean": row["balanced"]["mean"], "published": published.get(name)},
            )
            for name, row in rows.items()
        ],
        COLUMNS,
    )


def _real_ball(found: Mapping[str, Any]) -> list[str]:
    """Return the section on the real presses of a ball."""
    ball = found["classes"].index(BALL)
    rows = [
        (
            [model],
            {key: row[key]["mean"] for key in ("called_ball", "others_called_ball", "simulated")}
            | {
                "std": row["called_ball"]["std"],
                "presses": found["presses"],
                "idle": row["idle_told"][ball] / sum(row["idle_told"]),
            },
        )
        for model, row in found["rows"].items()
    ]
    others = ", ".join(name for name in found["classes"] if name != BALL)
    return [
        "## Real images of a ball",
        "",
        f"{found['presses']} images of a real GelSight, all of a ball of 4.7 mm. Each image model "
        "is fitted on half of them; classifiers learn from simulated touches of that flat gel by "
        f"a ball and by other shapes ({others}; {found['touches_of_each_shape']} touches each, "
        "equally deep) and are judged on the other half, then the other way round. Nothing real "
        "but the ball was recorded, so the right answer is always the same one: the second figure "
        "is of touches by the *other* shapes, drawn by an image model that the classifier did not "
        "learn from, fitted on the half that is judged. Chance is one in "
        f"{len(found['classes'])}.",
        "",
        markdown_table(["images"], rows, BALL_COLUMNS),
        "",
    ]


def _confusion(model: str, row: Mapping[str, Any]) -> str:
    """Return a table of true classes by told ones, in shares of the true class."""
    classes: Sequence[str] = row["classes"]
    lines = [
        f"| `{model}`: shown, told | " + " | ".join(classes) + " |",
        "| --- |" + " --- |" * len(classes),
    ]
    for shown, counts in zip(classes, row["confusion"], strict=True):
        total = max(1, sum(counts))
        cells = " | ".join(f"{100.0 * count / total:.0f} %" for count in counts)
        lines.append(f"| {shown} | {cells} |")
    return "\n".join(lines)
