# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Write the pages of docs/results anew from their figures, or check that they are what would stand
there.

    result_pages.py [--check]

A page is written with its figures, by code that changes later: the words of a table, its columns,
how figures are rounded. A page that was edited by hand, or figures that were replaced without their
page, show here as well.
"""

from __future__ import annotations

import argparse
import difflib
import json
import sys
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results"
AS_MADE = {
    "closed_loop": "its benchmark loads ROS",
    "loop_faults": "its benchmark loads ROS",
}
"""Pages that stay as they were made, and why."""
NO_FIGURES = ("index", "status")


@cache
def _functions() -> dict[str, Callable[[Any], str]]:
    """Return what makes each page from its figures, as the command that made it does."""
    from dotsim_ros.cli.evaluate import MODELS
    from dotsim_ros.evaluation.classification.page import classification_page
    from dotsim_ros.evaluation.gap.page import gap_page
    from dotsim_ros.evaluation.gap.solved_page import solved_page
    from dotsim_ros.evaluation.geometry.report import geometry_page
    from dotsim_ros.evaluation.geometry.runtime import runtime_page
    from dotsim_ros.evaluation.optics.gelsight import gelsight_page, gelsight_taxim_page
    from dotsim_ros.evaluation.optics.real_pair import real_pair_page
    from dotsim_ros.evaluation.optics.report import optics_page
    from dotsim_ros.evaluation.real_force.cylinder_study import cylinders_page
    from dotsim_ros.evaluation.real_force.pad_study import pad_page
    from dotsim_ros.evaluation.rl.page import rl_page
    from dotsim_ros.evaluation.trajectory.page import trajectory_page
    from dotsim_ros.evaluation.tumour.page import tumour_page

    sys.path.insert(0, str(ROOT / "benchmarks"))
    from reference import page as reference_page

    def of_geometry(figures: Mapping[str, Any]) -> str:
        return geometry_page(figures, [model for model in MODELS if model in figures])

    images = "../images"
    return {
        "classification": partial(classification_page, picture=f"{images}/classification.png"),
        "gap": gap_page,
        "gap_physics": solved_page,
        "gap_physics_new/gap_physics": solved_page,
        "gap_physics_new_again/gap_physics": solved_page,
        "gap_physics_rule_9/gap_physics": solved_page,
        "gelsight": gelsight_page,
        "gelsight_taxim": gelsight_taxim_page,
        "geometry": of_geometry,
        "geometry_later": of_geometry,
        "optics": partial(
            optics_page,
            sheets={level: f"{images}/optics_{level}.jpg" for level in ("easy", "medium", "hard")},
        ),
        "real_cylinders": cylinders_page,
        "real_force": pad_page,
        "real_pair": real_pair_page,
        "reference": reference_page,
        "rl": partial(rl_page, curve=f"{images}/rl_curve.png", rollout=f"{images}/rl_rollout.gif"),
        "runtime": runtime_page,
        "trajectory": partial(trajectory_page, image=f"{images}/closed_loop.png"),
        "tumour": partial(tumour_page, picture=f"{images}/tumour.png"),
    }


def rendered() -> dict[Path, str]:
    """Return each page, below docs/results, that its figures make."""
    return {
        Path(f"{name}.md"): page(json.loads((RESULTS / f"{name}.json").read_text("utf-8")))
        for name, page in _functions().items()
    }


def left_out() -> set[str]:
    """Return the names of pages that neither are made here nor stay as they were made."""
    there = {path.relative_to(RESULTS).with_suffix("").as_posix() for path in RESULTS.rglob("*.md")}
    return there - {*AS_MADE, *NO_FIGURES, *_functions()}


def difference(page: Path, text: str) -> list[str]:
    """Return the first lines of a page that are not those of a text."""
    path = RESULTS / page
    before = path.read_text(encoding="utf-8") if path.is_file() else ""
    lines = difflib.unified_diff(
        before.splitlines(), text.splitlines(), str(page), "from its figures", lineterm="", n=0
    )
    return list(lines)[:8] or ([f"{page}: another end of its last line"] if before != text else [])


def main() -> int:
    """Write or check the pages; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="compare only, and write nothing")
    check = parser.parse_args().check
    wrong = [f"{name}.md: name what makes it" for name in sorted(left_out())]
    for page, text in rendered().items():
        if check:
            wrong += difference(page, text)
        else:
            (RESULTS / page).write_text(text, encoding="utf-8")
    print("\n".join(wrong) or "nothing wrong")
    return min(len(wrong), 1)


if __name__ == "__main__":
    sys.exit(main())
